"""Real processes: the three ways to run agree, and any of them may die."""

import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from protocol.errors import EarshotError
from protocol.keys import make_keys
from protocol.messages import Report
from robot.recollection import read_contents, read_records
from robot.team.journal import LogName, decode_record
from station.forks import forked_robots
from station.free_port import free_port
from station.hashes import run_hashes
from station.hosts import Unwatched
from station.launch import launch
from station.memory_use import memory_sample
from station.observer import RunOutcome
from world.process import INTERRUPTED
from world.scenario import PaceConfig, RobotSpec, Scenario
from world.simulation import TIME_LIMIT, Simulation

KILL_S = 120.0
# Long enough for whatever a test does to it, on however slow a machine.
LONG = Scenario(map="office", max_sim_s=30.0)
SHORT = Scenario(
    map="rooms-small",
    seed=3,
    robots=(RobotSpec(name="r1"), RobotSpec(name="r2")),
    max_sim_s=12.0,
    # Hashes only agree when nobody is late: a loaded machine must not make anybody so.
    pace=PaceConfig(deadline_s=60.0),
)


class AtTick(Unwatched):
    """Does something once, at a tick, when all robots have reported."""

    def __init__(self, tick: int, robot: str, number: signal.Signals) -> None:
        self.tick, self.robot, self.number = tick, robot, number

    def ticked(self, simulation: Simulation, reports: Mapping[str, Report]) -> None:
        del reports
        if simulation.tick == self.tick:
            os.kill(forked_robots(os.getpid())[self.robot], self.number)


