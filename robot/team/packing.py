"""Poses and how well they are known, in few bytes.

x and y of a pose are 24 bits each in steps of 0.25 mm, θ is 16 bits of a turn: little beside the
noise of a range finder; range and bearing of what is seen likewise. Sigma, what the coordinates err
by, is 3 levels: a byte each, 0 for none, else one of 255 values 7 % apart. A symmetric 3×3 matrix
is its Cholesky factor, so that whatever the bytes, what is read has no negative eigenvalue: its
diagonal as 3 levels, then what stands below as float16 shares of the diagonal above it (row by
row), for directions must be right where sizes need not. All little-endian.
"""

import math
from itertools import accumulate, pairwise

import numpy as np

from protocol.pose import FloatArray, Pose2, wrap_angle

BELOW = np.tril_indices(3, -1)
MAX_FLOAT16 = float(np.finfo(np.float16).max)
STEP_M, STEP_RAD = 0.00025, 2.0 * math.pi / (1 << 16)
POSE_BYTES, DIRECTION_BYTES, SIGMA_BYTES, MATRIX_BYTES = 8, 5, 3, 9
LEVELS_AN_OCTAVE = 10
LEAST_SIGMA, LEAST_ROOT = 1e-5, 1e-2


def pack_pose(pose: Pose2) -> bytes:
    """A pose up to 2 km away; what is farther comes out as far as that."""
    return _whole(pose.x / STEP_M, 3) + _whole(pose.y / STEP_M, 3) + _turn(pose.theta)


def unpack_pose(data: bytes) -> Pose2:
    """Raises ValueError on bytes of another length; so do the others."""
    x, y, turn = _wholes(sized(data, POSE_BYTES), 3, 3)
    return Pose2(x * STEP_M, y * STEP_M, turn * STEP_RAD)


def pack_direction(range_m: float, bearing_rad: float) -> bytes:
    """Where something is seen, up to 2 km away."""
    return _whole(range_m / STEP_M, 3) + _turn(bearing_rad)


def unpack_direction(data: bytes) -> tuple[float, float]:
    """Range and bearing."""
    steps, turn = _wholes(sized(data, DIRECTION_BYTES), 3)
    return steps * STEP_M, turn * STEP_RAD


def pack_sigma(sigma: FloatArray) -> bytes:
    """Standard deviations (3)."""
    return _levels(sigma, LEAST_SIGMA)


def unpack_sigma(data: bytes) -> FloatArray:
    """Likewise."""
    return _read_levels(sized(data, SIGMA_BYTES), LEAST_SIGMA)


def pack_matrix(matrix: FloatArray) -> bytes:
    """A symmetric 3×3 matrix without negative eigenvalues."""
    factor = _cholesky(matrix)
    root = np.diag(factor)
    shares = factor / np.where(root > 0.0, root, 1.0)
    return _levels(root, LEAST_ROOT) + _halves(shares[BELOW])


def unpack_matrix(data: bytes) -> FloatArray:
    """Likewise; raises ValueError on what is not finite, too."""
    root, below = split(sized(data, MATRIX_BYTES), 3)
    shares = np.eye(3)
    shares[BELOW] = _read_halves(below)
    factor = shares * _read_levels(root, LEAST_ROOT)
    return np.asarray(factor @ factor.T, dtype=np.float64)


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


def checked_count(value: object, limit: int = 2**53) -> int:
    """A whole number from 0 to a limit, if it is one."""
    if type(value) is not int or not 0 <= value <= limit:
        raise ValueError(f"expected a number from 0 to {limit}")
    return value


def _whole(value: float, size: int) -> bytes:
    """The nearest number that so many bytes hold."""
    limit = 1 << (8 * size - 1)
    return min(max(round(value), -limit), limit - 1).to_bytes(size, "little", signed=True)


def _wholes(data: bytes, *sizes: int) -> list[int]:
    """The numbers in parts of some bytes, and in what follows them."""
    return [int.from_bytes(part, "little", signed=True) for part in split(data, *sizes)]


def _turn(angle_rad: float) -> bytes:
    return _whole(wrap_angle(angle_rad) / STEP_RAD, 2)


def _levels(values: FloatArray, least: float) -> bytes:
    """Numbers that are not negative, to 3.5 %."""
    octaves = np.log2(np.maximum(values, least) / least)
    levels = np.clip(np.rint(1.0 + LEVELS_AN_OCTAVE * octaves), 1, 255).astype(np.uint8)
    return np.where(values > 0.0, levels, 0).astype(np.uint8).tobytes()


def _read_levels(data: bytes, least: float) -> FloatArray:
    levels = np.frombuffer(data, dtype=np.uint8)
    values = least * np.exp2((levels - 1.0) / LEVELS_AN_OCTAVE)
    return np.asarray(np.where(levels > 0, values, 0.0), dtype=np.float64)


def _halves(values: FloatArray) -> bytes:
    clipped = np.clip(values, -MAX_FLOAT16, MAX_FLOAT16)
    return np.asarray(clipped, dtype="<f2").tobytes()


def _read_halves(data: bytes) -> FloatArray:
    values = np.frombuffer(data, dtype="<f2").astype(np.float64)
    if not np.isfinite(values).all():
        raise ValueError("a number is not finite")
    return values


def _cholesky(matrix: FloatArray) -> FloatArray:
    """The lower factor of a 3×3 matrix, also of one that is singular: what is known of a coordinate
    to a hundred metres at best is left out."""
    factor = np.zeros((3, 3))
    for k in range(3):
        below = matrix[k:, k] - factor[k:, :k] @ factor[k, :k]
        if below[0] > LEAST_ROOT**2:
            factor[k:, k] = below / math.sqrt(below[0])
    return factor
