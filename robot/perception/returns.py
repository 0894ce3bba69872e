"""The returns of a scan as points on surfaces: what is drawn into submaps and matched to them."""

import functools
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from protocol.config import LidarConfig
from protocol.pose import FloatArray, Pose2
from robot.perception import returns_kernels
from robot.perception.scan import LaserScan

IntArray = npt.NDArray[np.int64]

# Gaps up to this length between neighbouring returns may be one surface; doors are wider.
MAX_GAP_M = 0.5
# Reach of the neighbourhood in which a surface's direction is fitted, at least.
NORMAL_RADIUS_M = 0.15
# Returns closer together than this share the weight of one: near walls must not drag the pose.
SPACING_M = 0.05


@dataclass(frozen=True, slots=True)
class Returns:
    """Returns of one scan in the robot's frame.

    `values` (n×6): x, y (m), surface normal x, y (0, 0 where the neighbours lie on no line),
    weight (0…1), σ of the point (m). `links` (n): 1 where the next return lies on the same surface.
    """

    values: FloatArray
    links: IntArray

    def __len__(self) -> int:
        return len(self.values)

    @property
    def points(self) -> FloatArray:
        """n×2, m."""
        return self.values[:, :2]

    def are_moved(self, turned_rad: float, far_m: float) -> bool:
        """Whether a turn of the robot moves most of them by more than `far_m`."""
        if turned_rad <= 0.0:
            return False
        beyond = returns_kernels.count_beyond(self.values, far_m / turned_rad)
        return bool(2 * beyond > len(self.values))

    @staticmethod
    def unlinked(values: FloatArray) -> "Returns":
        """Points (n×6) of which none is known to lie on one surface with the next."""
        return Returns(np.ascontiguousarray(values), np.zeros(len(values), dtype=np.int64))

    def moved(self, T_to_here: Pose2) -> "Returns":
        """The same in another frame."""
        values = self.values.copy()
        values[:, :2] = T_to_here.apply(values[:, :2])
        values[:, 2:4] = Pose2(0.0, 0.0, T_to_here.theta).apply(values[:, 2:4])
        return Returns(values, self.links)

    def facing(self) -> "Returns":
        """The same with normals towards the sensor."""
        values = self.values.copy()
        away = (values[:, :2] * values[:, 2:4]).sum(axis=1) > 0.0
        values[away, 2:4] *= -1.0
        return Returns(values, self.links)

    def thinned(self, limit: int) -> "Returns":
        """At most `limit` of the returns, spread evenly over the weight, for a search."""
        values = np.empty((limit, 6))
        count = returns_kernels.thin(self.values, limit, values)
        return Returns.unlinked(values[:count])


def noise_model(lidar: LidarConfig) -> FloatArray:
    """Eq. 14 as the kernels take it: σ_r at 0 m, its growth per metre, variance per metre, σ_θ."""
    linear, growth, per_metre = {
        "modern": (0.01, 0.005, 0.0),
        "paper": (0.0, 0.0, 0.01),
        "none": (0.0, 0.0, 0.0),
    }[lidar.noise]
    return np.array([linear, growth, per_metre, lidar.sigma_angle_rad])


@dataclass(frozen=True, slots=True)
class _Beams:
    """Of all scans of one range finder: cosines and sines (n×2) of its angles, the angle from one
    beam to the next, and whether the last one is next to the first."""

    directions: FloatArray
    increment: float
    wrap: bool


@functools.lru_cache(maxsize=16)
def _beams(angles: bytes) -> _Beams:
    """From the bytes of the angles (n)."""
    values = np.frombuffer(angles, dtype=np.float64)
    directions = np.empty((len(values), 2))
    returns_kernels.directions(values.copy(), directions)
    increment = float(values[1] - values[0])
    wrap = bool(abs(len(values) * increment - 2.0 * math.pi) < 0.5 * increment)
    return _Beams(directions, increment, wrap)


def describe_returns(scan: LaserScan, noise: FloatArray, max_range_m: float) -> Returns:
    """The returns of a scan up to a range; beams without one (NaN, +inf) leave no trace."""
    ranges = np.array(scan.ranges, dtype=np.float64)
    beams = _beams(np.asarray(scan.angles, dtype=np.float64).tobytes())
    values = np.empty((len(ranges), 6))
    links = np.empty(len(ranges), dtype=np.int64)
    count = returns_kernels.describe_returns(
        ranges,
        beams.directions,
        beams.increment,
        beams.wrap,
        max_range_m,
        MAX_GAP_M,
        NORMAL_RADIUS_M,
        SPACING_M,
        noise,
        values,
        links,
    )
    return Returns(values[:count], links[:count])
