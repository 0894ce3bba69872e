"""Trajectory errors: one alignment for the team, and numbers that geometry gives by hand."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from protocol.messages import TrajectoryReply
from protocol.pose import FloatArray, Pose2, compose
from world.accuracy import align, align_team, distances, match, rmse

ANGLES = st.floats(-math.pi, math.pi)
METRES = st.floats(-50.0, 50.0)


def way(seed: int, ticks: int = 80) -> FloatArray:
    """A wandering trajectory (n×3)."""
    rng = np.random.default_rng(seed)
    poses = np.cumsum(rng.normal(0.0, 0.2, (ticks, 3)), axis=0)
    return poses + rng.uniform(-5.0, 5.0, 3)


def moved(T: Pose2, poses: FloatArray) -> FloatArray:
    return compose(T.to_array(), poses)


def reply(ticks: list[int], final: FloatArray, /, **changes: object) -> TrajectoryReply:
    fields = {
        "ticks": ticks,
        "stamps": [0.1 * tick for tick in ticks],
        "online": final,
        "final": final,
        "dead_reckoned": final,
        "nodes": np.zeros((0, 3)),
        "edge_nodes": np.zeros((0, 2)),
        "edge_values": np.zeros((0, 9)),
        "journal_digest": "",
        "frames_sent": 0,
        "bytes_sent": 0,
        "frames_heard": 0,
        "bytes_heard": 0,
    }
    return TrajectoryReply.model_validate(fields | changes)


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 1000), x=METRES, y=METRES, theta=ANGLES)
def test_a_rigid_motion_is_found_and_leaves_no_error(
    seed: int, x: float, y: float, theta: float
) -> None:
    T_world_map, estimated = Pose2(x, y, theta), way(seed)
    true = moved(T_world_map, estimated)
    found = align(estimated, true)
    assert (found.x, found.y) == pytest.approx((x, y), abs=1e-6)
    assert math.cos(found.theta - theta) == pytest.approx(1.0)
    assert rmse([distances(found, estimated, true)]) == pytest.approx(0.0, abs=1e-7)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1000), dx=st.floats(-0.1, 0.1), dtheta=st.floats(-0.1, 0.1))
def test_no_other_motion_does_better(seed: int, dx: float, dtheta: float) -> None:
    rng = np.random.default_rng(seed)
    true = way(seed)
    estimated = moved(Pose2(1.0, 2.0, 0.5), true) + rng.normal(0.0, 0.1, true.shape)
    best = align(estimated, true)
    other = Pose2(best.x + dx, best.y - dx, best.theta + dtheta)
    least, more = (rmse([distances(T, estimated, true)]) for T in (best, other))
    assert least is not None
    assert more is not None
    assert least <= more + 1e-12


def test_an_error_between_robots_is_not_aligned_away() -> None:
    first, second = way(1), way(2)
    shifted = second + np.array([0.4, 0.0, 0.0])
    T = align_team([(first, first), (shifted, second)])
    together = rmse([distances(T, first, first), distances(T, shifted, second)])
    assert together == pytest.approx(0.2, abs=0.02)
    alone = align(shifted, second)
    assert rmse([distances(alone, shifted, second)]) == pytest.approx(0.0, abs=1e-9)


def test_robots_that_never_moved_are_aligned_by_their_headings() -> None:
    true = np.tile([3.0, 4.0, 1.0], (5, 1))
    estimated = np.tile([0.0, 0.0, 0.25], (5, 1))
    found = align(estimated, true)
    assert (found.x, found.y, found.theta) == pytest.approx((3.0, 4.0, 0.75))


def test_nothing_to_align_is_the_identity_and_no_error_a_number() -> None:
    assert align_team([]) == Pose2(0.0, 0.0, 0.0)
    assert rmse([]) is None


def test_poses_are_matched_by_tick() -> None:
    truth = way(3)
    ticks = [0, 2, 5, 79]
    track = match(reply(ticks, truth[ticks]), truth)
    assert track is not None
    assert np.array_equal(track.true, truth[ticks])
    late = match(reply([79, 80, 5000], truth[[79, 0, 0]]), truth)
    assert late is not None
    assert np.array_equal(late.true, truth[[79]])


def test_a_reply_of_ticks_that_never_were_is_not_compared() -> None:
    assert match(reply([5000, 5001], np.zeros((2, 3))), way(4)) is None


@pytest.mark.parametrize(
    "changes",
    [
        {"ticks": [0]},
        {"ticks": [-1, 2]},
        {"ticks": [1, 1]},
        {"online": np.zeros((3, 3))},
        {"final": np.zeros((2, 2))},
        {"dead_reckoned": [[0.0, math.nan, 0.0], [0.0, 0.0, 0.0]]},
        {"final": [[0.0, math.inf, 0.0], [0.0, 0.0, 0.0]]},
        {"edge_nodes": [[0, 1]]},
        {"edge_nodes": [[0, 1]], "edge_values": np.zeros((1, 9))},
    ],
)
def test_a_reply_that_does_not_fit_together_is_refused(changes: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        reply([0, 1], np.zeros((2, 3)), **changes)
