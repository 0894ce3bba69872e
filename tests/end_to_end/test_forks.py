"""Robots forked from one server: each a process of its own, and none left behind."""

import os
import signal
import time
from pathlib import Path

import pytest

from station.child import Child, children
from station.forks import ForkError, Forks, Spawns, fork_server

WAIT_S = 60.0
NOWHERE = "tcp/127.0.0.1:1"


def start(forks: Forks | Spawns, folder: Path, name: str, *words: str) -> Child:
    arguments = ["robot", name, "--connect", NOWHERE, *words]
    return forks.start(name, arguments, folder / f"{name}.log")


def await_end(child: Child) -> int:
    deadline = time.monotonic() + WAIT_S
    while child.exit_code is None and time.monotonic() < deadline:
        time.sleep(0.01)
    assert child.exit_code is not None
    return child.exit_code


def state_and_parent(pid: int) -> list[str]:
    return (Path("/proc") / str(pid) / "stat").read_text().rpartition(")")[2].split()[:2]


def parent_of(pid: int) -> int:
    return int(state_and_parent(pid)[1])


def is_running(pid: int) -> bool:
    try:
        return state_and_parent(pid)[0] != "Z"
    except OSError:
        return False


def test_each_is_a_process_with_a_log_and_an_end_of_its_own(tmp_path: Path) -> None:
    with fork_server(tmp_path) as forks, children() as family:
        patient = start(forks, tmp_path, "r1", "--wait", str(WAIT_S))
        hasty = start(forks, tmp_path, "r2", "--wait", "0.2")
        wrong = start(forks, tmp_path, "r3", "--no-such-option")
        family.extend((patient, hasty, wrong))
        assert len({patient.pid, hasty.pid, wrong.pid, os.getpid()}) == 4
        assert os.getsid(patient.pid) == patient.pid
        assert await_end(hasty) == 2
        assert "unrecognized arguments" not in hasty.log_tail()
        assert NOWHERE in hasty.log_tail()
        assert await_end(wrong) == 2
        assert "unrecognized arguments: --no-such-option" in wrong.log_tail()
        patient.note_peak()
        patient.sample_memory(0.5)
        (sample,) = patient.memory
        assert patient.peak_rss_mb is not None
        assert 0.0 < sample.pss_mb < sample.rss_mb <= patient.peak_rss_mb
        assert patient.exit_code is None
        patient.send(signal.SIGKILL)
        assert await_end(patient) == -signal.SIGKILL
        patient.send(signal.SIGKILL)  # which nobody gets


def test_robots_end_with_their_server_and_it_is_said(tmp_path: Path) -> None:
    with fork_server(tmp_path) as forks:
        robot = start(forks, tmp_path, "r1", "--wait", str(WAIT_S))
        os.kill(parent_of(robot.pid), signal.SIGKILL)
        assert await_end(robot) == -signal.SIGKILL
        deadline = time.monotonic() + WAIT_S
        while is_running(robot.pid) and time.monotonic() < deadline:
            time.sleep(0.01)
        assert not is_running(robot.pid)
        with pytest.raises(ForkError, match="robots are forked from ended"):
            start(forks, tmp_path, "r2")


def test_without_a_server_they_are_programs_of_their_own(tmp_path: Path) -> None:
    with children() as family:
        family.append(start(Spawns(), tmp_path, "r1", "--wait", "0.2"))
        assert await_end(family[0]) == 2
        assert NOWHERE in family[0].log_tail()
