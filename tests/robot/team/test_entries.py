"""Entries and scans survive their encodings, and nothing else is taken for one."""

import contextlib

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.errors import MalformedMessageError
from protocol.messages import Sighting
from protocol.pose import Pose2
from robot.slam.engine import Anchor, Closure, Keyframe
from robot.team import packing
from robot.team.beacon import Beacon, decode_beacon, encode_beacon
from robot.team.entries import Hello, decode_entry, encode_entry
from robot.team.journal import EntryName, LogName, decode_record, encode_record
from robot.team.keyframes import StoredKeyframe
from robot.team.scan_codec import STEP_M, STEP_SHARE

ROSTER = ("r1", "r2", "r3")
POSE = Pose2(1.25, -0.5, 0.75)
MATRIX = np.array([[4.0, 1.0, 0.5], [1.0, 3.0, 0.25], [0.5, 0.25, 2.0]])


@given(st.binary(max_size=200))
def test_no_bytes_break_the_decoders(data: bytes) -> None:
    for decode in (
        lambda data: decode_beacon(data, ROSTER),
        decode_record,
        lambda body: decode_entry(body, 0),
    ):
        with contextlib.suppress(MalformedMessageError):
            decode(data)


@pytest.mark.parametrize(
    "entry",
    [
        Anchor(3, POSE, MATRIX),
        Closure(1, 7, POSE, MATRIX),
        Keyframe(5, 120, 2, POSE, MATRIX, np.array([1.0, np.inf, np.nan, 2.5])),
    ],
)
def test_entries_survive(entry: Anchor | Closure | Keyframe) -> None:
    back = decode_entry(encode_entry(entry), 5)
    assert type(back) is (StoredKeyframe if isinstance(entry, Keyframe) else type(entry))
    for name in type(entry).__slots__:
        ours, theirs = getattr(entry, name), getattr(back, name)
        if isinstance(ours, np.ndarray):
            # Half a step of a range, or twice half a level of a root.
            share, metres = (STEP_SHARE / 2, STEP_M / 2) if name == "ranges" else (0.075, 0.0)
            kept = np.diag(np.diag(ours)) if name == "covariance" else ours
            np.testing.assert_allclose(theirs, kept, rtol=share, atol=metres)
        elif isinstance(ours, Pose2):
            assert_packed(theirs, ours)
        else:
            assert theirs == ours


def assert_packed(back: Pose2, pose: Pose2) -> None:
    """Within half a step of either kind, and the float's own."""
    step = back.inverse() @ pose
    assert max(abs(back.x - pose.x), abs(back.y - pose.y)) <= 0.5 * packing.STEP_M + 1e-9
    assert abs(step.theta) <= packing.STEP_RAD


@given(st.floats(-2000.0, 2000.0), st.floats(-2000.0, 2000.0), st.floats(-10.0, 10.0))
def test_a_pose_survives_within_half_a_step(x: float, y: float, theta: float) -> None:
    pose = Pose2(x, y, theta)
    assert_packed(packing.unpack_pose(packing.pack_pose(pose)), pose)


def test_a_pose_beyond_what_is_packed_stays_at_the_edge() -> None:
    far = packing.unpack_pose(packing.pack_pose(Pose2(1e7, -1e7, 0.0)))
    assert far.x == pytest.approx(2097.15, abs=0.01)
    assert far.y == pytest.approx(-2097.15, abs=0.01)


@pytest.mark.parametrize("start", [None, Pose2(0.1, 0.2, 0.3)])
def test_hello_survives(start: Pose2 | None) -> None:
    hello = Hello(start, 257, -np.pi, 0.0244, 12.0, 0.2)
    assert decode_entry(encode_entry(hello), 0) == hello


def test_every_truncation_is_noticed() -> None:
    body = encode_entry(Keyframe(0, 1, 0, POSE, MATRIX, np.linspace(1.0, 5.0, 50)))
    for length in range(len(body)):
        with pytest.raises(MalformedMessageError):
            decode_entry(body[:length], 0)


