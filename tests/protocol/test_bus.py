import json
import queue
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
import zenoh

from protocol.bus import Bus, BusError, open_bus
from protocol.bus_config import BusConfig, BusConfigError
from protocol.codec import encode, encoding_of
from protocol.config import RobotConfig
from protocol.inbox import SEQUENCE, Arrival, Presence, Question
from protocol.messages import Action, DriveCommand, HeardFrame, RadioFrame, Sense
from protocol.topics import (
    ACT,
    CONFIG,
    RADIO_IN,
    RADIO_OUT,
    ROBOT_ALIVE,
    SENSE,
    TRUTH,
    WORLD_ALIVE,
)
from station.free_port import free_port

WAIT_S = 10.0


@contextmanager
def two_ends(way: str) -> Iterator[tuple[Bus, Bus]]:
    """The world's and a robot's end, opened in one of the four ways."""
    port = free_port()
    if way == "memory":
        with open_bus(BusConfig.memory()) as bus:
            yield bus, bus
        return
    if way == "loopback":
        here = BusConfig.loopback(port, listen=True)
        there = BusConfig.loopback(port, listen=False)
    else:
        here = BusConfig.router(f"tcp/127.0.0.1:{port}")
        there = BusConfig.client(f"tcp/127.0.0.1:{port}")
    with open_bus(here) as world, open_bus(there) as robot:
        yield world, robot


@pytest.fixture(params=["memory", "loopback", "router"])
def ends(request: pytest.FixtureRequest) -> Iterator[tuple[Bus, Bus]]:
    with two_ends(request.param) as pair:
        yield pair


def test_messages_arrive_in_the_order_of_put_across_keys(ends: tuple[Bus, Bus]) -> None:
    world, robot = ends
    inbox = world.inbox()
    inbox.subscribe(RADIO_OUT, "r1")
    inbox.subscribe(ACT, "r1")
    inbox.watch(ROBOT_ALIVE, "r1")
    robot.declare_alive(ROBOT_ALIVE, "r1")
    assert inbox.get(WAIT_S) == Presence(ROBOT_ALIVE, "r1", alive=True)
    _await_subscriptions(world, robot)
    sent: list[RadioFrame | Action] = []
    for tick in range(200):
        frame = RadioFrame(kind="beacon", payload=bytes([tick % 256]) * 700)
        action = Action(tick=tick, drive=DriveCommand(forward_mps=0.1), frame_count=1)
        robot.publish(RADIO_OUT, frame, "r1")
        robot.publish(ACT, action, "r1")
        sent += [frame, action]
    received = [inbox.get(WAIT_S) for _ in sent]
    assert [event.message for event in received if isinstance(event, Arrival)] == sent


def _await_subscriptions(world: Bus, robot: Bus) -> None:
    """A robot that sees the world's presence has seen all that the world asked for before it."""
    seeing = robot.inbox()
    world.declare_alive(WORLD_ALIVE)
    seeing.watch(WORLD_ALIVE)
    assert seeing.get(WAIT_S) == Presence(WORLD_ALIVE, "", alive=True)


def test_a_question_is_answered_by_whom_it_is_served(ends: tuple[Bus, Bus]) -> None:
    world, robot = ends
    assert world.query(CONFIG, RobotConfig, "r1", timeout_s=0.2) is None
    inbox, asking = world.inbox(), robot.inbox()
    inbox.serve(CONFIG, "r1")
    world.declare_alive(WORLD_ALIVE)
    asking.watch(WORLD_ALIVE)
    assert asking.get(WAIT_S) is not None
    asking.ask(CONFIG, "r1")
    question = inbox.get(WAIT_S)
    assert isinstance(question, Question)
    config = RobotConfig(name="r1", team=("r1",))
    question.reply(config)
    assert asking.get(WAIT_S) == Arrival(CONFIG, "r1", config)


def test_presence_is_seen_also_by_who_comes_later_and_when_it_is_withdrawn(
    ends: tuple[Bus, Bus],
) -> None:
    world, robot = ends
    robot.declare_alive(ROBOT_ALIVE, "r1")
    inbox = world.inbox()
    inbox.watch(ROBOT_ALIVE, "r1")
    assert inbox.get(WAIT_S) == Presence(ROBOT_ALIVE, "r1", alive=True)
    robot.withdraw(ROBOT_ALIVE, "r1")
    assert inbox.get(WAIT_S) == Presence(ROBOT_ALIVE, "r1", alive=False)


def test_a_closed_router_takes_its_presence_with_it() -> None:
    port = free_port()
    with open_bus(BusConfig.router(f"tcp/127.0.0.1:{port}")) as world:
        world.declare_alive(WORLD_ALIVE)
        robot_bus = open_bus(BusConfig.client(f"tcp/127.0.0.1:{port}"))
        robot = robot_bus.__enter__()
        inbox = robot.inbox()
        inbox.watch(WORLD_ALIVE)
        assert inbox.get(WAIT_S) == Presence(WORLD_ALIVE, "", alive=True)
    try:
        assert inbox.get(WAIT_S) == Presence(WORLD_ALIVE, "", alive=False)
    finally:
        robot_bus.__exit__(None, None, None)


