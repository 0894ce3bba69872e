"""A report's folder: complete, readable, and honest about what is missing."""

import json
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
import pytest

from maps.grid import read_map
from station.formats import read_g2o, read_tum
from station.observer import RunOutcome
from station.report import write_report
from station.report_folder import ReportFolderError, run_folder
from station.report_links import spans_of
from station.report_metrics import Metrics, measure
from station.report_tables import ledger_table, metrics_table
from station.report_tracks import tracks_of
from station.scenario_file import read_scenario
from station.wording import readable_bytes


@pytest.fixture(scope="module")
def folder(outcome: RunOutcome, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report")
    write_report(outcome, path, coverage=[(4.0, 0.3), (8.0, 0.6)])
    return path


def test_the_folder_holds_what_its_readme_names(folder: Path) -> None:
    readme = (folder / "README.md").read_text()
    assert "**r3** left no map or trajectory: killed by signal 9" in readme
    for line in readme.splitlines():
        if line.startswith("| `"):
            for file in line.split("`")[1].split(", "):
                assert (folder / file.replace("ROBOT", "r1")).is_file(), file
    assert not list(folder.rglob(".*"))


def test_the_readme_says_what_bytes_were_for(folder: Path) -> None:
    readme, metrics = ((folder / name).read_text() for name in ("README.md", "metrics.json"))
    radio = json.loads(metrics)["radio"]
    live = radio["purposes"]["live"]
    assert f"| live | {readable_bytes(live['bytes_delivered'])} | " in readme
    together = f"| together | {readable_bytes(radio['bytes_delivered'])} | "
    assert f"{together}{radio['bytes_per_metre']:.0f} B |" in readme
    assert "| r1 → r2 | " in readme
    assert "| r2 → r1 | " in readme


def test_metrics_have_every_promised_key(folder: Path) -> None:
    metrics = json.loads((folder / "metrics.json").read_text())
    promised = (
        "coverage coverage_worst_joint walls.recall walls.precision team.ate_rmse_m "
        "team.ate_online_rmse_m robots.r1.ate_rmse_m collisions realtime_factor ledger.equal "
        "radio.bytes_delivered sim_s wall_s peak_rss_mb.r1 exit_reason hashes.map seed map mode "
        "versions.numpy"
    )
    for path in promised.split():
        value = metrics
        for key in path.split("."):
            value = value[key]
        assert value is not None, path
    assert Metrics.model_validate_json((folder / "metrics.json").read_text()) == Metrics(**metrics)


def test_metrics_are_those_of_the_run(outcome: RunOutcome) -> None:
    metrics = measure(outcome)
    assert metrics.coverage == 1.0
    assert metrics.walls.recall == 1.0
    assert metrics.team.ate_rmse_m == pytest.approx(0.0, abs=1e-9)
    assert metrics.team.ate_online_rmse_m == pytest.approx(0.02, abs=1e-9)
    assert metrics.realtime_factor == pytest.approx(6.0)
    assert metrics.ledger.equal is True
    assert metrics.robots["r3"].ate_rmse_m is None
    assert metrics.robots["r3"].note == "killed by signal 9"


def test_true_trajectories_end_where_a_robot_died(folder: Path, outcome: RunOutcome) -> None:
    assert len(read_tum(folder / "r1/true.tum").poses) == len(outcome.simulation.history)
    assert len(read_tum(folder / "r3/true.tum").poses) == 61
    assert not (folder / "r3/estimated.tum").exists()
    online, true = read_tum(folder / "r1/online.tum"), read_tum(folder / "r1/true.tum")
    np.testing.assert_allclose(online.poses[:, 0] - true.poses[:, 0], 0.02, atol=1e-8)


def test_maps_and_graphs_are_read_back(folder: Path, outcome: RunOutcome) -> None:
    truth = outcome.simulation.terrain.grid
    for name in ("team.yaml", "r1/own_map.yaml", "r2/joint_map.yaml"):
        np.testing.assert_array_equal(read_map(folder / name).cells, truth.cells)
    graph = read_g2o(folder / "r1/graph.g2o")
    assert len(graph.nodes) == len(graph.edge_nodes) + 1


def test_the_scenario_can_be_run_again(folder: Path, outcome: RunOutcome) -> None:
    assert read_scenario(folder / "scenario.yaml") == outcome.simulation.scenario


@pytest.mark.parametrize("name", ["team.png", "progress.png", "links.png"])
def test_pictures_show_something(folder: Path, name: str) -> None:
    image = cv2.imread(str(folder / name))
    assert image is not None
    assert image.shape[1] == 1600
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 50
    assert float(image.std()) > 5.0


def test_an_interrupted_run_has_a_report_that_says_so(nothing: RunOutcome, tmp_path: Path) -> None:
    metrics = write_report(nothing, tmp_path)
    assert metrics.exit_reason == "interrupted"
    assert metrics.sim_s == 0.0
    for value in (
        metrics.coverage,
        metrics.coverage_worst_joint,
        metrics.walls.recall,
        metrics.walls.precision,
        metrics.team.ate_rmse_m,
        metrics.ledger.equal,
        metrics.realtime_factor,
    ):
        assert value is None
    assert (tmp_path / "team.png").is_file()
    assert not (tmp_path / "team.yaml").exists()
    readme = (tmp_path / "README.md").read_text()
    assert "**r1** left no map or trajectory: no answer." in readme


def test_a_report_leaves_nothing_of_an_earlier_one(
    outcome: RunOutcome, nothing: RunOutcome, tmp_path: Path
) -> None:
    write_report(outcome, tmp_path)
    (tmp_path / "r1" / "notes.txt").write_text("mine")
    write_report(nothing, tmp_path)
    assert not (tmp_path / "team.yaml").exists()
    assert {file.name for file in (tmp_path / "r1").iterdir()} == {"true.tum", "notes.txt"}


def test_tables_name_every_robot_and_reason(outcome: RunOutcome) -> None:
    table = metrics_table(measure(outcome))
    assert "coverage, own maps together   100.0 %" in table
    assert "killed by signal 9" in table
    ledger = ledger_table(outcome.simulation.ledger)
    assert "r1 → r2" in ledger
    assert "absent" in ledger
    assert "beacon" in ledger


def test_tracks_are_aligned_as_the_referee_does(outcome: RunOutcome) -> None:
    tracks = tracks_of(outcome)
    belief = tracks.robots[0].belief
    assert belief is not None
    np.testing.assert_allclose(belief.error_m(belief.final), 0.0, atol=1e-9)
    np.testing.assert_allclose(belief.error_m(belief.online), 0.02, atol=1e-9)
    assert tracks.robots[2].belief is None


@pytest.mark.parametrize(
    ("linked", "spans"),
    [([], []), ([0, 0], []), ([1, 1], [(0, 2)]), ([1, 0, 1, 1, 0], [(0, 1), (2, 4)])],
)
def test_spans_are_where_a_series_is_true(linked: list[int], spans: list[tuple[int, int]]) -> None:
    assert spans_of(np.array(linked, dtype=bool)) == spans


def test_runs_get_a_folder_each_and_the_link_follows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    now = datetime(2026, 5, 4, 3, 2, 1, tzinfo=UTC)
    first, second = run_folder(None, now), run_folder(None, now)
    assert first == Path("runs/2026-05-04_03-02-01")
    assert second == Path("runs/2026-05-04_03-02-01_2")
    assert Path("runs/latest").resolve() == second.resolve()
    assert run_folder(Path("else/where")).is_dir()
    assert Path("runs/latest").resolve() == second.resolve()


def test_a_folder_that_cannot_be_made_is_an_error_of_ours(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ReportFolderError, match="--out DIR"):
        run_folder(tmp_path / "file" / "below")
