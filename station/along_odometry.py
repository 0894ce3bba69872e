"""Poses between known poses, as the odometry tells the way from one to the next."""

import numpy as np
from scipy.interpolate import PchipInterpolator

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
    be smooth between its readings, since wheels do not jump in speed, and monotone (Fritsch and
    Carlson, 1980), since they stand still for some of them.
    """
    if len(stamps) < 2:
        return np.broadcast_to(poses[0], (len(wanted), 3)).copy()
    after = np.clip(np.searchsorted(stamps, wanted), 1, len(stamps) - 1)
    before = after - 1
    share = (wanted - stamps[before]) / (stamps[after] - stamps[before])
    share = np.clip(share, 0.0, 1.0)
    if wanted_odometry is None:
        wanted_odometry = _between_readings(stamps, odometry, wanted)
    forwards = compose(poses[before], compose(invert(odometry[before]), wanted_odometry))
    backwards = compose(poses[after], compose(invert(odometry[after]), wanted_odometry))
    return blend(forwards, backwards, share)


def _between_readings(stamps: FloatArray, odometry: FloatArray, wanted: FloatArray) -> FloatArray:
    """What the wheels' own poses (n×3) were at times between their readings (m×3)."""
    readings = np.column_stack([odometry[:, :2], np.unwrap(odometry[:, 2])])
    poses = PchipInterpolator(stamps, readings)(np.clip(wanted, stamps[0], stamps[-1]))
    poses[:, 2] = wrap_angles(poses[:, 2])
    return np.asarray(poses, dtype=np.float64)
