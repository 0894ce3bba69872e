"""Covariances of poses against the matrices that they stand for."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from protocol.pose import FloatArray, Pose2
from robot.slam.gaussian import carry, invert_spd

ROOTS = arrays(np.float64, (3, 3), elements=st.floats(-3.0, 3.0))
POSES = st.builds(Pose2, st.floats(-9.0, 9.0), st.floats(-9.0, 9.0), st.floats(-3.1, 3.1))


@given(root=ROOTS)
def test_the_inverse_undoes_the_matrix(root: FloatArray) -> None:
    matrix = root @ root.T + 0.1 * np.eye(3)
    inverse = invert_spd(matrix)
    assert np.array_equal(inverse, inverse.T)
    assert np.allclose(inverse @ matrix, np.eye(3), atol=1e-8)


@given(root=ROOTS, pose=POSES)
def test_a_covariance_travels_by_the_adjoint(root: FloatArray, pose: Pose2) -> None:
    covariance = root @ root.T
    back = pose.inverse().adjoint()
    carried = carry(covariance, pose)
    assert np.array_equal(carried, carried.T)
    assert np.allclose(carried, back @ covariance @ back.T, atol=1e-9)
    assert np.allclose(carry(carried, pose.inverse()), covariance, atol=1e-8)


@pytest.mark.parametrize("diagonal", [(1.0, 0.0, 1.0), (1.0, 1.0, -1.0), (np.nan, 1.0, 1.0)])
def test_what_is_no_covariance_is_refused(diagonal: tuple[float, float, float]) -> None:
    with pytest.raises(np.linalg.LinAlgError, match="positive definite"):
        invert_spd(np.diag(diagonal))
