"""Every byte on the radio has one purpose, and the sums are what the world counts."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.messages import RadioFrame
from protocol.pose import Pose2
from robot.brain import Brain
from robot.slam.engine import Anchor, Closure, Keyframe
from robot.team.beacon import BEACON, Beacon, encode_beacon
from robot.team.entries import encode_entry
from robot.team.journal import EntryName, LogName
from robot.team.parcels import ENTRIES, pack
from robot.team.purposes import FRAMES, LIVE, VECTORS, Usage, book
from world.referee import Referee
from world.scenario import RobotSpec, Scenario
from world.simulation import Simulation

POSE = Pose2(1.0, 2.0, 0.5)


def usage_of(*frames: RadioFrame) -> Usage:
    usage: Usage = {}
    for frame in frames:
        book(usage, frame)
    return usage


def test_entries_are_told_apart() -> None:
    entries = (
        Anchor(0, POSE, np.eye(3)),
        Closure(1, 7, POSE, np.eye(3)),
        Keyframe(5, 120, 2, POSE, np.eye(3), np.linspace(1.0, 5.0, 50)),
    )
    bodies = [encode_entry(entry) for entry in entries]
    log = LogName("r1", 0)
    frames = pack("r2", [(EntryName(log, n), body) for n, body in enumerate(bodies)])
    usage = usage_of(*frames)
    sizes = dict(zip(("anchors", "closures", "keyframes"), map(len, bodies), strict=True))
    total = sum(frame.size_bytes for frame in frames)
    assert usage == {**sizes, FRAMES: total - sum(sizes.values())}


def test_a_beacon_is_live_state_and_talk() -> None:
    def beacon(vector: dict[LogName, int]) -> RadioFrame:
        told = Beacon(0, 3, POSE, np.full(3, 0.01), None, False, ("r2",), vector)
        return RadioFrame(kind=BEACON, payload=encode_beacon(told, ("r1", "r2")))

    short, long = usage_of(beacon({})), usage_of(beacon({LogName("r1", 0): 7}))
    assert set(short) == {LIVE, VECTORS}
    assert short[LIVE] == long[LIVE]
    assert short[VECTORS] < long[VECTORS]


@given(st.sampled_from([BEACON, ENTRIES, "part", "nonsense"]), st.binary(max_size=100))
def test_whatever_comes_each_byte_counts_once(kind: str, payload: bytes) -> None:
    frame = RadioFrame(kind=kind, payload=payload)
    usage = usage_of(frame)
    assert sum(usage.values()) == frame.size_bytes
    assert min(usage.values()) >= 0


@pytest.fixture(scope="module")
def talked() -> tuple[Simulation, dict[str, Brain]]:
    """Two robots that explored within earshot for a while."""
    robots = (RobotSpec(name="r1"), RobotSpec(name="r2"))
    simulation = Simulation(Scenario(map="rooms-small", seed=3, robots=robots, max_sim_s=12.0))
    brains = {name: Brain(simulation.robot_config(name)) for name in simulation.names}
    senses = simulation.step({})
    while not simulation.done:
        senses = simulation.step({name: brains[name].step(senses[name]) for name in senses})
    return simulation, brains


def test_robots_count_what_the_world_counts(talked: tuple[Simulation, dict[str, Brain]]) -> None:
    simulation, brains = talked
    replies = {
        name: (brain.map_reply(exact=True), brain.trajectory_reply())
        for name, brain in brains.items()
    }
    score = Referee(simulation).score(replies)
    assert score.ledger.equal
    delivered = simulation.ledger.delivered[..., 1]
    heard = {name: robot.heard_for for name, robot in score.robots.items()}
    assert sum(heard["r2"]["r1"].values()) == delivered[0, 1] > 0
    assert sum(heard["r1"]["r2"].values()) == delivered[1, 0] > 0
    purposes = score.radio.purposes
    assert sum(found.bytes_delivered for found in purposes.values()) == delivered.sum()
    assert {"keyframes", LIVE, VECTORS, FRAMES} <= set(purposes)


@pytest.mark.parametrize(
    "change",
    [lambda usage: {**usage, LIVE: usage[LIVE] + 1}, lambda usage: {LIVE: usage[LIVE]}],
)
def test_a_pair_that_counts_differently_is_noticed(
    talked: tuple[Simulation, dict[str, Brain]], change: Callable[[Usage], Usage]
) -> None:
    simulation, brains = talked
    reply = brains["r1"].trajectory_reply()
    wrong = reply.model_copy(update={"heard_for": {"r2": change(reply.heard_for["r2"])}})
    score = Referee(simulation).score({"r1": (None, wrong)})
    assert score.robots["r1"].ledger_equal is False
