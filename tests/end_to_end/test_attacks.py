"""A hostile robot against the world's router: each attack beside the same act by whom it befits.

What is refused leaves no trace to wait for, so each attack is followed, in the same session, by
something that is allowed: the order of puts is kept, and what is seen first tells.
"""

import json
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
import zenoh

from protocol.access import STATION_USER
from protocol.allowance import BURST_TICKS
from protocol.bus import Bus, BusError, open_bus
from protocol.bus_config import BusConfig
from protocol.codec import encode, encoding_of
from protocol.config import RobotConfig
from protocol.inbox import SEQUENCE, Arrival, Event, Flood, Inbox, Presence
from protocol.interrupt import Interrupt
from protocol.keys import key_path, make_keys
from protocol.messages import Action, DriveCommand, HeardFrame, RadioFrame, Report, Sense, Truth
from protocol.topics import (
    ACT,
    CONFIG,
    MAP,
    RADIO_IN,
    RADIO_OUT,
    ROBOT_ALIVE,
    SENSE,
    TRUTH,
    WORLD_ALIVE,
    Topic,
)
from station.free_port import free_port
from station.hosts import Unwatched
from world.process import WorldProcess
from world.reception import MUTE_TICKS
from world.robot_link import RobotLink
from world.roster import Roster
from world.scenario import RobotSpec, Scenario
from world.simulation import TIME_LIMIT, Simulation

WAIT_S = 10.0
NAMES = ("r1", "r2")
TRUTH_NOW = Truth(tick=1, stamp=0.1, robots=NAMES, poses=[[0.0] * 3] * 2, links=[[0, 0]] * 2)
FRAME = RadioFrame(kind="hello", payload=b"hi")
HEARD = HeardFrame(sender="r1", sent_tick=1, to="*", kind="hello", payload=b"hi")


class Wire:
    """A walled router with the world on it, and sessions of robots, attackers and the station."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self.keys = folder / "keys"
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        make_keys(self.keys, NAMES)
        self._stack = stack
        config = BusConfig.router(self.endpoint).walled(self.keys, NAMES)
        self.world = stack.enter_context(open_bus(config))

    def config(self, key: Path | None) -> BusConfig:
        client = BusConfig.client(self.endpoint, key=key)
        return client.model_copy(update={"connect_timeout_s": 1.0})

    def join(self, user: str) -> Bus:
        """A session with the user's rightful key."""
        return self._stack.enter_context(open_bus(self.config(key_path(self.keys, user))))

    def raw(self, user: str) -> zenoh.Session:
        """As `join`, without any of our code between the attacker and the wire."""
        config = self.config(key_path(self.keys, user)).to_zenoh()
        return self._stack.enter_context(zenoh.open(config))


@pytest.fixture
def wire(tmp_path: Path) -> Iterator[Wire]:
    with ExitStack() as stack:
        yield Wire(tmp_path, stack)


def heard_by(inbox: Inbox) -> tuple[str, str]:
    """The topic and robot of the next event."""
    event = inbox.get(WAIT_S)
    assert isinstance(event, Arrival | Presence)
    return event.topic.name, event.robot


def await_listener(bus: Bus, topic: Topic, robot: str = "", listened: bool = True) -> None:
    """Until a subscription, or the end of one, has made its way through the router."""
    inbox = bus.inbox()
    for _ in range(200):
        if bus.is_heard(topic, robot) == listened:
            return
        inbox.get(0.05)
    raise AssertionError(f"{topic.name}: listened to is still not {listened}")


# -- listening


def test_the_truth_is_the_stations_alone(wire: Wire) -> None:
    station, robot = wire.join(STATION_USER).inbox(), wire.join("r1").inbox()
    robot.subscribe(TRUTH)
    robot.subscribe(SENSE, "r1")
    await_listener(wire.world, SENSE, "r1")
    assert not wire.world.is_heard(TRUTH)
    station.subscribe(TRUTH)
    await_listener(wire.world, TRUTH)
    wire.world.publish(TRUTH, TRUTH_NOW)
    wire.world.publish(SENSE, Sense(tick=1, stamp=0.1, encoders=(0, 0)), "r1")
    assert heard_by(station) == ("truth", "")
    assert heard_by(robot) == ("sense", "r1")


