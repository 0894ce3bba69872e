"""Poses and how well they are known, in few bytes.

x and y of a pose are 24 bits each in steps of 0.25 mm, θ is 16 bits of a turn: little beside the
noise of a range finder. A symmetric 3×3 matrix is its Cholesky factor, 6 float16 (lower triangle,
row by row), so that whatever the bytes, what is read has no negative eigenvalue. Sigma, what the
coordinates err by, is 3 float16. All little-endian.
"""

import math
from itertools import accumulate, pairwise

import numpy as np

from protocol.pose import FloatArray, Pose2, wrap_angle

LOWER = np.tril_indices(3)
MAX_FLOAT16 = float(np.finfo(np.float16).max)
STEP_M, STEP_RAD = 0.00025, 2.0 * math.pi / (1 << 16)
POSE_BYTES, SIGMA_BYTES, MATRIX_BYTES = 8, 6, 12


def pack_pose(pose: Pose2) -> bytes:
    """A pose up to 2 km away; what is farther comes out as far as that."""
    x, y, turn = pose.x / STEP_M, pose.y / STEP_M, wrap_angle(pose.theta) / STEP_RAD
    return _whole(x, 3) + _whole(y, 3) + _whole(turn, 2)


def unpack_pose(data: bytes) -> Pose2:
    """Raises ValueError on bytes of another length; so do the others."""
    sized(data, POSE_BYTES)
    x, y, turn = (int.from_bytes(part, "little", signed=True) for part in split(data, 3, 3))
    return Pose2(x * STEP_M, y * STEP_M, turn * STEP_RAD)


def pack_sigma(sigma: FloatArray) -> bytes:
    """Standard deviations (3)."""
    return _halves(sigma)


def unpack_sigma(data: bytes) -> FloatArray:
    """Likewise; raises ValueError on what is not finite, too."""
    return _read_halves(data, SIGMA_BYTES)


def pack_matrix(matrix: FloatArray) -> bytes:
    """A symmetric 3×3 matrix without negative eigenvalues."""
    return _halves(_cholesky(matrix)[LOWER])


def unpack_matrix(data: bytes) -> FloatArray:
    """Likewise."""
    factor = np.zeros((3, 3))
    factor[LOWER] = _read_halves(data, MATRIX_BYTES)
    return factor @ factor.T


def split(data: object, *sizes: int) -> list[bytes]:
    """The first parts of some bytes, and what follows them."""
    if not isinstance(data, bytes):
        raise ValueError("expected bytes")
    ends = [0, *accumulate(sizes), len(data)]
    return [data[begin:end] for begin, end in pairwise(ends)]


def sized(data: object, size: int) -> bytes:
    """The data, if they are bytes and so many."""
    if not isinstance(data, bytes) or len(data) != size:
        raise ValueError(f"expected {size} bytes")
    return data


def _whole(value: float, size: int) -> bytes:
    """The nearest number that so many bytes hold."""
    limit = 1 << (8 * size - 1)
    return min(max(round(value), -limit), limit - 1).to_bytes(size, "little", signed=True)


def _halves(values: FloatArray) -> bytes:
    clipped = np.clip(values, -MAX_FLOAT16, MAX_FLOAT16)
    return np.asarray(clipped, dtype="<f2").tobytes()


def _read_halves(data: object, size: int) -> FloatArray:
    values = np.frombuffer(sized(data, size), dtype="<f2").astype(np.float64)
    if not np.isfinite(values).all():
        raise ValueError("a number is not finite")
    return values


def _cholesky(matrix: FloatArray) -> FloatArray:
    """The lower factor of a 3×3 matrix, also of one that is singular."""
    factor = np.zeros((3, 3))
    for k in range(3):
        below = matrix[k:, k] - factor[k:, :k] @ factor[k, :k]
        if below[0] > 0.0:
            factor[k:, k] = below / math.sqrt(below[0])
    return factor
