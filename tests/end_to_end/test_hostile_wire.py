"""Garbage on every key: counted by kind, logged once, dropped; nothing ends, nothing is lost."""

import logging
from collections import Counter
from collections.abc import Iterator, Mapping
from threading import Thread
from typing import Any

import msgpack
import numpy as np
import pytest
import zenoh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from protocol.bus import Bus
from protocol.bus_config import BusConfig
from protocol.codec import MAX_MESSAGE_BYTES, decode, encode, encoding_of
from protocol.config import RobotConfig
from protocol.errors import MalformedMessageError
from protocol.inbox import SEQUENCE, Arrival
from protocol.interrupt import Interrupt
from protocol.messages import (
    Action,
    Ended,
    FrameCount,
    GridPatch,
    HeardFrame,
    LiveRadio,
    LiveScore,
    MapReply,
    RadioFrame,
    Report,
    Sense,
    Tally,
    TrajectoryReply,
    Truth,
)
from protocol.model import Message
from protocol.topics import SENSE, TOPICS, Style, Topic
from robot.brain import Brain
from robot.jobs import Jobs
from robot.process import run_robot
from station.hosts import Unwatched
from world.process import WorldProcess
from world.scenario import PaceConfig, RobotSpec, Scenario
from world.simulation import TIME_LIMIT, Simulation

WAIT_S = 10.0
NAMES = ("r1", "r2")
SPOKEN = tuple(topic for topic in TOPICS if topic.schema is not None)
ORIGIN = {"x_m": 0.0, "y_m": 0.0, "theta_rad": 0.0}
PATCH = GridPatch(resolution_m=0.1, origin_x_m=0.0, origin_y_m=0.0, cells=np.zeros((2, 2)))
NOTHING = FrameCount(frames=0, bytes=0)
SAMPLES: dict[type[Message], Message] = {
    Sense: Sense(tick=1, stamp=0.1, encoders=(1, 2), ranges=[1.0] * 257),
    Action: Action(tick=1),
    RadioFrame: RadioFrame(kind="hello", payload=b"hi"),
    HeardFrame: HeardFrame(sender="r2", sent_tick=1, to="*", kind="hello", payload=b"hi"),
    Report: Report.model_validate(
        {
            "tick": 1,
            "pose": ORIGIN,
            "covariance": np.eye(3),
            "activity": "",
            "path": np.zeros((2, 2)),
            "known_m2": 1.0,
            "frontier_m": 1.0,
            "finished": False,
            "team": (),
            "loop_closures": 0,
            "journal_entries": 0,
        }
    ),
    Ended: Ended(tick=1, reason="over"),
    RobotConfig: RobotConfig(name="r1", team=NAMES),
    MapReply: MapReply(own=PATCH, joint=PATCH),
    TrajectoryReply: TrajectoryReply(
        ticks=[0, 1],
        stamps=[0.0, 0.1],
        online=np.zeros((2, 3)),
        final=np.zeros((2, 3)),
        dead_reckoned=np.zeros((2, 3)),
        nodes=np.zeros((2, 3)),
        edge_nodes=[[0, 1]],
        edge_values=np.zeros((1, 9)),
        journal_digest="",
        frames_sent=0,
        bytes_sent=0,
        frames_heard=0,
        bytes_heard=0,
    ),
    Tally: Tally(sent={"act": 1}, received={"sense": 1}, malformed=0),
    Truth: Truth(tick=1, stamp=0.1, robots=NAMES, poses=np.zeros((2, 3)), links=np.eye(2)),
    LiveRadio: LiveRadio(
        tick=1,
        stamp=0.1,
        robots=NAMES,
        links=np.eye(2),
        offered=NOTHING,
        delivered=NOTHING,
        dropped={},
        in_flight=NOTHING,
    ),
    LiveScore: LiveScore(tick=1, stamp=0.1, collisions=0, alive=NAMES, finished=()),
}

PUBLISHED = tuple(topic for topic in SPOKEN if topic.style is Style.PUBLISH)
MISFITS: tuple[dict[str, object], ...] = (
    {"stamp": 1e6, "encoders": (1, 2, 3)},
    {"stamp": 1e6, "ranges": np.ones(5, dtype=np.float32)},
    {"stamp": -1.0},
)

