"""The occupancy map: counts of hits and misses from keyframes, each of which can be taken out.

Counts are integers, so that taking a keyframe out and putting it back elsewhere leaves no
rounding behind, and the map is the same in whatever order the keyframes came.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from maps.grid import OccupancyGrid
from protocol.config import LidarConfig
from protocol.errors import EarshotError
from protocol.pose import FloatArray, Pose2, wrap_angle
from robot.mapping.kernels import beam_extents, content_box, count_scan, render

Key = tuple[str, int, int]

CHUNK = 64  # cells; the arrays and the published grid are multiples of it
HIT_WEIGHT = 4  # a cell is a wall from one hit in five scans on; 0.2 is the usual threshold
HIT_RANGE_M = 10.0  # farther out a return is less sure than a cell, and its wall is seen again
HIT_SIGMA_M = 0.25
GRAZING_M = 0.5
COUNT = np.uint16  # a keyframe counts a cell once: enough for 65,535 of them at one place
MAX_CELLS = 1 << 27  # half a kilometre square at 5 cm; beyond it a pose is broken
MOVED_M, MOVED_RAD = 0.005, math.radians(0.1)


class MappingError(EarshotError):
    """A keyframe that cannot be mapped; the message says which and why."""


@dataclass(slots=True)
class _Placed:
    """A keyframe as counted: what must be taken out to undo it."""

    pose: Pose2
    ranges: npt.NDArray[np.float32]
    table: int
    max_range_m: float


class OccupancyMap:
    """An occupancy grid that keyframes can be added to, moved in and removed from.

    `lidar` gives the noise of the ranges: free space ends two standard deviations before a
    return, and returns less sure than `HIT_SIGMA_M` show no obstacle.
    """

    def __init__(self, resolution: float = 0.05, lidar: LidarConfig | None = None) -> None:
        if not resolution > 0.0:
            raise MappingError(f"resolution {resolution} m: a cell needs a positive size")
        self.resolution = resolution
        self._noise = _noise_terms(lidar or LidarConfig())
        self._placed: dict[Key, _Placed] = {}
        self._angle_tables: list[FloatArray] = []
        self._first_row = self._first_column = 0
        self._hits = np.zeros((0, 0), dtype=COUNT)
        self._misses = np.zeros((0, 0), dtype=COUNT)
        self._grid: OccupancyGrid | None = None
        self._known_cells = 0

    def __len__(self) -> int:
        return len(self._placed)

    def __contains__(self, key: Key) -> bool:
        return key in self._placed

    def set(
        self,
        key: Key,
        pose: Pose2,
        ranges: FloatArray | npt.NDArray[np.float32],
        angles: FloatArray,
        max_range_m: float,
        exact: bool = False,
    ) -> None:
        """Add the keyframe of that key, or move it to a new pose.

        `ranges`, `angles` (n) as in LaserScan: +inf clears up to `max_range_m`, NaN says nothing.
        A known keyframe keeps its ranges. One that moved by less than 5 mm and 0.1° stays where
        it is unless `exact`. Raises MappingError on arrays of different lengths or a pose that
        is not finite.
        """
        _check_pose(key, pose)
        placed = self._placed.get(key)
        if placed is None:
            placed = self._place(key, pose, ranges, angles, max_range_m)
            self._cover(pose, max_range_m)
            self._placed[key] = placed
        elif _moved(placed.pose, pose, exact):
            self._cover(pose, placed.max_range_m)
            self._count(placed, -1)
            placed.pose = pose
        else:
            return
        self._count(placed, 1)
        self._grid = None

    def remove(self, key: Key) -> None:
        """Take a keyframe out; one that is not in the map is no error."""
        placed = self._placed.pop(key, None)
        if placed is not None:
            self._count(placed, -1)
            self._grid = None

    def grid(self) -> OccupancyGrid:
        """The map, cropped to the chunks that hold anything known: a function of content alone."""
        if self._grid is None:
            self._grid, self._known_cells = self._render()
        return self._grid

    def live(
        self, pose: Pose2, ranges: FloatArray, angles: FloatArray, max_range_m: float
    ) -> OccupancyGrid:
        """The map as it would be with one more scan, for planning; the map itself stays."""
        before = self.grid()
        placed = self._place(("", 0, 0), pose, ranges, angles, max_range_m)
        self._cover(pose, max_range_m)
        self._count(placed, 1)
        overlaid, _ = self._render()
        self._count(placed, -1)
        self._grid = before
        return overlaid

    def known_area(self) -> float:
        """The known area in m²."""
        self.grid()
        return self._known_cells * self.resolution**2

    def _place(
        self,
        key: Key,
        pose: Pose2,
        ranges: FloatArray | npt.NDArray[np.float32],
        angles: FloatArray,
        max_range_m: float,
    ) -> _Placed:
        _check_pose(key, pose)
        if ranges.ndim != 1 or ranges.shape != angles.shape:
            raise MappingError(
                f"keyframe {key}: ranges of shape {ranges.shape} and angles of shape "
                f"{angles.shape}; both must be vectors of one length"
            )
        if not 0.0 < max_range_m < math.inf:
            raise MappingError(f"keyframe {key}: maximum range {max_range_m} m is not a distance")
        return _Placed(pose, np.array(ranges, np.float32), self._table_of(angles), max_range_m)

    def _table_of(self, angles: FloatArray) -> int:
        """Beam angles are stored once for all keyframes that share them."""
        for index, table in enumerate(self._angle_tables):
            if np.array_equal(table, angles):
                return index
        self._angle_tables.append(np.array(angles, dtype=np.float64))
        return len(self._angle_tables) - 1

    def _count(self, placed: _Placed, sign: int) -> None:
        angles = self._angle_tables[placed.table]
        floor, slope, root, hit_range = self._noise
        clear, hit = beam_extents(
            placed.ranges.astype(np.float64), angles, placed.max_range_m, hit_range,
            floor, slope, root, self.resolution, GRAZING_M,
        )  # fmt: skip
        count_scan(
            self._hits, self._misses, self._first_row, self._first_column, self.resolution,
            placed.pose.x, placed.pose.y, placed.pose.theta, clear, hit, angles, sign,
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
                f"a keyframe at ({pose.x:.3g}, {pose.y:.3g}) m would make the map "
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


def _moved(old: Pose2, new: Pose2, exact: bool) -> bool:
    if exact:
        return old != new
    turned = abs(wrap_angle(new.theta - old.theta))
    return old.distance_to(new) >= MOVED_M or turned >= MOVED_RAD


def _check_pose(key: Key, pose: Pose2) -> None:
    if not (math.isfinite(pose.x) and math.isfinite(pose.y) and math.isfinite(pose.theta)):
        raise MappingError(f"keyframe {key}: pose {pose} is not finite")