@contextmanager
def earshot(*arguments: str, cwd: Path) -> Iterator[subprocess.Popen[str]]:
    """The command as a process that is not left behind."""
    root = Path(__file__).resolve().parents[2]
    process = subprocess.Popen(
        [sys.executable, "-m", "station.main", *arguments],
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": str(root), "PYTHONUNBUFFERED": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    timer = threading.Timer(KILL_S, process.kill)
    timer.start()
    try:
        yield process
    finally:
        timer.cancel()
        process.kill()
        process.wait()
        if process.stdout is not None:
            process.stdout.close()


def read_until(process: subprocess.Popen[str], pattern: str) -> str:
    """Output up to the line that matches, or all of it."""
    assert process.stdout is not None
    read = []
    for line in process.stdout:
        read.append(line)
        if re.search(pattern, line):
            break
    return "".join(read)


@pytest.fixture(scope="module")
def inline_run() -> RunOutcome:
    return launch(SHORT, "inline")


def test_in_memory_the_run_is_the_same(inline_run: RunOutcome) -> None:
    assert run_hashes(launch(SHORT, "memory")) == run_hashes(inline_run)


def test_in_processes_the_run_is_the_same(inline_run: RunOutcome, tmp_path: Path) -> None:
    """Also in a folder where an earlier run has left its journals."""
    (tmp_path / "journals").mkdir()
    (tmp_path / "journals" / "r1.0.journal").write_bytes(b"of another world")
    outcome = launch(SHORT, "processes", folder=tmp_path)
    assert run_hashes(outcome) == run_hashes(inline_run)
    assert outcome.exit_reason == inline_run.exit_reason
    for name, robot in outcome.robots.items():
        assert robot.note == ""
        assert robot.wire is not None
        assert robot.wire["sense"].sent == 121
        assert all(count.sent == count.received > 0 for count in robot.wire.values())
        assert robot.peak_rss_mb is not None
        assert 20.0 < robot.peak_rss_mb < 250.0
        assert list((tmp_path / "journals").glob(f"{name}.*")) == [
            tmp_path / "journals" / f"{name}.0.journal"
        ]
        records = read_records(tmp_path / "journals" / f"{name}.0.journal")
        assert robot.trajectory is not None
        assert len(records) > 0
        assert outcome.reports[name].ticks.tolist() == inline_run.reports[name].ticks.tolist()
    assert forked_robots(os.getpid()) == {}


@pytest.mark.parametrize("hash_seed", ["1", "77"])
def test_hash_seeds_change_nothing(
    hash_seed: str, inline_run: RunOutcome, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONHASHSEED", hash_seed)  # of the robots: this process has its own
    assert run_hashes(launch(SHORT, "processes")) == run_hashes(inline_run)


def test_a_killed_robot_ends_nothing_for_the_others() -> None:
    outcome = launch(LONG, "processes", AtTick(40, "r2", signal.SIGKILL))
    assert outcome.exit_reason == TIME_LIMIT
    assert outcome.simulation.alive == ("r1", "r3")
    assert "lost" in outcome.robots["r2"].note
    assert outcome.robots["r2"].map is None
    for name in ("r1", "r3"):
        trajectory = outcome.robots[name].trajectory
        assert trajectory is not None
        assert len(trajectory.ticks) == 301
    assert forked_robots(os.getpid()) == {}


def test_a_killed_robot_starts_again_and_loses_nothing(tmp_path: Path) -> None:
    """Killed at tick 60 and started again from its journal: its new life learns from its teammate,
    tells it what it finds itself, and both know all of its old one."""
    scenario = SHORT.model_copy(update={"max_sim_s": 20.0})
    killer = AtTick(60, "r2", signal.SIGKILL)
    outcome = launch(scenario, "processes", killer, folder=tmp_path, restart=True)
    assert outcome.exit_reason == TIME_LIMIT
    assert outcome.simulation.alive == ("r1", "r2")
    assert outcome.robots["r2"].note == "started again 1 times"
    assert outcome.robots["r2"].wire is not None
    assert all(count.sent == count.received for count in outcome.robots["r2"].wire.values())
    trajectory = outcome.robots["r2"].trajectory
    assert trajectory is not None
    assert trajectory.ticks[0] > 60
    assert trajectory.ticks[-1] == 200
    journals = tmp_path / "journals"
    first, second = sorted(journals.glob("r2.*.journal"), key=lambda path: path.stat().st_mtime_ns)
    assert not read_contents(first).damaged
    held = {decode_record(record)[0] for record in read_records(journals / "r1.0.journal")}
    lives = {name.log for name in held if name.log.robot == "r2"}
    assert lives == {LogName("r2", 0), LogName("r2", int(second.name.split(".")[1]))}
    old = {decode_record(record)[0] for record in read_records(first)}
    assert {name for name in held if name.log == LogName("r2", 0)} <= old
    assert {name for name in old if name.log == LogName("r2", 0)} <= held


def test_a_frozen_robot_is_stalled_and_carries_on_when_it_wakes() -> None:
    class FreezeAndWake(AtTick):
        def ticked(self, simulation: Simulation, reports: Mapping[str, Report]) -> None:
            super().ticked(simulation, reports)
            if simulation.tick == self.tick + 20:
                os.kill(forked_robots(os.getpid())[self.robot], signal.SIGCONT)

    # Long enough for the others to answer in on a busy machine: who does not is stalled, too.
    scenario = LONG.model_copy(update={"pace": PaceConfig(deadline_s=5.0)})
    outcome = launch(scenario, "processes", FreezeAndWake(40, "r2", signal.SIGSTOP))
    assert outcome.exit_reason == TIME_LIMIT
    assert outcome.simulation.alive == ("r1", "r2", "r3")
    assert "stalled" in outcome.robots["r2"].note
    trajectory = outcome.robots["r2"].trajectory
    assert trajectory is not None
    assert trajectory.ticks[-1] == 300
    assert len(trajectory.ticks) < 300


def test_in_real_time_a_frozen_robot_stops_and_goes_on_with_what_is_new() -> None:
    """SIGSTOP at tick 40, SIGCONT at tick 80: its wheels stop at the dead-man time, it misses
    ticks, and no message is lost to it."""

    class FreezeAndWake(AtTick):
        def ticked(self, simulation: Simulation, reports: Mapping[str, Report]) -> None:
            super().ticked(simulation, reports)
            if simulation.tick == self.tick + 40:
                os.kill(forked_robots(os.getpid())[self.robot], signal.SIGCONT)

    pace = PaceConfig(mode="realtime", factor=2.0)
    scenario = LONG.model_copy(update={"max_sim_s": 20.0, "pace": pace})
    outcome = launch(scenario, "processes", FreezeAndWake(40, "r2", signal.SIGSTOP))
    frozen = outcome.robots["r2"]
    assert outcome.exit_reason == TIME_LIMIT
    assert outcome.simulation.alive == ("r1", "r2", "r3")
    assert frozen.missed_ticks >= 38
    assert frozen.wire is not None
    assert all(count.sent == count.received for count in frozen.wire.values())
    assert frozen.trajectory is not None
    assert frozen.trajectory.ticks[-1] > 80
    dead_man = round(pace.dead_man_s / scenario.tick_s)
    # Some senses waited in its socket: which of them it takes first depends on the machine.
    assert np.diff(frozen.trajectory.ticks).max() > dead_man
    velocities = outcome.simulation.history.velocities[:, 1]
    braked = slice(40 + dead_man + 8, 80)  # and the wheels need a moment to stand still
    assert np.abs(velocities[braked]).max() < 1e-6


@pytest.mark.slow
def test_a_robot_frozen_for_good_is_lost_and_the_world_keeps_nothing_for_it() -> None:
    class Freeze(AtTick):
        def __init__(self) -> None:
            super().__init__(100, "r2", signal.SIGSTOP)
            self.rss_mb: dict[int, float] = {}

        def ticked(self, simulation: Simulation, reports: Mapping[str, Report]) -> None:
            super().ticked(simulation, reports)
            if simulation.tick in (200, 2800):
                sample = memory_sample(simulation.stamp, os.getpid())
                assert sample is not None
                self.rss_mb[simulation.tick] = sample.rss_mb

    pace = PaceConfig(mode="realtime", factor=20.0)
    robots = tuple(RobotSpec(name=name, policy="patrol") for name in ("r1", "r2", "r3"))
    settings = {"max_sim_s": 300.0, "pace": pace, "robots": robots}
    scenario = LONG.model_copy(update=settings)
    freeze = Freeze()
    outcome = launch(scenario, "processes", freeze)
    assert outcome.simulation.alive == ("r1", "r3")
    assert "lost" in outcome.robots["r2"].note
    # The others' history goes on growing, by some hundred bytes a tick.
    assert freeze.rss_mb[2800] - freeze.rss_mb[200] < 10.0
    assert forked_robots(os.getpid()) == {}


def test_an_exception_in_the_world_leaves_nothing_running() -> None:
    class Fault(Unwatched):
        def ticked(self, simulation: Simulation, reports: Mapping[str, Report]) -> None:
            del reports
            if simulation.tick == 5:
                raise SystemError

    with pytest.raises(SystemError):
        launch(LONG, "processes", Fault())
    assert forked_robots(os.getpid()) == {}


def test_ctrl_c_ends_the_robots_and_still_reports(tmp_path: Path) -> None:
    with earshot("run", "--headless", "--out", "out", cwd=tmp_path) as process:
        read_until(process, r"t 0:\d")
        robots = forked_robots(process.pid)
        assert sorted(robots) == ["r1", "r2", "r3"]
        process.send_signal(signal.SIGINT)
        rest = read_until(process, "report: out")
        assert process.wait(KILL_S) == 130
    assert INTERRUPTED in rest
    assert (tmp_path / "out" / "metrics.json").is_file()
    for pid in robots.values():
        assert not Path(f"/proc/{pid}").exists()


def test_when_the_world_is_killed_robots_stop_and_say_so(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    make_keys(tmp_path / "keys", ["r1"])
    world_command = ("world", "--robots", "1", "--listen", endpoint, "--keys", "keys")
    robot_command = ("robot", "r1", "--connect", endpoint, "--keys", "keys/r1.key")
    with (
        earshot(*world_command, "--headless", "--out", "out", cwd=tmp_path) as world,
        earshot(*robot_command, cwd=tmp_path) as robot,
    ):
        read_until(world, r"t 0:\d")
        world.kill()
        said = read_until(robot, "world")
        assert robot.wait(KILL_S) == 3
    assert "r1: the world is gone: wheels stopped" in said


def test_a_robot_that_cannot_start_is_quoted() -> None:
    robots = (RobotSpec(name="r1", engine="no-such-engine"),)
    with pytest.raises(EarshotError, match="no-such-engine"):
        launch(SHORT.model_copy(update={"robots": robots}), "processes")
    assert forked_robots(os.getpid()) == {}
