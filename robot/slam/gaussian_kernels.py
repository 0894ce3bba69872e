"""Compiled algebra of 3×3 covariances, for which NumPy's calls cost more than the sums."""

import math

import numpy as np

from protocol.kernel import inlined, kernel


@kernel
def invert_spd(matrix, out):
    """Inverse of a symmetric positive definite 3×3 matrix by cofactors; False if it is not one."""
    a, b, c = matrix[0, 0], matrix[0, 1], matrix[0, 2]
    d, e, f = matrix[1, 1], matrix[1, 2], matrix[2, 2]
    aa = d * f - e * e
    ab = c * e - b * f
    ac = b * e - c * d
    determinant = a * aa + b * ab + c * ac
    if not (a > 0.0 and a * d - b * b > 0.0 and determinant > 0.0):
        return False
    out[0, 0] = aa / determinant
    out[0, 1] = out[1, 0] = ab / determinant
    out[0, 2] = out[2, 0] = ac / determinant
    out[1, 1] = (a * f - c * c) / determinant
    out[1, 2] = out[2, 1] = (b * c - a * e) / determinant
    out[2, 2] = (a * d - b * b) / determinant
    return True


@kernel
def invert_sum(first, second, out):
    """`invert_spd` of the sum of two matrices."""
    total = np.empty((3, 3))
    for r in range(3):
        for c in range(3):
            total[r, c] = first[r, c] + second[r, c]
    return invert_spd(total, out)


@kernel
def advance(covariance, x, y, theta, added, out):
    """out = Ad(T⁻¹) covariance Ad(T⁻¹)ᵀ + added for T = (x, y, theta)."""
    _carry(covariance, x, y, theta, out)
    for r in range(3):
        for c in range(3):
            out[r, c] += added[r, c]


@kernel
def carry(covariance, x, y, theta, out):
    """out = Ad(T⁻¹) covariance Ad(T⁻¹)ᵀ for T = (x, y, theta)."""
    _carry(covariance, x, y, theta, out)


@inlined
def _carry(covariance, x, y, theta, out):
    """out = Ad(T⁻¹) covariance Ad(T⁻¹)ᵀ for T = (x, y, theta)."""
    c = math.cos(theta)
    s = math.sin(theta)
    # The columns of Ad(T⁻¹): rotation back, and the lever of a turn.
    u = c * -y + s * x
    v = s * y + c * x
    sxx = covariance[0, 0]
    sxy = covariance[0, 1]
    sxt = covariance[0, 2]
    syy = covariance[1, 1]
    syt = covariance[1, 2]
    stt = covariance[2, 2]
    rxt = c * sxt + s * syt
    ryt = -s * sxt + c * syt
    rxx = c * c * sxx + 2.0 * c * s * sxy + s * s * syy
    ryy = s * s * sxx - 2.0 * c * s * sxy + c * c * syy
    rxy = c * s * (syy - sxx) + (c * c - s * s) * sxy
    out[0, 0] = rxx + 2.0 * u * rxt + u * u * stt
    out[1, 1] = ryy + 2.0 * v * ryt + v * v * stt
    out[0, 1] = out[1, 0] = rxy + u * ryt + v * rxt + u * v * stt
    out[0, 2] = out[2, 0] = rxt + u * stt
    out[1, 2] = out[2, 1] = ryt + v * stt
    out[2, 2] = stt
