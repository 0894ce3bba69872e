"""Covariances of poses: inverses, and how they travel with a pose."""

import numpy as np

from protocol.pose import FloatArray, Pose2


def invert_spd(matrix: FloatArray) -> FloatArray:
    """Inverse of a symmetric positive definite 3×3 matrix, symmetric to the last bit.

    Raises numpy.linalg.LinAlgError when it is singular.
    """
    inverse = np.linalg.inv(matrix)
    return np.asarray(0.5 * (inverse + inverse.T), dtype=np.float64)


def carry(covariance: FloatArray, T_a_b: Pose2) -> FloatArray:
    """Covariance of `T_map_b = T_map_a @ T_a_b` (3×3, tangent space at b) for an exact `T_a_b`.

    `covariance` is that of `T_map_a`, in the tangent space at a.
    """
    backward = T_a_b.inverse().adjoint()
    return np.asarray(backward @ covariance @ backward.T, dtype=np.float64)