SCALARS = (
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats()
    | st.text(max_size=8)
    | st.binary(max_size=16)
)
SIZES = st.lists(st.integers(-1, 2**30) | st.just(2**62), max_size=3)
ARRAYS = st.fixed_dictionaries(
    {
        "d": st.sampled_from(("<f8", "<f4", "<i8", "<i4", "|i1", ">f8", "|O", "")),
        "s": SIZES,
        "b": st.binary(max_size=48),
    }
)
VALUES = SCALARS | ARRAYS | st.lists(SCALARS, max_size=3)


@st.composite
def damaged(draw: st.DrawFn, schema: type[Message]) -> tuple[bytes, str]:
    """A payload and encoding that began as a proper message."""
    payload, encoding = encode(SAMPLES[schema]), encoding_of(schema)
    match draw(st.sampled_from(("bytes", "cut", "padded", "field", "missing", "encoding"))):
        case "bytes":
            payload = draw(st.binary(max_size=200))
        case "cut":
            payload = payload[: draw(st.integers(0, len(payload) - 1))]
        case "padded":
            payload += draw(st.binary(min_size=1, max_size=20))
        case "encoding":
            version = f"{encoding.rpartition('/')[0]}/{draw(st.integers(2, 10**6))}"
            other = encoding_of(draw(st.sampled_from(sorted(SAMPLES, key=lambda s: s.SCHEMA))))
            encoding = draw(st.sampled_from(("", "text/plain", version, other)))
        case how:
            fields = SAMPLES[schema].model_dump()
            name = draw(st.sampled_from(sorted(fields)))
            if how == "missing":
                del fields[name]
            else:
                fields[name] = draw(VALUES)
            payload = msgpack.packb(fields)
    return payload, encoding


def is_right(schema: type[Message], payload: bytes, encoding: str) -> bool:
    try:
        decode(schema, payload, encoding)
    except MalformedMessageError:
        return False
    return True