@pytest.mark.parametrize(
    ("topic", "message"),
    [(SENSE, Sense(tick=1, stamp=0.1, encoders=(0, 0))), (RADIO_IN, HEARD)],
    ids=["sense", "radio-in"],
)
def test_what_a_robot_perceives_is_its_own(
    wire: Wire, topic: Topic, message: Sense | HeardFrame
) -> None:
    thief, owner = wire.join("r1").inbox(), wire.join("r2").inbox()
    thief.subscribe(topic, "r2")
    thief.subscribe(topic, "r1")
    await_listener(wire.world, topic, "r1")
    assert not wire.world.is_heard(topic, "r2")
    owner.subscribe(topic, "r2")
    await_listener(wire.world, topic, "r2")
    wire.world.publish(topic, message, "r2")
    wire.world.publish(topic, message, "r1")
    assert heard_by(thief) == (topic.name, "r1")
    assert heard_by(owner) == (topic.name, "r2")


@pytest.mark.parametrize("key", ["**", "earshot/**", "robot/**", "robot/*/sense", "world/*"])
def test_wildcards_catch_nothing_that_a_name_would_not(wire: Wire, key: str) -> None:
    caught: list[str] = []
    thief, owner = wire.raw("r1"), wire.join("r2").inbox()
    thief.declare_subscriber(key, lambda sample: caught.append(str(sample.key_expr)))
    mine: Any = zenoh.handlers.FifoChannel(10)
    own: Any = thief.declare_subscriber("robot/r1/radio/in", mine)
    owner.subscribe(SENSE, "r2")
    await_listener(wire.world, RADIO_IN, "r1")
    await_listener(wire.world, SENSE, "r2")
    wire.world.publish(TRUTH, TRUTH_NOW)
    wire.world.publish(SENSE, Sense(tick=1, stamp=0.1, encoders=(0, 0)), "r2")
    wire.world.publish(RADIO_IN, HEARD, "r1")
    assert heard_by(owner) == ("sense", "r2")
    assert str(own.recv().key_expr) == "robot/r1/radio/in"
    assert [key for key in caught if not key.startswith("robot/r1/")] == []


# -- speaking


@pytest.mark.parametrize(
    ("topic", "message"), [(ACT, Action(tick=1)), (RADIO_OUT, FRAME)], ids=["act", "radio-out"]
)
def test_nobody_speaks_as_another(wire: Wire, topic: Topic, message: Action | RadioFrame) -> None:
    inbox = wire.world.inbox()
    for name in NAMES:
        inbox.subscribe(topic, name)
    forger, owner = wire.join("r1"), wire.join("r2")
    forger.publish(topic, message, "r2")
    await_listener(forger, topic, "r1")
    forger.publish(topic, message, "r1")
    assert heard_by(inbox) == (topic.name, "r1")
    await_listener(owner, topic, "r2")
    owner.publish(topic, message, "r2")
    assert heard_by(inbox) == (topic.name, "r2")
    assert inbox.malformed == {}


def test_a_forged_put_is_dropped_also_without_our_code(wire: Wire) -> None:
    inbox = wire.world.inbox()
    for name in NAMES:
        inbox.subscribe(ACT, name)
    forger = wire.raw("r1")
    for number, key in enumerate(("robot/r2/act", "robot/*/act", "robot/**", "robot/r1/act")):
        forger.put(
            key,
            encode(Action(tick=number)),
            encoding=encoding_of(Action),
            attachment=SEQUENCE.pack(number + 1),
        )
    assert inbox.get(WAIT_S) == Arrival(ACT, "r1", Action(tick=3))


