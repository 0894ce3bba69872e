"""A range scan as the rest of the robot uses it."""

import functools
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from protocol.config import LidarConfig
from protocol.messages import Sighting
from protocol.pose import FloatArray
from robot.perception import scan_kernels

# A teammate's disc is cut out with this much more around it: the sighting is noisy, the disc moves.
TEAMMATE_MARGIN_M = 0.15


class LaserScan(NamedTuple):
    """One scan in the robot's frame (x forward, y left).

    `ranges` (n): metres; +inf where nothing was hit within `max_range_m`, NaN where the beam says
    nothing (a teammate stood there, or the value was invalid). `angles` (n): radians.
    """

    ranges: FloatArray
    angles: FloatArray
    max_range_m: float

    @property
    def hits(self) -> npt.NDArray[np.bool_]:
        """Which beams (n) met an obstacle."""
        return np.isfinite(self.ranges)

    @property
    def points(self) -> FloatArray:
        """Where beams met an obstacle: m×2, in beam order."""
        hits = self.hits
        r, a = self.ranges[hits], self.angles[hits]
        return np.stack([r * np.cos(a), r * np.sin(a)], axis=-1)


@functools.lru_cache(maxsize=16)
def beam_angles(lidar: LidarConfig) -> FloatArray:
    """The nominal direction of each beam (n), in radians: one array for all, not to be written
    to."""
    steps = np.arange(lidar.beams, dtype=np.float64)
    return lidar.angle_min_rad + steps * lidar.increment_rad


def perceive(
    ranges: npt.NDArray[np.float32],
    lidar: LidarConfig,
    sightings: tuple[Sighting, ...] = (),
    teammate_radius_m: float = 0.2,
) -> LaserScan:
    """A scan without what is not part of the building.

    Values that a range finder cannot mean (negative, NaN, below its minimum) become NaN, those
    beyond its maximum +inf, and beams that end on a sighted teammate become NaN.
    """
    angles = beam_angles(lidar)
    clean = np.array(ranges, dtype=np.float64)
    scan_kernels.clean(clean, lidar.min_range_m, lidar.max_range_m)
    for sighting in sightings:
        reach = teammate_radius_m + TEAMMATE_MARGIN_M
        centre = sighting.range_m
        half_width = np.arcsin(min(1.0, reach / max(centre, reach)))
        offset = np.abs((angles - sighting.bearing_rad + np.pi) % (2.0 * np.pi) - np.pi)
        on_it = (offset <= half_width) & (np.abs(clean - centre) <= reach)
        clean[on_it] = np.nan
    return LaserScan(clean, angles, lidar.max_range_m)