def test_sessions_of_different_namespaces_never_hear_each_other() -> None:
    port = free_port()
    endpoint = f"tcp/127.0.0.1:{port}"
    with (
        open_bus(BusConfig.router(endpoint, namespace="one")) as one,
        open_bus(BusConfig.client(endpoint, namespace="two")) as two,
        open_bus(BusConfig.client(endpoint, namespace="one")) as third,
    ):
        inbox = one.inbox()
        inbox.subscribe(ACT, "r1")
        inbox.watch(ROBOT_ALIVE, "r1")
        two.declare_alive(ROBOT_ALIVE, "r1")
        two.publish(ACT, Action(tick=1), "r1")
        third.declare_alive(ROBOT_ALIVE, "r1")
        third.publish(ACT, Action(tick=2), "r1")
        assert inbox.get(WAIT_S) == Presence(ROBOT_ALIVE, "r1", alive=True)
        assert inbox.get(WAIT_S) == Arrival(ACT, "r1", Action(tick=2))


@pytest.mark.parametrize(
    ("payload", "encoding", "kind"),
    [
        (b"\xc1 no msgpack", encoding_of(Action), "msgpack"),
        (encode(Action(tick=1)), "application/msgpack;earshot/action/99", "version"),
        (encode(Action(tick=1)), "text/plain", "encoding"),
        (encode(RadioFrame(kind="x", payload=b"")), encoding_of(Action), "schema"),
        (b"", encoding_of(Action), "msgpack"),
    ],
)
def test_malformed_messages_are_counted_by_kind_logged_once_and_passed_over(
    payload: bytes, encoding: str, kind: str, caplog: pytest.LogCaptureFixture
) -> None:
    port = free_port()
    with open_bus(BusConfig.loopback(port, listen=True)) as bus:
        inbox = bus.inbox()
        inbox.subscribe(ACT, "r1")
        config = BusConfig.loopback(port, listen=False).to_zenoh()
        with zenoh.open(config) as stranger:
            publisher = stranger.declare_publisher("robot/r1/act")
            _await_match(publisher)
            for _ in range(3):
                publisher.put(payload, encoding=encoding)
            publisher.put(
                encode(Action(tick=7)), encoding=encoding_of(Action), attachment=SEQUENCE.pack(1)
            )
            assert inbox.get(WAIT_S) == Arrival(ACT, "r1", Action(tick=7))
    assert inbox.malformed == {("act", kind): 3}
    assert len(caplog.records) == 1


def _await_match(publisher: zenoh.Publisher) -> None:
    matches: queue.SimpleQueue[bool] = queue.SimpleQueue()
    publisher.declare_matching_listener(lambda status: matches.put(status.matching))
    status: Any = publisher.matching_status
    while not status.matching and not matches.get(timeout=WAIT_S):
        pass


def test_a_sense_is_the_same_after_the_wire_but_for_its_frames(ends: tuple[Bus, Bus]) -> None:
    world, robot = ends
    inbox = robot.inbox()
    inbox.subscribe(SENSE, "r1")
    inbox.subscribe(RADIO_IN, "r1")
    inbox.watch(ROBOT_ALIVE, "r1")
    robot.declare_alive(ROBOT_ALIVE, "r1")
    seen = world.inbox()
    seen.watch(ROBOT_ALIVE, "r1")
    assert seen.get(WAIT_S) is not None
    assert inbox.get(WAIT_S) is not None
    frame = HeardFrame(sender="r2", sent_tick=3, to="*", kind="beacon", payload=b"hi")
    sense = Sense(
        tick=4,
        stamp=0.4,
        encoders=(7, -9),
        ranges=[1.5, float("inf")],
        frame_count=1,
        frames=(frame,),
    )
    world.publish(RADIO_IN, frame, "r1")
    world.publish(SENSE, sense, "r1")
    first, second = inbox.get(WAIT_S), inbox.get(WAIT_S)
    assert isinstance(first, Arrival)
    assert isinstance(second, Arrival)
    assert first.message == frame
    received = second.message
    assert isinstance(received, Sense)
    assert received.frames == ()
    assert received.frame_count == 1
    assert received.encoders == sense.encoders
    assert received.ranges is not None
    assert sense.ranges is not None
    assert received.ranges.tobytes() == sense.ranges.tobytes()
    assert not received.ranges.flags.writeable


def test_nobody_listens_until_somebody_does() -> None:
    with open_bus(BusConfig.memory()) as bus:
        assert not bus.is_heard(TRUTH)
        bus.inbox().subscribe(TRUTH)
        assert bus.is_heard(TRUTH)


def test_an_endpoint_that_cannot_be_reached_is_named() -> None:
    config = BusConfig.client(f"tcp/127.0.0.1:{free_port()}")
    with (
        pytest.raises(BusError, match=r"client connecting to tcp/127\.0"),
        open_bus(config.model_copy(update={"connect_timeout_s": 0.2})),
    ):
        pass


def test_discovery_is_off_in_every_way() -> None:
    for config in (
        BusConfig.memory(),
        BusConfig.loopback(7447, listen=True),
        BusConfig.router("tcp/127.0.0.1:7447"),
        BusConfig.client("tcp/127.0.0.1:7447"),
    ):
        zenoh_config = config.to_zenoh()
        assert json.loads(str(zenoh_config.get_json("scouting/multicast/enabled"))) is False
        assert json.loads(str(zenoh_config.get_json("scouting/gossip/enabled"))) is False


def test_overrides_are_zenohs_own_and_refused_by_name() -> None:
    lease = BusConfig(overrides=("transport/link/tx/lease:2345",)).to_zenoh()
    assert json.loads(str(lease.get_json("transport/link/tx/lease"))) == 2345
    with pytest.raises(BusConfigError, match="no/such/key"):
        BusConfig(overrides=("no/such/key:1",)).to_zenoh()
    with pytest.raises(BusConfigError, match="expected KEY:VALUE"):
        BusConfig(overrides=("mode",)).to_zenoh()
