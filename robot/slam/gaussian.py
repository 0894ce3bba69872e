"""Covariances of poses: inverses, and how they travel with a pose."""

import numpy as np

from protocol.pose import FloatArray, Pose2
from robot.slam import gaussian_kernels


def invert_spd(matrix: FloatArray) -> FloatArray:
    """Inverse of a symmetric positive definite 3×3 matrix, symmetric to the last bit.

    Raises numpy.linalg.LinAlgError when it is singular or indefinite.
    """
    inverse = np.empty((3, 3))
    if not gaussian_kernels.invert_spd(np.array(matrix, order="C"), inverse):
        raise np.linalg.LinAlgError("the matrix is not positive definite")
    return inverse


def invert_sum(first: FloatArray, second: FloatArray) -> FloatArray:
    """`invert_spd(first + second)`; arrays are taken as they are, in C order."""
    inverse = np.empty((3, 3))
    if not gaussian_kernels.invert_sum(first, second, inverse):
        raise np.linalg.LinAlgError("the sum is not positive definite")
    return inverse


def advance(covariance: FloatArray, T_a_b: Pose2, added: FloatArray) -> FloatArray:
    """`carry(covariance, T_a_b) + added`; arrays are taken as they are, in C order."""
    out = np.empty((3, 3))
    gaussian_kernels.advance(covariance, T_a_b.x, T_a_b.y, T_a_b.theta, added, out)
    return out


def carry(covariance: FloatArray, T_a_b: Pose2) -> FloatArray:
    """Covariance of `T_map_b = T_map_a @ T_a_b` (3×3, tangent space at b) for an exact `T_a_b`.

    `covariance` is that of `T_map_a`, in the tangent space at a.
    """
    carried = np.empty((3, 3))
    gaussian_kernels.carry(np.array(covariance, order="C"), T_a_b.x, T_a_b.y, T_a_b.theta, carried)
    return carried
