"""The ground truth that does not move: what is solid, what a ray meets, where a disc can go."""

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from maps.grid import BoolArray, OccupancyGrid
from protocol.pose import FloatArray
from world import disc_kernels, ray_kernels


class Terrain:
    """A map as robots meet it: occupied and unknown cells are solid, and so is all outside.

    Inside, cells are padded by a rim of one solid cell and lengths are in cells, as `ray_kernels`
    has them.
    """

    def __init__(self, grid: OccupancyGrid) -> None:
        self.grid = grid
        self.cell = grid.resolution
        self.solid: BoolArray = np.pad(~grid.free, 1, constant_values=True)
        sides = ray_kernels.free_squares(self.solid)
        self.squares: npt.NDArray[np.uint8] = ray_kernels.tiled(sides)
        self.clearance: npt.NDArray[np.uint8] = sides.min(axis=0)
        # World coordinates of the corner of the padded grid.
        self.corner = np.array([grid.origin_x - grid.resolution, grid.origin_y - grid.resolution])

    def to_cells(self, poses: FloatArray) -> FloatArray:
        """Poses or points (n×k, metres first) with x and y in cells of the padded grid."""
        scaled = np.array(poses, dtype=np.float64)
        scaled[..., :2] = (scaled[..., :2] - self.corner) / self.cell
        return scaled

    def to_metres(self, poses: FloatArray) -> FloatArray:
        """The inverse of `to_cells`."""
        scaled = np.array(poses, dtype=np.float64)
        scaled[..., :2] = scaled[..., :2] * self.cell + self.corner
        return scaled

    def cast(self, x: float, y: float, angles: FloatArray, max_range_m: float) -> FloatArray:
        """Ranges (n, m) from (x, y) at `angles` (n) to the first solid cell, +inf beyond
        `max_range_m`; 0 from within a solid cell."""
        ranges = np.zeros(len(angles))
        start = self.to_cells(np.array([x, y]))
        if self._inside(start):
            directions = np.array(angles, dtype=np.float64)
            limit = max_range_m / self.cell
            ray_kernels.cast_rays(self.squares, start[0], start[1], directions, limit, ranges)
        return ranges * self.cell

    def disc_overlaps(self, x: float, y: float, radius_m: float) -> bool:
        """Whether a disc reaches into a solid cell."""
        start = self.to_cells(np.array([x, y]))
        if not self._inside(start):
            return True
        return bool(
            disc_kernels.disc_overlaps(self.solid, start[0], start[1], radius_m / self.cell)
        )

    def room_for(self, radius_m: float) -> BoolArray:
        """At which cell centres (as `grid.cells`) a disc of this radius can stand."""
        fits: BoolArray = disc_kernels.room_for_disc(self.solid, radius_m / self.cell)
        return fits[1:-1, 1:-1]

    def reachable(self, radius_m: float, starts: FloatArray) -> BoolArray:
        """Which cell centres a disc can move to from any of `starts` (n×2 or n×3, m)."""
        # Between two centres that share a side a disc that fits at both fits all the way: what is
        # nearest to it there is a cell border that was as near to one of them.
        labels, _ = ndimage.label(self.room_for(radius_m))
        rows, columns = self.grid.to_cells(np.asarray(starts, dtype=np.float64))
        found: set[int] = set()
        for row, column in zip(rows.tolist(), columns.tolist(), strict=True):
            # A start off the centre may stand where the centre of its own cell is too near.
            around = labels[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
            found.update(around[around > 0].tolist())
        return np.isin(labels, sorted(found))

    def _inside(self, point: FloatArray) -> bool:
        height, width = self.solid.shape
        return bool(0.0 <= point[0] < width and 0.0 <= point[1] < height)
