"""What a map of the building ought to hold, and how much of it a map does.

The *target* of coverage is every cell that a robot's disc can touch on its way from the starts,
and the wall cells that border those (8-neighbourhood): whoever drove there has seen them. The
*walls* are the solid cells that border free ground which is seen from there: the swept area and
what lies within one robot diameter of it without a wall between. Precision asks of what maps call
occupied whether there is any wall: a cell that is occupied in the truth, or unknown and bordering
free ground (robots meet it as solid).

A cell is right in a map that has its state within one cell, of the coarser of the two grids. It
is known correctly in several maps together if at least one has it right, and no more of them have
it wrong: a map that is shifted or whose walls are too thick costs, whoever else is right.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from maps.grid import BoolArray
from protocol.messages import GridPatch
from protocol.pose import FloatArray, Pose2
from world import referee_kernels
from world.terrain import Terrain

NEIGHBOURS = np.ones((3, 3), dtype=bool)


@dataclass(frozen=True, slots=True)
class Cells:
    """True cells to look for: centres (n×2, m, world) and which of them are walls (n)."""

    points: FloatArray
    walls: BoolArray

    @staticmethod
    def of(terrain: Terrain, chosen: BoolArray) -> "Cells":
        rows, columns = np.nonzero(chosen)
        return Cells(terrain.grid.to_points(rows, columns), ~terrain.grid.free[rows, columns])


class MapTruth:
    """The truth about the part of a building that robots can get to."""

    def __init__(self, terrain: Terrain, starts: FloatArray, radius_m: float) -> None:
        self._cell = terrain.cell
        self._terrain = terrain
        free = terrain.grid.free
        reach = terrain.reachable(radius_m, starts)
        # Rounding must not decide whether a cell at exactly one radius belongs to the disc.
        away = ndimage.distance_transform_edt(~reach) * terrain.cell
        swept = reach if not reach.any() else (away <= radius_m + 1e-9) & free
        steps = max(1, math.ceil(2.0 * radius_m / terrain.cell))
        seen = ndimage.binary_dilation(swept, NEIGHBOURS, iterations=steps, mask=free)
        self.target = Cells.of(terrain, swept | (~free & _touching(swept)))
        self.walls = Cells.of(terrain, ~free & _touching(seen))
        # A wall is what the map calls occupied, and the unknown ground that stops a beam.
        self._solid_truth = terrain.grid.occupied | (~free & _touching(free))

    @property
    def target_m2(self) -> float:
        """The area of the target."""
        return len(self.target.points) * self._cell**2

    def known(self, cells: Cells, maps: Iterable[tuple[GridPatch, Pose2]]) -> float:
        """The share of true cells that maps, each with its `T_world_map`, know correctly."""
        if len(cells.points) == 0:
            return 0.0
        right = np.zeros(len(cells.points), dtype=np.int64)
        wrong = np.zeros(len(cells.points), dtype=np.int64)
        for patch, T_world_map in maps:
            referee_kernels.compare(
                cells.points,
                cells.walls,
                T_world_map.inverse().to_array(),
                np.array(patch.cells, dtype=np.int8, order="C"),
                patch.origin_x_m,
                patch.origin_y_m,
                patch.resolution_m,
                _tolerance(self._cell, patch.resolution_m),
                right,
                wrong,
            )
        return float(np.mean((right > 0) & (right >= wrong)))

    def precision(self, maps: Sequence[tuple[GridPatch, Pose2]]) -> float:
        """The share of occupied cells, of the union of maps, within one cell of a true wall."""
        found: list[FloatArray] = []
        finest = min((patch.resolution_m for patch, _ in maps), default=self._cell)
        coarsest = max((patch.resolution_m for patch, _ in maps), default=self._cell)
        for patch, T_world_map in maps:
            rows, columns = np.nonzero(np.asarray(patch.cells) >= 50)
            points = np.stack([columns + 0.5, rows + 0.5], axis=-1) * patch.resolution_m
            points += np.array([patch.origin_x_m, patch.origin_y_m])
            found.append(T_world_map.apply(points))
        points = np.concatenate([*found, np.zeros((0, 2))])
        # One vote for each place, however many maps have it.
        _, first = np.unique(np.floor(points / finest).astype(np.int64), axis=0, return_index=True)
        points = points[first]
        if len(points) == 0:
            return 0.0
        steps = _tolerance(coarsest, self._cell)
        near = ndimage.binary_dilation(
            np.pad(self._solid_truth, steps), NEIGHBOURS, iterations=steps
        )
        rows, columns = self._terrain.grid.to_cells(points)
        rows, columns = rows + steps, columns + steps
        inside = (rows >= 0) & (rows < near.shape[0]) & (columns >= 0) & (columns < near.shape[1])
        hits = np.zeros(len(points), dtype=bool)
        hits[inside] = near[rows[inside], columns[inside]]
        return float(np.mean(hits))


def _touching(cells: BoolArray) -> BoolArray:
    """Cells that are, or have among their eight neighbours, one of these."""
    found: npt.NDArray[np.bool_] = ndimage.binary_dilation(cells, NEIGHBOURS)
    return found


def _tolerance(other: float, own: float) -> int:
    """One cell of the coarser grid, in cells of one's own."""
    return max(1, round(other / own))