def test_no_frame_gets_round_the_gate(wire: Wire) -> None:
    forger, receiver = wire.join("r1"), wire.join("r2").inbox()
    receiver.subscribe(RADIO_IN, "r2")
    out = wire.world.inbox()
    out.subscribe(RADIO_OUT, "r1")
    await_listener(wire.world, RADIO_IN, "r2")
    await_listener(forger, RADIO_OUT, "r1")
    forger.publish(RADIO_IN, HEARD, "r2")
    forger.publish(RADIO_OUT, FRAME, "r1")
    assert heard_by(out) == ("radio-out", "r1")  # the forged one has been through the router
    passed = HEARD.model_copy(update={"sent_tick": 2})
    wire.world.publish(RADIO_IN, passed, "r2")
    assert receiver.get(WAIT_S) == Arrival(RADIO_IN, "r2", passed)


def test_nobody_is_alive_in_anothers_name(wire: Wire) -> None:
    inbox = wire.world.inbox()
    for name in NAMES:
        inbox.watch(ROBOT_ALIVE, name)
    forger, owner = wire.join("r1"), wire.join("r2")
    forger.declare_alive(ROBOT_ALIVE, "r2")
    forger.declare_alive(ROBOT_ALIVE, "r1")
    assert heard_by(inbox) == ("robot-alive", "r1")
    owner.declare_alive(ROBOT_ALIVE, "r2")
    assert heard_by(inbox) == ("robot-alive", "r2")


# -- asking and answering


def test_only_its_own_configuration_is_told_to_a_robot(wire: Wire) -> None:
    served = wire.world.inbox()
    for name in NAMES:
        served.serve(CONFIG, name)
    robot = wire.join("r1")
    asking = robot.inbox()
    asking.watch(WORLD_ALIVE)
    wire.world.declare_alive(WORLD_ALIVE)
    assert heard_by(asking) == ("world-alive", "")
    asking.ask(CONFIG, "r2")
    asking.ask(CONFIG, "r1")
    question: Any = served.get(WAIT_S)
    assert question.robot == "r1"
    question.reply(RobotConfig(name="r1", team=NAMES))
    assert heard_by(asking) == ("config", "r1")


def test_nobody_answers_in_anothers_name_or_asks_a_robot_for_its_map(wire: Wire) -> None:
    forger, owner, inbox = wire.join("r1").inbox(), wire.join("r2").inbox(), wire.world.inbox()
    asking = wire.join("r1").inbox()  # a session of its own: within one, all is allowed
    forger.serve(MAP, "r2")
    owner.serve(MAP, "r2")
    owner.subscribe(SENSE, "r2")
    forger.subscribe(SENSE, "r1")
    await_listener(wire.world, SENSE, "r1")
    await_listener(wire.world, SENSE, "r2")
    asking.ask(MAP, "r2", wake_at_end=True)
    assert asking.get(WAIT_S) is None
    inbox.ask(MAP, "r2", timeout_s=1.0, wake_at_end=True)
    question: Any = owner.get(WAIT_S)
    assert question.topic is MAP
    wire.world.publish(SENSE, Sense(tick=1, stamp=0.1, encoders=(0, 0)), "r1")
    assert heard_by(forger) == ("sense", "r1")  # and not the question


# -- getting in


def test_who_has_no_key_or_a_wrong_one_stays_outside(wire: Wire, tmp_path: Path) -> None:
    make_keys(tmp_path / "others", ("r1", "r9"))
    for key, hint in (
        (None, "does the world ask for keys"),
        (key_path(tmp_path / "others", "r1"), "one of the keys that the world was given"),
        (key_path(tmp_path / "others", "r9"), "one of the keys that the world was given"),
    ):
        with pytest.raises(BusError, match=hint), open_bus(wire.config(key)):
            pass
    wire.join("r1")  # the same with its rightful key


