"""The world's shell against robots that do nothing, or not what they should."""

import logging
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager

import numpy as np
import pytest

from protocol.bus import Bus, open_bus
from protocol.bus_config import BusConfig
from protocol.config import PoseModel, RobotConfig
from protocol.inbox import Arrival
from protocol.interrupt import Interrupt
from protocol.messages import (
    Action,
    DriveCommand,
    GridPatch,
    LiveRadio,
    LiveScore,
    MapReply,
    RadioFrame,
    Report,
    Sense,
    TrajectoryReply,
    Truth,
)
from protocol.topics import ACT, ENDED, RADIO, ROBOT_ALIVE, SCORE, SENSE, TRUTH
from robot.jobs import Jobs
from robot.process import Farewell, Mind, WorldMissingError, run_robot
from station.host_memory import play_in_memory
from station.hosts import Unwatched
from world.process import INTERRUPTED, WorldProcess
from world.roster import RosterError
from world.scenario import PaceConfig, RobotSpec, Scenario
from world.simulation import TIME_LIMIT, Simulation

FORWARD = DriveCommand(forward_mps=0.3)
JOIN_S = 20.0


class IdleMind:
    """Drives ahead, sends one frame a tick, and remembers what it was given."""

    def __init__(self, config: RobotConfig, incarnation: int, jobs: Jobs) -> None:
        del incarnation, jobs
        self.config = config
        self.senses: list[Sense] = []
        self.heard = 0
        self.before: Callable[[Sense], None] | None = None

    def remember(self, records: Sequence[bytes]) -> None:
        del records

    def step(self, sense: Sense) -> Action:
        if self.before is not None:
            self.before(sense)
        assert sense.frame_count == len(sense.frames)
        self.senses.append(sense)
        self.heard += len(sense.frames)
        frame = RadioFrame(kind="hello", payload=sense.tick.to_bytes(4, "little"))
        return Action(tick=sense.tick, drive=FORWARD, frame_count=1, frames=(frame,))

    def take_records(self) -> list[bytes]:
        return []

    def report(self) -> Report:
        return Report(
            tick=self.senses[-1].tick,
            pose=PoseModel(x_m=0.0, y_m=0.0, theta_rad=0.0),
            covariance=np.zeros((3, 3)),
            activity="idle",
            path=np.zeros((0, 2)),
            known_m2=0.0,
            frontier_m=0.0,
            finished=False,
            team=(),
            loop_closures=0,
            journal_entries=0,
        )

    def map_reply(self, exact: bool = False) -> MapReply:
        del exact
        cells = np.zeros((1, 1), dtype=np.int8)
        patch = GridPatch(resolution_m=0.1, origin_x_m=0.0, origin_y_m=0.0, cells=cells)
        return MapReply(own=patch, joint=patch)

    def trajectory_reply(self) -> TrajectoryReply:
        n = len(self.senses)
        return TrajectoryReply(
            ticks=np.array([sense.tick for sense in self.senses], dtype=np.int64),
            stamps=np.array([sense.stamp for sense in self.senses]),
            online=np.zeros((n, 3)),
            final=np.zeros((n, 3)),
            dead_reckoned=np.zeros((n, 3)),
            nodes=np.zeros((0, 3)),
            edge_nodes=np.zeros((0, 2), dtype=np.int32),
            edge_values=np.zeros((0, 9)),
            journal_digest="",
            frames_sent=n,
            bytes_sent=0,
            frames_heard=self.heard,
            bytes_heard=0,
        )


def scenario(robots: int = 2, seconds: float = 3.0, **pace: float | str) -> Scenario:
    return Scenario(
        map="rooms-small",
        robots=tuple(RobotSpec(name=f"r{n + 1}") for n in range(robots)),
        max_sim_s=seconds,
        pace=PaceConfig.model_validate(pace),
    )


