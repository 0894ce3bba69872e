"""Poses between known poses, as the odometry tells the way from one to the next."""

import numpy as np

from protocol.pose import FloatArray, compose, invert, wrap_angles


def blend(a: FloatArray, b: FloatArray, share: FloatArray) -> FloatArray:
    """Poses n×3 that are `share` (n, 0…1) of the way from `a` to `b`, both n×3."""
    step = b - a
    step[:, 2] = wrap_angles(step[:, 2])
    out = np.asarray(a + share[:, None] * step, dtype=np.float64)
    out[:, 2] = wrap_angles(out[:, 2])
    return out


def follow_odometry(
    stamps: FloatArray,
    odometry: FloatArray,
    poses: FloatArray,
    wanted: FloatArray,
    wanted_odometry: FloatArray | None = None,
) -> FloatArray:
    """Poses (n×3) at the times `wanted` (n).

    `odometry` and `poses` (m×3) are known at `stamps` (m, increasing). Each pose follows the
    odometry from the known pose before it, and what the odometry then lacks at the next one is
    spread over the time between. Without `wanted_odometry` (n×3) the odometry itself is taken to
    be straight between its readings.
    """
    if len(stamps) < 2:
        return np.broadcast_to(poses[0], (len(wanted), 3)).copy()
    after = np.clip(np.searchsorted(stamps, wanted), 1, len(stamps) - 1)
    before = after - 1
    share = (wanted - stamps[before]) / (stamps[after] - stamps[before])
    share = np.clip(share, 0.0, 1.0)
    if wanted_odometry is None:
        wanted_odometry = blend(odometry[before], odometry[after], share)
    forwards = compose(poses[before], compose(invert(odometry[before]), wanted_odometry))
    backwards = compose(poses[after], compose(invert(odometry[after]), wanted_odometry))
    return blend(forwards, backwards, share)
