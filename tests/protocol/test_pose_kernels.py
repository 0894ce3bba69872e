"""SE(2) in compiled loops says what poses say."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol.pose import FloatArray, Pose2
from protocol.pose_kernels import apply, apply_inverse, between, compose, exp, wrap

METRES = st.floats(-100.0, 100.0)
POSES = st.tuples(METRES, METRES, st.floats(-math.pi, 3.14)).map(np.array)


def same(row: FloatArray, pose: Pose2) -> bool:
    turn = wrap(row[2] - pose.theta)
    return bool(np.allclose(row[:2], (pose.x, pose.y), atol=1e-9) and abs(turn) < 1e-9)


@settings(max_examples=50, deadline=None)
@given(POSES, POSES)
def test_they_compose_as_poses_do(a: FloatArray, b: FloatArray) -> None:
    out = np.empty(3)
    compose(a, b, out)
    assert same(out, Pose2.from_array(a) @ Pose2.from_array(b))
    between(a, b, out)
    assert same(out, Pose2.from_array(a).inverse() @ Pose2.from_array(b))
    x, y = apply_inverse(a, *apply(a, b[0], b[1]))
    assert np.allclose((x, y), b[:2], atol=1e-9)


@settings(max_examples=50, deadline=None)
@given(POSES, POSES)
def test_the_outcome_may_take_the_place_of_a_side(a: FloatArray, b: FloatArray) -> None:
    apart = np.empty(3)
    for made in (compose, between):
        made(a, b, apart)
        for side in (0, 1):
            sides = [a.copy(), b.copy()]
            made(sides[0], sides[1], sides[side])
            assert np.array_equal(sides[side], apart)


@settings(max_examples=50, deadline=None)
@given(POSES)
def test_a_twist_leads_where_poses_say(twist: FloatArray) -> None:
    out = np.empty(3)
    exp(twist, out)
    assert same(out, Pose2.exp(twist))


@given(st.floats(-50.0, 50.0))
def test_wrapped_angles_are_in_range(angle: float) -> None:
    assert -math.pi <= wrap(angle) < math.pi
    assert math.isclose(math.cos(wrap(angle)), math.cos(angle), abs_tol=1e-9)