def test_frames_and_senses_of_every_tick_arrive_once_and_in_order() -> None:
    minds: dict[str, IdleMind] = {}

    def make(config: RobotConfig, incarnation: int, jobs: Jobs) -> Mind:
        minds[config.name] = IdleMind(config, incarnation, jobs)
        return minds[config.name]

    simulation = Simulation(scenario())
    played = play_in_memory(simulation, Unwatched(), Interrupt(), make)
    assert simulation.exit_reason == TIME_LIMIT
    ledger = simulation.ledger.to_dict()
    for name, mind in minds.items():
        assert [sense.tick for sense in mind.senses] == list(range(31))
        sent = [int.from_bytes(f.payload, "little") for s in mind.senses for f in s.frames]
        assert sent == list(range(len(sent)))
        assert played.robots[name].note == ""
        assert played.robots[name].map is not None
        assert played.reports[name].ticks.tolist() == [0, 10, 20, 30]
    heard = sum(mind.heard for mind in minds.values())
    assert heard == ledger["total"]["delivered"]["frames"]


def test_a_robot_that_misses_the_deadline_is_stalled_and_comes_back() -> None:
    """r1 hangs at tick 5 until the others are three ticks on; it loses motion and frames to no
    one, and is waited for again."""
    minds: dict[str, IdleMind] = {}
    go_on = threading.Event()

    def hang(sense: Sense) -> None:
        if sense.tick == 5:
            assert go_on.wait(JOIN_S)

    def release(sense: Sense) -> None:
        if sense.tick == 8:
            go_on.set()

    def make(config: RobotConfig, incarnation: int, jobs: Jobs) -> Mind:
        mind = minds[config.name] = IdleMind(config, incarnation, jobs)
        mind.before = hang if config.name == "r1" else release
        return mind

    simulation = Simulation(scenario(deadline_s=0.5))
    played = play_in_memory(simulation, Unwatched(), Interrupt(), make)
    ticks = [sense.tick for sense in minds["r1"].senses]
    assert ticks[:6] == [0, 1, 2, 3, 4, 5]
    assert ticks[6] >= 8
    assert ticks[-1] == 30
    assert played.robots["r1"].note == "stalled 1 times"
    assert played.robots["r2"].note == ""
    # What r2 sent in between came with the next sense, in order and in full.
    heard = [int.from_bytes(f.payload, "little") for s in minds["r1"].senses for f in s.frames]
    assert heard == list(range(len(heard)))
    # Its wheels stood still while it was stalled (tick 5's command was halted, not its last).
    truth = simulation.history.poses[:, 0]
    still = truth[7 : ticks[6]]
    assert np.ptp(still[:, :2], axis=0).max() < 0.05


def test_a_mind_that_raises_dies_alone(caplog: pytest.LogCaptureFixture) -> None:
    def fail(sense: Sense) -> None:
        if sense.tick == 7:
            raise RuntimeError("a fault in the brain")

    def make(config: RobotConfig, incarnation: int, jobs: Jobs) -> Mind:
        mind = IdleMind(config, incarnation, jobs)
        if config.name == "r1":
            mind.before = fail
        return mind

    simulation = Simulation(scenario())
    played = play_in_memory(simulation, Unwatched(), Interrupt(), make)
    assert simulation.exit_reason == TIME_LIMIT
    assert simulation.alive == ("r2",)
    assert "lost" in played.robots["r1"].note
    assert played.robots["r1"].trajectory is None
    assert played.robots["r2"].trajectory is not None
    assert any("r1 died" in record.getMessage() for record in caplog.records)


def test_an_interruption_still_collects_the_last_words() -> None:
    interrupt = Interrupt()

    class StopAtTen(Unwatched):
        def ticked(self, simulation: Simulation, reports: Mapping[str, Report]) -> None:
            del reports
            if simulation.tick == 10:
                interrupt.request()

    simulation = Simulation(scenario())
    played = play_in_memory(simulation, StopAtTen(), interrupt, IdleMind)
    assert simulation.exit_reason == INTERRUPTED
    for robot in played.robots.values():
        assert robot.trajectory is not None
        assert len(robot.trajectory.ticks) == 11


