"""The occupancy map: counts of hits and misses from scans, each of which can be taken out.

Counts are integers, so that taking a scan out and putting it back elsewhere leaves no rounding
behind, and the map is the same in whatever order the scans came. It holds counts alone: who draws
a map knows what was drawn where.
"""

import math

import numpy as np

from maps.grid import OccupancyGrid
from protocol.config import LidarConfig
from protocol.errors import EarshotError
from protocol.pose import Pose2
from robot.mapping.kernels import beam_extents, content_box, count_scan, render
from robot.perception.scan import LaserScan

CHUNK = 64  # cells; the arrays and the published grid are multiples of it
HIT_WEIGHT = 4  # a cell is a wall from one hit in five scans on; 0.2 is the usual threshold
HIT_RANGE_M = 10.0  # farther out a return is less sure than a cell, and its wall is seen again
HIT_SIGMA_M = 0.25
GRAZING_M = 0.5
COUNT = np.uint16  # a scan counts a cell once: enough for 65,535 of them at one place
MAX_CELLS = 1 << 27  # half a kilometre square at 5 cm; beyond it a pose is broken


class MappingError(EarshotError):
    """A scan that cannot be mapped; the message says why."""


class OccupancyMap:
    """An occupancy grid that scans can be added to and removed from.

    `lidar` gives the noise of the ranges: free space ends two standard deviations before a
    return, and returns less sure than `HIT_SIGMA_M` show no obstacle.
    """

    def __init__(self, resolution: float = 0.05, lidar: LidarConfig | None = None) -> None:
        if not resolution > 0.0:
            raise MappingError(f"resolution {resolution} m: a cell needs a positive size")
        self.resolution = resolution
        self._noise = _noise_terms(lidar or LidarConfig())
        self._first_row = self._first_column = 0
        self._hits = np.zeros((0, 0), dtype=COUNT)
        self._misses = np.zeros((0, 0), dtype=COUNT)
        self._grid: OccupancyGrid | None = None
        self._known_cells = 0

    def add(self, pose: Pose2, scan: LaserScan) -> None:
        """Count a scan at a pose: +inf clears up to its maximum range, NaN says nothing.

        Raises MappingError on arrays of different lengths or a pose that is not finite.
        """
        _check(pose, scan)
        self._cover(pose, scan.max_range_m)
        self._count(pose, scan, 1)
        self._grid = None

    def remove(self, pose: Pose2, scan: LaserScan) -> None:
        """Take a scan out that was added at this very pose."""
        self._count(pose, scan, -1)
        self._grid = None

    def grid(self) -> OccupancyGrid:
        """The map, cropped to the chunks that hold anything known: a function of content alone."""
        if self._grid is None:
            self._grid, self._known_cells = self._render()
        return self._grid

    def live(self, pose: Pose2, scan: LaserScan) -> OccupancyGrid:
        """The map as it would be with one more scan, for planning; the map itself stays."""
        before = self.grid()
        self.add(pose, scan)
        overlaid, _ = self._render()
        self._count(pose, scan, -1)
        self._grid = before
        return overlaid

    def known_area(self) -> float:
        """The known area in m²."""
        self.grid()
        return self._known_cells * self.resolution**2

    def _count(self, pose: Pose2, scan: LaserScan, sign: int) -> None:
        floor, slope, root, hit_range = self._noise
        # As single precision has them, which is how they come over the wire.
        ranges = scan.ranges.astype(np.float32).astype(np.float64)
        clear, hit = beam_extents(
            ranges, scan.angles, scan.max_range_m, hit_range,
            floor, slope, root, self.resolution, GRAZING_M,
        )  # fmt: skip
        count_scan(
            self._hits, self._misses, self._first_row, self._first_column, self.resolution,
            pose.x, pose.y, pose.theta, clear, hit, scan.angles, sign,
        )  # fmt: skip

    def _cover(self, pose: Pose2, reach_m: float) -> None:
        """Grow the arrays, in chunks, until they hold every cell within reach."""
        reach = reach_m + 2.0 * self.resolution
        chunk_m = CHUNK * self.resolution
        first_row = math.floor((pose.y - reach) / chunk_m) * CHUNK
        first_column = math.floor((pose.x - reach) / chunk_m) * CHUNK
        end_row = math.ceil((pose.y + reach) / chunk_m) * CHUNK
        end_column = math.ceil((pose.x + reach) / chunk_m) * CHUNK
        height, width = self._hits.shape
        if height > 0:
            first_row = min(first_row, self._first_row)
            first_column = min(first_column, self._first_column)
            end_row = max(end_row, self._first_row + height)
            end_column = max(end_column, self._first_column + width)
        shape = (end_row - first_row, end_column - first_column)
        if shape == (height, width):
            return
        if shape[0] * shape[1] > MAX_CELLS:
            raise MappingError(
                f"a scan at ({pose.x:.3g}, {pose.y:.3g}) m would make the map "
                f"{shape[1]} × {shape[0]} cells; check its pose"
            )
        down, left = self._first_row - first_row, self._first_column - first_column
        for name in ("_hits", "_misses"):
            grown = np.zeros(shape, dtype=COUNT)
            if height > 0:
                grown[down : down + height, left : left + width] = getattr(self, name)
            setattr(self, name, grown)
        self._first_row, self._first_column = first_row, first_column

    def _render(self) -> tuple[OccupancyGrid, int]:
        top, left, bottom, right = content_box(self._hits, self._misses)
        # First rows and columns of the arrays are multiples of a chunk: so are these.
        top, left = top // CHUNK * CHUNK, left // CHUNK * CHUNK
        bottom, right = -(-bottom // CHUNK) * CHUNK, -(-right // CHUNK) * CHUNK
        cells = np.empty((bottom - top, right - left), dtype=np.int8)
        known = render(self._hits, self._misses, top, left, cells, HIT_WEIGHT)
        return OccupancyGrid(
            cells,
            self.resolution,
            (self._first_column + left) * self.resolution,
            (self._first_row + top) * self.resolution,
        ), known


def _noise_terms(lidar: LidarConfig) -> tuple[float, float, float, float]:
    """σ_r of eq. 14 as floor + slope·r + root·√r, and the range up to which returns count."""
    if lidar.noise == "paper":
        root = lidar.sigma_range_m(1.0)
        return 0.0, 0.0, root, min(HIT_RANGE_M, (HIT_SIGMA_M / root) ** 2)
    floor = lidar.sigma_range_m(0.0)
    return floor, lidar.sigma_range_m(1.0) - floor, 0.0, HIT_RANGE_M


def _check(pose: Pose2, scan: LaserScan) -> None:
    if not (math.isfinite(pose.x) and math.isfinite(pose.y) and math.isfinite(pose.theta)):
        raise MappingError(f"a scan at {pose}: the pose is not finite")
    if scan.ranges.ndim != 1 or scan.ranges.shape != scan.angles.shape:
        raise MappingError(
            f"a scan with ranges of shape {scan.ranges.shape} and angles of shape "
            f"{scan.angles.shape}; both must be vectors of one length"
        )
    if not 0.0 < scan.max_range_m < math.inf:
        raise MappingError(f"a scan's maximum range {scan.max_range_m} m is not a distance")