def test_a_robot_with_a_key_that_is_not_in_the_scenario_can_do_nothing(wire: Wire) -> None:
    """Keys may be for more robots than take part; access is for those alone."""
    make_keys(wire.keys, ("r9",))
    config = BusConfig.router(f"tcp/127.0.0.1:{free_port()}").walled(wire.keys, NAMES)
    with open_bus(config) as world:
        client = BusConfig.client(*config.listen, key=key_path(wire.keys, "r9"))
        right = BusConfig.client(*config.listen, key=key_path(wire.keys, "r1"))
        inbox = world.inbox()
        for name in ("r1", "r9"):
            inbox.watch(ROBOT_ALIVE, name)
        with open_bus(client) as stranger, open_bus(right) as robot:
            stranger.declare_alive(ROBOT_ALIVE, "r9")
            stranger.declare_alive(ROBOT_ALIVE, "r1")
            assert inbox.get(0.3) is None
            robot.declare_alive(ROBOT_ALIVE, "r1")
            assert heard_by(inbox) == ("robot-alive", "r1")


# -- saying it again, and again


@pytest.mark.parametrize(
    ("topic", "message"), [(ACT, Action(tick=1)), (RADIO_OUT, FRAME)], ids=["act", "radio-out"]
)
def test_what_was_recorded_and_is_sent_again_counts_once(
    wire: Wire, topic: Topic, message: Action | RadioFrame
) -> None:
    inbox = wire.world.inbox()
    inbox.subscribe(topic, "r1")
    robot, key = wire.raw("r1"), topic.key_for("r1")
    encoding = encoding_of(type(message))
    for number in (5, 5, 4, 5, 6):
        robot.put(key, encode(message), encoding=encoding, attachment=SEQUENCE.pack(number))
    robot.put(key, encode(message), encoding=encoding)
    robot.put(key, encode(message), encoding=encoding, attachment=SEQUENCE.pack(7))
    assert [heard_by(inbox) for _ in range(3)] == [(topic.name, "r1")] * 3
    assert inbox.malformed == {(topic.name, "replay"): 3, (topic.name, "sequence"): 1}
    assert inbox.get(0.0) is None


def test_an_answer_to_an_answered_or_a_future_tick_counts_for_nothing() -> None:
    link = Roster(("r1",), 12_000).links["r1"]
    for tick, forward in ((4, 0.1), (4, 0.9), (3, 0.9), (99, 0.9)):
        link.accept_action(Action(tick=tick, drive=DriveCommand(forward_mps=forward)), tick=5)
    action = link.take_action()
    assert action is not None
    assert (action.tick, action.drive.forward_mps) == (4, 0.1)
    assert link.stale == 3
    assert link.note == "3 stale messages dropped"
    link.accept_action(Action(tick=5), tick=5)
    assert link.take_action() is not None


def test_of_a_flood_the_world_reads_so_much_and_counts_the_rest(wire: Wire) -> None:
    """An honest robot beside it is heard in full; after a tick the flooding one has a say again."""
    links = Roster(NAMES, 12_000).links
    inbox = wire.world.inbox()
    for name, link in links.items():
        inbox.subscribe(ACT, name, link.allowance)
    flooder, honest = wire.join("r1"), wire.join("r2")
    await_listener(flooder, ACT, "r1")
    await_listener(honest, ACT, "r2")
    for number in range(1000):
        flooder.publish(ACT, Action(tick=number), "r1")
    passes = most_of(links["r1"])
    events: list[Event | None] = [inbox.get(WAIT_S) for _ in range(passes)]
    assert {getattr(event, "robot", "") for event in events} == {"r1"}
    assert inbox.get(WAIT_S) == Flood("r1")
    honest.publish(ACT, Action(tick=1), "r2")
    assert inbox.get(WAIT_S) == Arrival(ACT, "r2", Action(tick=1))
    await_refused(links["r1"], 1000 - passes)
    assert links["r2"].allowance.refused == 0
    inbox.mute("r1")
    await_listener(flooder, ACT, "r1", listened=False)
    flooder.publish(ACT, Action(tick=1500), "r1")
    inbox.unmute("r1")
    links["r1"].allowance.refill()
    await_listener(flooder, ACT, "r1")
    flooder.publish(ACT, Action(tick=2000), "r1")
    assert inbox.get(WAIT_S) == Arrival(ACT, "r1", Action(tick=2000))


