"""The trial runner keeps what it has done, and says no to what it cannot do."""

import argparse
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from studies.trials import main, parse_seeds, run_trial, table, trials
from world.scenario import RobotSpec, Scenario

SHORT = Scenario(map="rooms-small", max_sim_s=2.0, robots=(RobotSpec(name="r1"),))


def test_seeds_are_ranges_and_lists() -> None:
    assert parse_seeds("0-3,7") == [0, 1, 2, 3, 7]
    for nonsense in ("", "a", "3-", "-1", "4-2"):
        with pytest.raises(argparse.ArgumentTypeError):
            parse_seeds(nonsense)


def test_a_finished_trial_is_not_run_again(tmp_path: Path) -> None:
    first = run_trial(SHORT, tmp_path / "seed-0")
    written = (tmp_path / "seed-0" / "trial.json").stat().st_mtime_ns
    (again,) = trials(SHORT, [0], tmp_path, workers=1)
    assert again["hashes"] == first["hashes"]
    assert (tmp_path / "seed-0" / "trial.json").stat().st_mtime_ns == written
    assert "time limit" in table([again])


def test_another_scenario_in_the_same_folder_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_trial(SHORT, tmp_path / "seed-0")
    code = main(["--map", "rooms-small", "--seeds", "0", "--out", str(tmp_path)])
    assert code == 2
    assert "another scenario" in capsys.readouterr().err


def test_an_unknown_map_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = main(["--map", "nowhere", "--seeds", "0", "--workers", "1", "--out", str(tmp_path)])
    assert code == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_worker_ends_with_its_parent(tmp_path: Path, number: signal.Signals) -> None:
    program = tmp_path / "study.py"
    program.write_text(
        "import multiprocessing, os, time\n"
        "from concurrent.futures import ProcessPoolExecutor\n"
        "from studies.command import end_with_parent\n"
        "if __name__ == '__main__':\n"
        "    context = multiprocessing.get_context('spawn')\n"
        "    with ProcessPoolExecutor(1, context, initializer=end_with_parent) as pool:\n"
        "        print(pool.submit(os.getpid).result(), flush=True)\n"
        "        pool.submit(time.sleep, 60.0).result()\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(
        [sys.executable, str(program)], stdout=subprocess.PIPE, env=environment
    ) as study:
        assert study.stdout is not None
        worker = int(study.stdout.readline())
        study.send_signal(number)
        study.wait(timeout=20.0)
    deadline = time.monotonic() + 20.0
    while _runs(worker):
        assert time.monotonic() < deadline, "the worker lives on"
        time.sleep(0.02)


def _runs(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True
