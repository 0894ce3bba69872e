"""Keyframes that are told against those before them: small, equal on both sides, and no trap."""

import contextlib

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.config import LidarConfig
from protocol.errors import MalformedMessageError
from protocol.pose import IDENTITY, FloatArray, Pose2
from robot.slam.engine import Anchor, Entry, Keyframe
from robot.team.entries import Hello, Known, decode_entry, encode_entry
from robot.team.keyframes import StoredKeyframe
from robot.team.log_context import RUN, LogContext

LIDAR = LidarConfig()
HELLO = Hello(None, LIDAR.beams, LIDAR.angle_min_rad, LIDAR.increment_rad, 12.0, 0.2)
STEP = Pose2(0.3, 0.02, 0.3)
PER_ANCHOR = 6


def room_seen_from(pose: Pose2, rng: np.random.Generator) -> FloatArray:
    """Ranges (n) in a room of 8 by 6 m round the origin, as a common range finder errs."""
    angles = HELLO.angles + pose.theta
    along, up = np.cos(angles) + 1e-12, np.sin(angles) + 1e-12
    walls = np.minimum((np.sign(along) * 4.0 - pose.x) / along, (np.sign(up) * 3.0 - pose.y) / up)
    return np.asarray(walls + rng.normal(0.0, 0.01 + 0.005 * walls), dtype=np.float64)


def drive(count: int) -> list[Entry | Hello]:
    """What a robot writes that goes round in the room."""
    rng = np.random.default_rng(3)
    entries: list[Entry | Hello] = [HELLO, Anchor(0, Pose2(0.0, -1.0, 0.0), np.eye(3))]
    pose = Pose2(0.0, -1.0, 0.0)
    T_anchor_now = IDENTITY
    for n in range(count):
        if n and n % PER_ANCHOR == 0:
            entries.append(Anchor(n // PER_ANCHOR, T_anchor_now, np.eye(3)))
            T_anchor_now = IDENTITY
        ranges = room_seen_from(pose, rng)
        entries.append(Keyframe(n, 5 * n, n // PER_ANCHOR, T_anchor_now, np.eye(3) * 1e-4, ranges))
        pose, T_anchor_now = pose @ STEP, T_anchor_now @ STEP
    return entries


def written(entries: list[Entry | Hello]) -> tuple[list[bytes], list[Known]]:
    """Bodies, and what their writer reads in them."""
    context = LogContext()
    bodies, known = [], []
    for n, entry in enumerate(entries):
        bodies.append(encode_entry(entry, context))
        known.append(decode_entry(bodies[-1], n, context))
        context.take(known[-1])
    return bodies, known


def keyframes(known: list[Known]) -> list[StoredKeyframe]:
    return [entry for entry in known if isinstance(entry, StoredKeyframe)]


def test_a_follower_says_what_a_keyframe_alone_says() -> None:
    entries = drive(40)
    _, known = written(entries)
    alone = [decode_entry(encode_entry(entry), n) for n, entry in enumerate(entries)]
    for ours, theirs in zip(keyframes(known), keyframes(alone), strict=True):
        assert (ours.tick, ours.anchor, ours.beams) == (theirs.tick, theirs.anchor, theirs.beams)
        assert ours.T_anchor_keyframe == theirs.T_anchor_keyframe
        assert ours.scan == theirs.scan
        np.testing.assert_array_equal(ours.covariance, theirs.covariance)


def test_followers_take_little_more_than_half_the_bytes() -> None:
    entries = drive(30)
    bodies, known = written(entries)
    told = [len(body) for body, entry in zip(bodies, known, strict=True) if is_follower(entry)]
    alone = [len(encode_entry(entry)) for entry in entries if isinstance(entry, Keyframe)]
    assert len(told) == 29
    assert np.mean(told) < 0.6 * np.mean(alone)


def is_follower(entry: Known) -> bool:
    return isinstance(entry, StoredKeyframe) and entry.follows


def test_now_and_then_a_keyframe_stands_alone() -> None:
    _, known = written(drive(3 * RUN))
    alone = [n for n, entry in enumerate(keyframes(known)) if not entry.follows]
    assert alone == [0, RUN, 2 * RUN]


def test_what_cannot_be_read_spoils_followers_until_one_stands_alone() -> None:
    bodies, known = written(drive(2 * RUN))
    spoilt = next(n for n, entry in enumerate(known) if is_follower(entry))
    bodies[spoilt] = bodies[spoilt][:-1]
    context, missing = LogContext(), []
    for n, body in enumerate(bodies):
        try:
            entry = decode_entry(body, n, context)
        except MalformedMessageError:
            context.break_off()
            missing.append(n)
            continue
        context.take(entry)
        if isinstance(entry, StoredKeyframe):
            expected = known[n]
            assert isinstance(expected, StoredKeyframe)
            assert entry.scan == expected.scan
    alone = [n for n, entry in enumerate(known) if isinstance(entry, StoredKeyframe)]
    alone = [n for n in alone[1:] if not is_follower(known[n])]
    assert missing == [n for n in range(spoilt, alone[0]) if is_follower(known[n])]


def test_a_follower_needs_what_it_follows() -> None:
    bodies, known = written(drive(3))
    follower = next(n for n, entry in enumerate(known) if is_follower(entry))
    with pytest.raises(MalformedMessageError, match="follows"):
        decode_entry(bodies[follower], follower)
    with pytest.raises(MalformedMessageError, match="follows"):
        decode_entry(bodies[follower], follower, LogContext())


def test_a_jump_over_many_anchors_stands_alone() -> None:
    entries: list[Entry | Hello] = drive(1)
    entries += [Anchor(n, STEP, np.eye(3)) for n in range(1, 40)]
    first = entries[2]
    assert isinstance(first, Keyframe)
    entries.append(Keyframe(1, 9, 39, IDENTITY, np.eye(3), first.ranges))
    _, known = written(entries)
    assert [entry.follows for entry in keyframes(known)] == [False, False]


@given(st.binary(max_size=150), st.integers(0, 40), st.integers(-20, 20))
def test_no_bytes_break_a_reader_in_the_middle_of_a_log(
    data: bytes, ticks: int, anchors: int
) -> None:
    context = LogContext()
    for n, body in enumerate(written(drive(4))[0]):
        context.take(decode_entry(body, n, context))
    for body in (
        data,
        encoded([5, ticks, anchors, data]),
        encoded([5, ticks, 0, bytes(11) + data]),
    ):
        with contextlib.suppress(MalformedMessageError):
            context.take(decode_entry(body, 9, context))


@given(st.floats(-1e9, 1e9), st.floats(1e-300, 1e9), st.floats(-1e5, 1e5))
def test_no_range_finder_breaks_foresight(angle_min: float, increment: float, x: float) -> None:
    """Whatever a stranger says of its beams, and however far it jumps, looking ahead comes to an
    end."""
    context = LogContext()
    hello = Hello(None, 30, angle_min, increment, 12.0, 0.2)
    context.take(hello)
    context.take(Anchor(0, IDENTITY, np.eye(3)))
    ranges = np.linspace(1.0, 2.0, 30)
    alone = decode_entry(encode_entry(Keyframe(0, 0, 0, IDENTITY, np.eye(3), ranges)), 2)
    context.take(alone)
    foreseen = context.foresee(0, Pose2(x, 0.0, 1.0))
    assert len(foreseen) == 30


def encoded(fields: list[object]) -> bytes:
    packed: bytes = msgpack.packb(fields, use_bin_type=True)
    return packed
