"""The compiled comparison of a robot's map with the truth."""

import math

import numpy as np
import numpy.typing as npt

from protocol.kernel import kernel
from protocol.pose import FloatArray

BoolArray = npt.NDArray[np.bool_]
CellArray = npt.NDArray[np.int8]
IntArray = npt.NDArray[np.int64]


@kernel
def compare(
    points: FloatArray,
    walls: BoolArray,
    T_map_world: FloatArray,
    cells: CellArray,
    origin_x: float,
    origin_y: float,
    resolution: float,
    tolerance: int,
    right: IntArray,
    wrong: IntArray,
) -> None:
    """Add one map's vote on each true cell: centre points[i] (n×2, m, world), a wall or free.

    `right` (n) grows by one where the map has that state within `tolerance` of its own cells
    (a square), `wrong` (n) where it has not but claims to know the cell.
    """
    height, width = cells.shape
    c, s = math.cos(T_map_world[2]), math.sin(T_map_world[2])
    for i in range(points.shape[0]):
        x = T_map_world[0] + c * points[i, 0] - s * points[i, 1]
        y = T_map_world[1] + s * points[i, 0] + c * points[i, 1]
        column = math.floor((x - origin_x) / resolution)
        row = math.floor((y - origin_y) / resolution)
        if (
            column < -tolerance
            or row < -tolerance
            or column >= width + tolerance
            or row >= height + tolerance
        ):
            continue
        found = False
        for r in range(max(row - tolerance, 0), min(row + tolerance + 1, height)):
            for k in range(max(column - tolerance, 0), min(column + tolerance + 1, width)):
                value = cells[r, k]
                if value >= 0 and (value >= 50) == walls[i]:
                    found = True
                    break
            if found:
                break
        if found:
            right[i] += 1
        elif 0 <= row < height and 0 <= column < width and cells[row, column] >= 0:
            wrong[i] += 1