def test_real_time_waits_for_nobody() -> None:
    """A robot that is slower than the ticks skips senses, but hears every frame."""
    minds: dict[str, IdleMind] = {}

    def dawdle(sense: Sense) -> None:
        del sense
        threading.Event().wait(0.05)

    def make(config: RobotConfig, incarnation: int, jobs: Jobs) -> Mind:
        mind = minds[config.name] = IdleMind(config, incarnation, jobs)
        if config.name == "r1":
            mind.before = dawdle
        return mind

    simulation = Simulation(scenario(mode="realtime", factor=10.0))
    played = play_in_memory(simulation, Unwatched(), Interrupt(), make)
    assert simulation.exit_reason == TIME_LIMIT
    assert len(minds["r1"].senses) < 31
    assert "missed" in played.robots["r1"].note
    heard = [int.from_bytes(f.payload, "little") for s in minds["r1"].senses for f in s.frames]
    assert heard == sorted(heard)
    assert len(heard) > len(minds["r1"].senses)


@contextmanager
def robot_threads(bus: Bus, *names: str) -> Iterator[dict[str, Farewell]]:
    farewells: dict[str, Farewell] = {}
    stop = Interrupt()

    def be(name: str) -> None:
        farewells[name] = run_robot(bus, name, IdleMind, stop)

    threads = [threading.Thread(target=be, args=(name,)) for name in names]
    for thread in threads:
        thread.start()
    try:
        yield farewells
        for thread in threads:
            thread.join(JOIN_S)
    finally:
        stop.request()
        for thread in threads:
            thread.join(JOIN_S)


def test_in_real_time_who_comes_late_joins() -> None:
    """r2 starts when r1 has been driving for two seconds; then it is sensed for like the others."""
    simulation = Simulation(scenario(seconds=6.0, mode="realtime", factor=5.0, roster_s=0.2))
    with open_bus(BusConfig.memory()) as bus, ExitStack() as later:

        class StartLate(Unwatched):
            def ticked(self, simulation: Simulation, reports: Mapping[str, Report]) -> None:
                del reports
                if simulation.tick == 20:
                    later.enter_context(robot_threads(bus, "r2"))

        world = WorldProcess(simulation, bus, StartLate(), Interrupt())
        with robot_threads(bus, "r1"):
            world.run()
        assert simulation.exit_reason == TIME_LIMIT
        assert simulation.alive == ("r1", "r2")
        first, second = (world.replies[name].trajectory for name in ("r1", "r2"))
        assert first is not None
        assert second is not None
        assert first.ticks[0] == 0
        assert second.ticks[0] >= 20
        assert second.ticks[-1] == first.ticks[-1] == 60
        before = simulation.history.poses[:21, 1, :2]
        assert np.ptp(before, axis=0).max() < 1e-9
        assert simulation.history.driven_m(1) > 0.1
        wire = world.replies["r2"].wire
        assert wire is not None
        assert all(count.sent == count.received for count in wire.values())


def test_who_does_not_come_is_named() -> None:
    simulation = Simulation(scenario(robots=3, roster_s=0.5))
    with open_bus(BusConfig.memory()) as bus, robot_threads(bus, "r1") as farewells:
        world = WorldProcess(simulation, bus, Unwatched(), Interrupt())
        with pytest.raises(RosterError, match=r"^r2, r3 did not arrive within 0.5 s"):
            world.run()
    assert farewells == {"r1": Farewell.ENDED}