def wrong(topic: Topic) -> Iterator[tuple[bytes, str]]:
    """One of each kind, but the oversized."""
    assert topic.schema is not None
    payload, encoding = encode(SAMPLES[topic.schema]), encoding_of(topic.schema)
    nan = {name: float("nan") for name in SAMPLES[topic.schema].model_dump()}
    yield payload, "text/plain"
    yield payload, encoding.rpartition("/")[0] + "/99"
    yield payload[: len(payload) // 2], encoding
    yield msgpack.packb(nan), encoding
    yield payload + b"\x00", encoding


class Forger:
    """Puts whatever it likes on any key, with sequence numbers that are in order."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._sequence = 0

    def put(self, topic: Topic, payload: bytes, encoding: str, robot: str = "r1") -> None:
        self._sequence += 1
        key = topic.key_for(robot if "{robot}" in topic.key else "")
        number = SEQUENCE.pack(self._sequence)
        self._session.put(key, payload, encoding=encoding, attachment=number)


@pytest.mark.parametrize("topic", SPOKEN, ids=lambda topic: topic.name)
def test_on_every_key_what_is_wrong_is_counted_and_what_is_right_is_heard(topic: Topic) -> None:
    schema, name = topic.schema, "r1" if "{robot}" in topic.key else ""
    assert schema is not None
    with zenoh.open(BusConfig.memory().to_zenoh()) as session:
        bus, forger = Bus(session), Forger(session)
        inbox = bus.inbox()
        if topic.style is Style.PUBLISH:
            inbox.subscribe(topic, name)

        @settings(
            max_examples=40,
            deadline=None,
            derandomize=True,
            suppress_health_check=[HealthCheck.too_slow],
        )
        @given(damaged(schema))
        def feed(made: tuple[bytes, str]) -> None:
            before, (payload, encoding) = inbox.malformed.total(), made
            right = is_right(schema, payload, encoding)
            if topic.style is Style.PUBLISH:
                forger.put(topic, payload, encoding)
                forger.put(topic, encode(SAMPLES[schema]), encoding_of(schema))
            else:
                answer(session, topic, name, payload, encoding)
                inbox.ask(topic, name, WAIT_S, wake_at_end=True)
            heard = [inbox.get(WAIT_S) for _ in range(1 + right)]
            last = heard.pop() if topic.style is Style.QUERY else None
            assert last is None  # no further answer will come
            assert all(isinstance(event, Arrival) for event in heard)
            assert inbox.malformed.total() == before + (not right)

        feed()
        assert inbox.malformed.total() > 0
        assert {kind for _, kind in inbox.malformed} <= {
            "encoding",
            "version",
            "msgpack",
            "schema",
        }


def answer(session: zenoh.Session, topic: Topic, name: str, payload: bytes, encoding: str) -> None:
    """Let the next question on a topic be answered so, once."""
    key = topic.key_for(name)

    def reply(query: zenoh.Query) -> None:
        with query:
            query.reply(key, payload, encoding=encoding)
        entity.undeclare()

    entity: Any = session.declare_queryable(key, reply)


def test_what_is_too_large_is_not_looked_into() -> None:
    with zenoh.open(BusConfig.memory().to_zenoh()) as session:
        inbox, forger = Bus(session).inbox(), Forger(session)
        inbox.subscribe(SENSE, "r1")
        forger.put(SENSE, b"\x80" * (MAX_MESSAGE_BYTES + 1), encoding_of(Sense))
        forger.put(SENSE, encode(SAMPLES[Sense]), encoding_of(Sense))
        assert isinstance(inbox.get(WAIT_S), Arrival)
        assert inbox.malformed == {("sense", "size"): 1}


def test_garbage_on_every_key_ends_no_run(caplog: pytest.LogCaptureFixture) -> None:
    """Two robots map; before every tick each key of theirs and of the world gets each of the ways
    in which a message can be wrong."""
    robots = tuple(RobotSpec(name=name) for name in NAMES)
    scenario = Scenario(
        map="rooms-small", robots=robots, max_sim_s=4.0, pace=PaceConfig(deadline_s=60.0)
    )
    simulation, stop = Simulation(scenario), Interrupt()
    minds: dict[str, Brain] = {}

    def make(config: RobotConfig, incarnation: int, jobs: Jobs) -> Brain:
        minds[config.name] = Brain(config, incarnation, jobs)
        return minds[config.name]

    with zenoh.open(BusConfig.memory().to_zenoh()) as session:
        bus, forger = Bus(session), Forger(session)

        class Hostile(Unwatched):
            def ticked(self, simulation: Simulation, reports: Mapping[str, Report]) -> None:
                del simulation, reports
                for topic, robot in ((t, name) for t in PUBLISHED for name in NAMES):
                    for payload, encoding in wrong(topic):
                        forger.put(topic, payload, encoding, robot)
                for name in NAMES:  # right in form, but of no use to this robot
                    for changes in MISFITS:
                        sense = SAMPLES[Sense].model_copy(update=changes)
                        forger.put(SENSE, encode(sense), encoding_of(Sense), name)

        world = WorldProcess(simulation, bus, Hostile(), Interrupt())
        threads = [Thread(target=run_robot, args=(bus, name, make, stop)) for name in NAMES]
        for thread in threads:
            thread.start()
        try:
            with caplog.at_level(logging.WARNING):
                world.run()
            for thread in threads:
                thread.join(WAIT_S)
        finally:
            stop.request()
            for thread in threads:
                thread.join(WAIT_S)
    assert simulation.exit_reason == TIME_LIMIT
    assert simulation.alive == NAMES
    ticks = round(4.0 / scenario.tick_s) + 1
    for name in NAMES:
        words = world.replies[name]
        assert words.complete
        assert words.wire is not None
        assert all(count.sent == count.received for count in words.wire.values())
        assert words.wire["sense"].received == ticks
        assert words.trajectory is not None
        assert len(words.trajectory.ticks) == ticks
    said = Counter(record.getMessage() for record in caplog.records)
    assert len(said) > 10
    assert max(said.values()) == 1