def test_values_out_of_bounds_are_refused() -> None:
    with pytest.raises(MalformedMessageError):
        decode_entry(encode_entry(Anchor(0, Pose2(float("nan"), 0.0, 0.0), MATRIX)), 0)
    with pytest.raises(MalformedMessageError):
        decode_entry(encode_entry(Closure(4, 4, POSE, MATRIX)), 0)


@given(st.lists(st.floats(-10.0, 10.0), min_size=9, max_size=9))
def test_a_matrix_survives_to_some_percent(values: list[float]) -> None:
    root = np.array(values).reshape(3, 3)
    matrix = root @ root.T
    back = decode_entry(encode_entry(Anchor(0, POSE, matrix)), 0)
    assert isinstance(back, Anchor)
    assert np.abs(back.information - matrix).max() <= 0.075 * np.diag(matrix).max() + 1e-3


def test_the_direction_that_a_corridor_leaves_open_survives() -> None:
    """A millimetre across and ten metres along: what is not known must not look known."""
    turn = Pose2(0.0, 0.0, 0.7).adjoint()
    matrix = turn.T @ np.diag([1e-2, 1e6, 1e7]) @ turn
    back = decode_entry(encode_entry(Anchor(0, POSE, matrix)), 0)
    assert isinstance(back, Anchor)
    least = np.linalg.eigvalsh(back.information)[0]
    assert least < 1.0, "the open direction is held to a metre at most"


@given(st.lists(st.floats(1e-4, 400.0), min_size=3, max_size=3))
def test_sigma_survives_to_a_level(values: list[float]) -> None:
    back = packing.unpack_sigma(packing.pack_sigma(np.array(values)))
    np.testing.assert_allclose(back, values, rtol=0.036)


def test_no_error_stays_none() -> None:
    assert not packing.unpack_sigma(packing.pack_sigma(np.zeros(3))).any()


@pytest.mark.parametrize("matrix", [np.zeros((3, 3)), 1e12 * np.eye(3), -np.eye(3)])
def test_no_matrix_comes_out_with_a_negative_eigenvalue(matrix: np.ndarray) -> None:
    back = decode_entry(encode_entry(Anchor(0, POSE, matrix)), 0)
    assert isinstance(back, Anchor)
    assert np.linalg.eigvalsh(back.information).min() >= 0.0


@pytest.mark.parametrize(
    "vector",
    [
        {},
        {LogName("r1", 0): 17},
        {LogName("r3", 0): 1000},
        {LogName("r1", 0): 5, LogName("r1", 2): 17, LogName("stranger", 0): 3},
    ],
)
@pytest.mark.parametrize("hears", [(), ("r2",), ROSTER])
def test_beacons_survive(vector: dict[LogName, int], hears: tuple[str, ...]) -> None:
    sigma = np.array([0.5, 0.25, 0.125])
    seen = (
        Sighting(robot="r3", range_m=11.75, bearing_rad=-3.0),
        Sighting(robot="r1", range_m=0.5, bearing_rad=0.25),
    )
    beacon = Beacon(2, 5, POSE, sigma, None, True, hears, vector, seen)
    back = decode_beacon(encode_beacon(beacon, ROSTER), ROSTER)
    assert_packed(back.T_anchor_base, POSE)
    assert (back.incarnation, back.anchor, back.finished) == (2, 5, True)
    assert (back.hears, back.vector) == (hears, vector)
    for one, other in zip(back.sightings, seen, strict=True):
        assert one.robot == other.robot
        assert one.range_m == pytest.approx(other.range_m, abs=packing.STEP_M)
        assert one.bearing_rad == pytest.approx(other.bearing_rad, abs=packing.STEP_RAD)


@pytest.mark.parametrize("field, value", [(5, b""), (5, b"\0\0"), (6, [1] * 4), (8, b"123456x")])
def test_beacons_of_another_team_are_refused(field: int, value: object) -> None:
    beacon = Beacon(2, 5, POSE, np.zeros(3), None, True, (), {})
    fields = msgpack.unpackb(encode_beacon(beacon, ROSTER))
    fields[field] = value
    with pytest.raises(MalformedMessageError):
        decode_beacon(msgpack.packb(fields), ROSTER)


def test_records_survive() -> None:
    name = EntryName(LogName("r1", 0), 9)
    assert decode_record(encode_record(name, b"body")) == (name, b"body")
