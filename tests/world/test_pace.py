"""Lockstep and real time against robots that answer late, once, or never."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest

from protocol.interrupt import Interrupt
from protocol.messages import Action, DriveCommand
from world import pace
from world.pace import Lockstep, RealTime
from world.reception import Reception
from world.roster import Roster, RosterError
from world.scenario import PaceConfig, RobotSpec, Scenario
from world.simulation import Simulation

NAMES = ("r1", "r2", "r3")
FORWARD = DriveCommand(forward_mps=0.3)


class Desk:
    """A reception whose clock goes on as it reads; at the third reading the late answer."""

    def __init__(self) -> None:
        self.now = 0.0
        self.readings = 0
        self.late_answers: Callable[[], None] = lambda: None

    def read_next(self, timeout_s: float = 0.2) -> None:
        self.now += timeout_s
        self.readings += 1
        if self.readings == 3:
            self.late_answers()

    def read_all(self) -> None:
        pass


class World:
    """A simulation with a roster of three that have all come, and a desk whose clock counts."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, **settings: Any) -> None:
        config = PaceConfig.model_validate(settings)
        robots = tuple(RobotSpec(name=name) for name in NAMES)
        self.simulation = Simulation(Scenario(map="rooms-small", robots=robots, pace=config))
        self.roster = Roster(NAMES, 12_000)
        for link in self.roster.links.values():
            link.present = True
        self.roster.closed = True
        self.desk = Desk()
        monkeypatch.setattr(pace, "time", SimpleNamespace(monotonic=lambda: self.desk.now))
        reception = cast("Reception", self.desk)
        parts = self.simulation, self.roster, reception
        lockstep = config.mode == "lockstep"
        self.pace = Lockstep(*parts, Interrupt()) if lockstep else RealTime(*parts)
        self.senses = self.simulation.step({})

    def tick(self, *prompt: str, late: tuple[str, ...] = ()) -> None:
        """Senses out; those who are `prompt` answer at once, the late ones after a while."""
        for link in self.roster.alive:
            if not self.pace.holds(link):
                link.outgoing(self.senses[link.name])
        self.answer(*prompt)
        self.desk.readings, self.desk.late_answers = 0, lambda: self.answer(*late)
        self.pace.gather()
        self.senses = self.simulation.step(self.roster.take_actions())

    def answer(self, *names: str) -> None:
        tick = self.simulation.tick
        for name in names:
            self.roster.links[name].accept_action(Action(tick=tick, drive=FORWARD), tick)

    def speed(self, name: str) -> float:
        return float(self.simulation.history.velocities[-1, NAMES.index(name), 0])


def test_lockstep_waits_for_the_late_and_not_longer(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(monkeypatch)
    world.tick(*NAMES)
    assert world.desk.now == 0.0
    world.tick("r1", late=("r2", "r3"))
    assert world.desk.now == pytest.approx(0.6)
    assert not any(link.stalls for link in world.roster.links.values())


def test_who_misses_the_deadline_stands_still_and_is_awaited_no_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    world = World(monkeypatch, deadline_s=1.0)
    for _ in range(3):
        world.tick(*NAMES)
    assert world.speed("r1") > 0.0
    world.tick("r2", "r3")
    stalled = world.desk.now
    assert stalled == pytest.approx(1.2)
    for _ in range(5):
        world.tick("r2", "r3")
    assert world.desk.now == stalled
    assert world.speed("r1") == 0.0 and world.speed("r2") > 0.0
    link = world.roster.links["r1"]
    assert (link.stalled, link.stalls, link.missed) == (True, 1, 0)
    assert link.note == "stalled 1 times"
    world.tick(*NAMES)  # the answer that was owed
    world.tick("r2", "r3", late=("r1",))  # so it is awaited again
    assert not link.stalled
    assert world.desk.now > stalled
    assert world.speed("r1") > 0.0


def test_when_all_are_stalled_the_world_waits_for_one_or_ends(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    world = World(monkeypatch, deadline_s=1.0)
    world.tick()
    assert world.simulation.exit_reason == pace.NO_ANSWER
    assert pace.SILENCE_S < world.desk.now < pace.SILENCE_S + 3.0


def test_real_time_counts_the_ticks_that_each_robot_missed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    world = World(monkeypatch, mode="realtime", factor=0.5)
    for _ in range(10):
        world.tick("r1")
    assert world.desk.now == pytest.approx(10 * 0.1 / 0.5)
    missed = {name: link.missed for name, link in world.roster.links.items()}
    assert missed == {"r1": 0, "r2": 10, "r3": 10}
    assert world.speed("r1") > 0.0
    assert world.roster.links["r2"].note == "missed 10 ticks"


def test_real_time_stops_the_wheels_of_a_robot_that_fell_silent(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    world = World(monkeypatch, mode="realtime", dead_man_s=0.5)
    for _ in range(5):
        world.tick(*NAMES)
    for _ in range(4):
        world.tick("r2", "r3")
    assert world.speed("r1") > 0.0
    for _ in range(6):
        world.tick("r2", "r3")
    assert world.speed("r1") == 0.0 and world.speed("r2") > 0.0
    for _ in range(3):
        world.tick(*NAMES)
    assert world.speed("r1") > 0.0


def test_real_time_does_not_rush_after_a_long_interruption(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    world = World(monkeypatch, mode="realtime")
    world.tick(*NAMES)
    world.desk.now += 100.0  # the whole machine slept
    world.tick(*NAMES)
    before = world.desk.now
    world.tick(*NAMES)
    assert world.desk.now == pytest.approx(before + 0.1)


def test_real_time_makes_up_for_a_short_delay(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(monkeypatch, mode="realtime")
    world.tick(*NAMES)
    world.desk.now += 0.25
    for _ in range(4):
        world.tick(*NAMES)
    assert world.desk.now == pytest.approx(0.5)


def test_a_roster_names_who_did_not_come() -> None:
    roster = Roster(NAMES, 12_000)
    assert roster.missing == list(NAMES)
    roster.links["r2"].present = True
    with pytest.raises(RosterError, match=r"r1, r3 did not arrive within 7 s"):
        roster.check_complete(7.0)
    for name in ("r1", "r3"):  # late, and in time
        roster.links[name].present = True
    roster.check_complete(7.0)


def test_of_actions_the_newest_counts_and_no_frame_is_lost(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    link = World(monkeypatch).roster.links["r1"]
    for tick in (0, 2, 1, 2, 9):  # overtaken, repeated, and from the future
        link.accept_action(Action(tick=tick), 5)
    action = link.take_action()
    assert action is not None and action.tick == 2
    assert link.stale == 3
    assert link.take_action() is None