def test_who_comes_back_after_it_was_given_up_takes_part_again() -> None:
    """r2 is played by hand: it answers twice, vanishes, appears again and goes on answering."""
    simulation = Simulation(scenario())
    answered: list[int] = []

    with open_bus(BusConfig.memory()) as bus:
        inbox = bus.inbox()
        inbox.subscribe(SENSE, "r2")
        inbox.subscribe(ENDED, "r2")

        def answer_next() -> bool:
            event = inbox.get(JOIN_S)
            if not isinstance(event, Arrival) or not isinstance(event.message, Sense):
                return False
            answered.append(event.message.tick)
            bus.publish(ACT, Action(tick=event.message.tick), "r2")
            return True

        def be_r2() -> None:
            bus.declare_alive(ROBOT_ALIVE, "r2")
            assert answer_next()
            assert answer_next()
            bus.withdraw(ROBOT_ALIVE, "r2")
            bus.declare_alive(ROBOT_ALIVE, "r2")
            while answer_next():
                pass

        hand = threading.Thread(target=be_r2)
        world = WorldProcess(simulation, bus, Unwatched(), Interrupt())
        with robot_threads(bus, "r1"):
            hand.start()
            world.run()
            hand.join(JOIN_S)
    assert simulation.alive == ("r1", "r2")
    assert world.roster.links["r2"].note == "started again 1 times"
    assert answered[:2] == [0, 1]
    assert answered[-1] > 2


def test_a_second_robot_of_a_name_is_not_let_in(caplog: pytest.LogCaptureFixture) -> None:
    simulation = Simulation(scenario(seconds=6.0, mode="realtime", factor=2.0))
    refused: list[str] = []

    with open_bus(BusConfig.memory()) as bus:

        def intrude() -> None:
            try:
                run_robot(bus, "r1", IdleMind, Interrupt(), world_wait_s=0.3)
            except WorldMissingError as error:
                refused.append(str(error))

        intruder = threading.Thread(target=intrude)

        class Intruded(Unwatched):
            def ticked(self, simulation: Simulation, reports: Mapping[str, Report]) -> None:
                del reports
                if simulation.tick == 10:
                    intruder.start()

        world = WorldProcess(simulation, bus, Intruded(), Interrupt())
        with robot_threads(bus, "r1", "r2"), caplog.at_level(logging.WARNING):
            world.run()
        intruder.join(JOIN_S)
    (said,) = refused
    assert "no other r1 there already" in said
    assert sum("a second r1 asks" in message for message in caplog.messages) == 1
    assert simulation.alive == ("r1", "r2")
    trajectory = world.replies["r1"].trajectory
    assert trajectory is not None
    assert trajectory.ticks[-1] == 60


def test_who_listens_is_told_of_truth_radio_and_score() -> None:
    simulation = Simulation(scenario(seconds=12.0))
    with open_bus(BusConfig.memory()) as bus:
        inbox = bus.inbox()
        for topic in (TRUTH, RADIO, SCORE):
            inbox.subscribe(topic)
        with robot_threads(bus, "r1", "r2"):
            WorldProcess(simulation, bus, Unwatched(), Interrupt()).run()
        told = [event.message for event in inbox.drain() if isinstance(event, Arrival)]
    truths = [message for message in told if isinstance(message, Truth)]
    assert sorted({truth.tick for truth in truths}) == list(range(1, 121))
    radios = [message for message in told if isinstance(message, LiveRadio)]
    assert len(radios) == 12
    last = radios[-1]
    ended = last.delivered.frames + sum(count.frames for count in last.dropped.values())
    assert 0 < last.offered.frames == ended + last.in_flight.frames
    scores = [message for message in told if isinstance(message, LiveScore)]
    assert len(scores) == 12
    assert scores[0].coverage is None
    assert scores[-1].coverage is not None
    assert scores[-1].alive == ("r1", "r2")


def test_a_world_that_fails_still_sends_its_robots_home() -> None:
    simulation = Simulation(scenario(seconds=1000.0))

    class Fault(Unwatched):
        def ticked(self, simulation: Simulation, reports: Mapping[str, Report]) -> None:
            del reports
            if simulation.tick == 5:
                raise SystemError

    with open_bus(BusConfig.memory()) as bus, robot_threads(bus, "r1", "r2") as farewells:
        world = WorldProcess(simulation, bus, Fault(), Interrupt())
        with pytest.raises(SystemError):
            world.run()
    assert set(farewells.values()) == {Farewell.ENDED}