def most_of(link: RobotLink) -> int:
    taken = 0
    probe = Roster(NAMES, 12_000).links[link.name].allowance
    while probe.take(0):
        taken += 1
    assert taken % BURST_TICKS == 0
    return taken


def await_refused(link: RobotLink, number: int) -> None:
    """Zenoh's thread counts; what it has not counted yet is on its way."""
    with open_bus(BusConfig.memory()) as bus:
        inbox = bus.inbox()
        for _ in range(100):
            if link.allowance.refused == number:
                return
            inbox.get(0.05)
    raise AssertionError(f"{link.allowance.refused} of {number} were refused")


def test_who_floods_is_not_waited_for(wire: Wire) -> None:
    """r1 answers the first ticks by a flood alone, r2 properly: the run goes on at r2's pace, and
    when r1 has been muted long enough it is told again what it senses."""
    scenario = Scenario(
        map="rooms-small", robots=tuple(RobotSpec(name=name) for name in NAMES), max_sim_s=12.0
    )
    scenario = scenario.model_copy(
        update={"pace": scenario.pace.model_copy(update={"deadline_s": 60.0})}
    )
    simulation = Simulation(scenario)
    flooder, honest = wire.join("r1"), wire.join("r2")
    inboxes = {"r1": flooder.inbox(), "r2": honest.inbox()}
    buses = {"r1": flooder, "r2": honest}

    class Hands(Unwatched):
        """Plays both robots between the ticks: r1 says hundreds of times what is stale."""

        def started(self, simulation: Simulation) -> None:
            self.answer(simulation)

        def ticked(self, simulation: Simulation, reports: Mapping[str, Report]) -> None:
            del reports
            if simulation.done:
                for name, bus in buses.items():
                    bus.withdraw(ROBOT_ALIVE, name)
            else:
                self.answer(simulation)

        def answer(self, simulation: Simulation) -> None:
            for _ in range(300 if simulation.tick < 50 else 0):
                flooder.publish(ACT, Action(tick=10**6), "r1")
            honest.publish(ACT, Action(tick=max(0, simulation.tick)), "r2")

    world = WorldProcess(simulation, wire.world, Hands(), Interrupt())
    for name, bus in buses.items():
        inboxes[name].subscribe(SENSE, name)
        await_listener(wire.world, SENSE, name)
        await_listener(bus, ACT, name)
        bus.declare_alive(ROBOT_ALIVE, name)
    world.run()
    assert simulation.exit_reason == TIME_LIMIT
    assert "muted 1 times for flooding" in world.roster.links["r1"].note
    first, second = (inboxes["r1"].get(WAIT_S) for _ in range(2))
    assert isinstance(first, Arrival)
    assert isinstance(first.message, Sense)
    assert first.message.tick == 0
    assert isinstance(second, Arrival)
    assert isinstance(second.message, Sense)
    assert second.message.tick >= MUTE_TICKS
    assert world.roster.links["r2"].note == "lost"  # as all who withdraw before they were dismissed


def test_a_key_is_nobody_elses_to_read(tmp_path: Path) -> None:
    make_keys(tmp_path / "keys", NAMES)
    assert (tmp_path / "keys").stat().st_mode & 0o777 == 0o700
    files = list((tmp_path / "keys").iterdir())
    assert {path.name for path in files} == {"r1.key", "r2.key", "@station.key", "users"}
    assert {path.stat().st_mode & 0o777 for path in files} == {0o600}
    passwords = {json.loads(path.read_text())["password"] for path in files if path.suffix}
    assert len(passwords) == 3
