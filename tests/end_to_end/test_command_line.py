import json
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from station.doctor import Finding, examine
from station.main import main, make_parser
from station.options import bus_config_from, scenario_from
from station.scenario_file import ScenarioFileError, changed, read_scenario
from world.scenario import RobotSpec, Scenario

COMMANDS = ("run", "world", "robot", "keys", "maps", "warm-up", "doctor")
SMALL = ("--map", "rooms-small", "--robots", "2", "--max-time", "3", "--mode", "inline")


def parsed_scenario(*words: str) -> Scenario:
    return scenario_from(make_parser().parse_args(["run", *words]))


def test_without_options_it_is_the_default_scenario() -> None:
    assert parsed_scenario() == Scenario()


def test_options_change_what_they_name_and_nothing_else() -> None:
    scenario = parsed_scenario(
        *("--robots", "2", "--map", "loop", "--seed", "7", "--range", "6", "--loss", "0.2"),
        *("--latency", "3", "--engine", "dead_reckoning", "--policy", "nearest"),
        *("--noise", "paper", "--max-time", "60", "--pace", "realtime", "--factor", "4"),
    )
    default = Scenario()
    assert scenario == default.model_copy(
        update={
            "map": "loop",
            "seed": 7,
            "max_sim_s": 60.0,
            "robots": tuple(
                RobotSpec(name=name, engine="dead_reckoning", policy="nearest")
                for name in ("r1", "r2")
            ),
            "radio": default.radio.model_copy(
                update={"range_m": 6.0, "loss": 0.2, "latency_ticks": 3}
            ),
            "lidar": default.lidar.model_copy(update={"noise": "paper"}),
            "pace": default.pace.model_copy(update={"mode": "realtime", "factor": 4.0}),
        }
    )


@pytest.mark.parametrize("suffix", [".yaml", ".json"])
def test_a_scenario_survives_its_file(tmp_path: Path, suffix: str) -> None:
    scenario = changed(Scenario(seed=5), {"radio": {"range_m": 4.0}}, robots=4)
    path = tmp_path / f"scenario{suffix}"
    fields = scenario.model_dump(mode="json")
    path.write_text(json.dumps(fields) if suffix == ".json" else yaml.safe_dump(fields))
    assert parsed_scenario(str(path)) == scenario
    assert parsed_scenario(str(path), "--seed", "6").seed == 6


def test_a_map_beside_the_scenario_is_found(tmp_path: Path) -> None:
    (tmp_path / "house.yaml").write_text("image: house.pgm")
    (tmp_path / "scenario.yaml").write_text("map: house.yaml")
    assert read_scenario(tmp_path / "scenario.yaml").map == str(tmp_path / "house.yaml")


def test_a_larger_team_keeps_the_named_and_takes_free_names() -> None:
    scenario = Scenario(robots=(RobotSpec(name="ada"), RobotSpec(name="r2")))
    assert changed(scenario, {}, robots=4).names == ("ada", "r2", "r1", "r3")
    assert changed(scenario, {}, robots=1).names == ("ada",)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("seed: -1", r"scenario.yaml: seed: "),
        ("speed: 1", r"scenario.yaml: speed: Extra"),
        ("robots: [{name: R2}]", r"scenario.yaml: robots.0.name: "),
        ("- 1", r"expected a mapping"),
        ("map: [", r"scenario.yaml: while parsing"),
        ("robots: []", r"at least one robot"),
    ],
)
def test_what_is_wrong_with_a_scenario_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "scenario.yaml"
    path.write_text(text)
    with pytest.raises(ScenarioFileError, match=message) as caught:
        read_scenario(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "words",
    [
        ["run", "no-such-file.yaml"],
        ["run", "--robots", "0"],
        ["run", "--map", "no-such-map", "--out", "out"],
        ["run", "--loss", "2"],
        ["robot", "r1", "--connect", "nonsense"],
        ["robot", "r1", "--namespace", "*"],
        ["robot", "r1", "--cfg", "no/such/key:1"],
    ],
)
def test_errors_are_one_line_and_exit_code_two(
    words: list[str],
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    message = capsys.readouterr().err.strip()
    assert message.startswith("earshot: ")
    assert "\n" not in message


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help_with_examples(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main([command, "--help"])
    assert ended.value.code == 0
    assert f"earshot {command}" in capsys.readouterr().out.split("examples:")[1]


def test_help_and_version_are_quick_because_they_import_little() -> None:
    """Neither numpy nor Zenoh nor matplotlib: measured in modules, which do not depend on load."""
    code = (
        "import sys, station.main\n"
        "try: station.main.main(['--version'])\n"
        "except SystemExit: pass\n"
        "print(sorted({'numpy', 'zenoh', 'numba', 'matplotlib', 'cv2'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
        cwd=Path(__file__).resolve().parents[2],
    )
    version, modules = done.stdout.splitlines()
    assert version.startswith("earshot ")
    assert modules == "[]"


def test_a_run_ends_with_its_report_and_picture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    out, metrics = tmp_path / "out", tmp_path / "numbers" / "metrics.json"
    words = ["run", *SMALL, "--headless", "--out", str(out), "--json", str(metrics)]
    assert main(words) == 0
    last = capsys.readouterr().out.strip().splitlines()[-1]
    assert last == f"report: {out}  picture: {out / 'team.png'}"
    assert (out / "team.png").is_file()
    assert (out / "live.png").is_file()
    numbers = json.loads(metrics.read_text())
    assert numbers["exit_reason"] == "time limit"
    assert numbers["sim_s"] == pytest.approx(3.0)

    again = tmp_path / "again"
    words = ["run", str(out / "scenario.yaml"), "--mode", "inline", "--headless"]
    assert main([*words, "--out", str(again)]) == 0
    repeated = json.loads((again / "metrics.json").read_text())
    assert repeated["hashes"] == numbers["hashes"]


def test_maps_lists_what_ships(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["maps"]) == 0
    names = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert {"loop", "office", "rooms-small"} <= set(names)


def test_network_options_are_named_as_zenohs() -> None:
    args = make_parser().parse_args(
        ["robot", "r1", "--mode", "peer", "-e", "tcp/a:1", "-l", "tcp/b:2", "--cfg", "x:1"]
    )
    config = bus_config_from(args, "client")
    assert (config.mode, config.connect, config.listen) == ("peer", ("tcp/a:1",), ("tcp/b:2",))
    assert config.overrides == ("x:1",)


def test_the_doctor_looks_at_everything_and_gives_advice_for_what_is_not_well() -> None:
    findings = list(examine())
    assert all(isinstance(finding, Finding) for finding in findings)
    subjects = {finding.subject for finding in findings}
    assert {"python", "eclipse-zenoh", "kernels", "memory", "zenoh on loopback"} <= subjects
    assert all(finding.advice for finding in findings if not finding.well)
    assert next(f for f in findings if f.subject == "zenoh on loopback").well
