"""A known map: one field of a whole building, in which a robot can be found and followed.

It comes from submaps with their poses (a map that was saved), or from an occupancy grid (a
map_server file). Either way it is like one large finished submap whose anchor is the map's origin.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from maps.grid import BoolArray, OccupancyGrid
from protocol.errors import EarshotError
from protocol.pose import FloatArray, compose
from robot.localisation import kernels
from robot.perception import search_kernels
from robot.perception.field import (
    FREE_RESOLUTION_M,
    RESOLUTION_M,
    SIGMA_M,
    ByteArray,
    CorrelationField,
)
from robot.perception.search import Blocks, Pyramid
from robot.perception.search_kernels import NODES_PER_CELL
from robot.slam.packed_submap import PackedSubmap
from robot.slam.submap import Submap

# Beyond so many standard deviations from a wall's surface a field holds nothing.
RIDGE_SIGMAS = 4.0
# Ground so far from anything that is not free is free for certain: a ridge does not reach there.
CLEAR_M = 0.1
MAX_NODES = 1 << 27  # of a field: 290 m square
LEVELS = 6


class KnownMapError(EarshotError):
    """A map that nothing can be found in; the message says why."""


@dataclass(frozen=True, slots=True)
class KnownMap:
    """`field` of walls and free ground, its `pyramid` to be searched, and which search cells a
    robot may be in (levels×rows×columns, as the pyramid)."""

    field: CorrelationField
    pyramid: Pyramid
    open_cells: ByteArray

    @staticmethod
    def of_field(field: CorrelationField) -> "KnownMap":
        """Raises KnownMapError when it holds no wall or no free ground."""
        if not field.nodes.any() or not field.free.any():
            raise KnownMapError("the map holds no walls, or nothing that is known to be free")
        levels = search_kernels.build_pyramid(Blocks.of(field).maxima, LEVELS)
        shape = levels.shape[1:]
        # A search cell and a coarse one of free ground are as large and begin at one origin.
        free = np.zeros(shape, dtype=np.uint8)
        rows, columns = (min(a, b) for a, b in zip(shape, field.free.shape, strict=True))
        free[:rows, :columns] = field.free[:rows, :columns]
        return KnownMap(
            field, Pyramid(field, levels, field.origin), search_kernels.build_pyramid(free, LEVELS)
        )

    @staticmethod
    def of_submaps(submaps: Sequence[PackedSubmap], anchors: FloatArray) -> "KnownMap":
        """Submaps drawn together where their anchors (`T_map_anchor`, m×3, by index) lie.

        Raises KnownMapError when there are none.
        """
        if not submaps:
            raise KnownMapError("the map holds no submaps")
        corners = np.concatenate([_corners(submap, anchors[submap.index]) for submap in submaps])
        low, high = corners.min(axis=0), corners.max(axis=0)
        field = _empty_field(low - FREE_RESOLUTION_M, high - low + 2.0 * FREE_RESOLUTION_M)
        for submap in submaps:
            part = submap.unpack().field
            kernels.blend(
                field.nodes, field.free, field.origin, RESOLUTION_M, FREE_RESOLUTION_M,
                np.array(anchors[submap.index]), part.nodes, part.free, np.array(part.origin),
            )  # fmt: skip
        return KnownMap.of_field(field)

    @staticmethod
    def of_grid(grid: OccupancyGrid, unknown_is_solid: bool = False) -> "KnownMap":
        """The surfaces between free and occupied cells of a grid, as ridges of a field.

        What is unknown is neither wall nor free; in a simulated world, which treats it so, it can
        be taken as solid. Raises KnownMapError when there is no wall, or the grid is too large.
        """
        height, width = (count * grid.resolution for count in grid.cells.shape)
        # Nodes lie at ¼ and ¾ of a cell of 5 cm, so that surfaces run half-way between two.
        origin = np.array([grid.origin_x, grid.origin_y]) + 0.5 * RESOLUTION_M
        field = _empty_field(origin, np.array([width, height]) - RESOLUTION_M)
        solid = ~grid.free if unknown_is_solid else grid.occupied
        free = _at_nodes(grid, grid.free, field)
        away = _to_surface(free, _at_nodes(grid, solid, field))
        ridge = 255.0 * np.exp(-0.5 * (away / SIGMA_M) ** 2)
        field.nodes[:] = np.where(away <= RIDGE_SIGMAS * SIGMA_M, ridge, 0.0).astype(np.uint8)
        clear = ndimage.distance_transform_edt(free) * RESOLUTION_M >= CLEAR_M
        rows, columns = field.free.shape
        field.free[:] = clear[::NODES_PER_CELL, ::NODES_PER_CELL][:rows, :columns]
        return KnownMap.of_field(field)

    def submap(self) -> Submap:
        """The whole map as one finished submap with the map's origin as its anchor."""
        return Submap(0, self.field, [np.zeros(3)], 0.0, True, self.pyramid)


def _corners(submap: PackedSubmap, anchor: FloatArray) -> FloatArray:
    """The corners (4×2, m) of a submap's field in the map."""
    rows, columns = submap.nodes.shape
    size = RESOLUTION_M * np.array([columns, rows])
    corners = submap.origin + np.array([[0, 0], [1, 0], [0, 1], [1, 1]]) * size
    return compose(np.asarray(anchor), np.column_stack([corners, np.zeros(4)]))[:, :2]


def _empty_field(origin: FloatArray, size_m: FloatArray) -> CorrelationField:
    columns, rows = (math.floor(length / FREE_RESOLUTION_M) + 1 for length in size_m)
    ratio = round(FREE_RESOLUTION_M / RESOLUTION_M)
    if rows * columns * ratio**2 > MAX_NODES:
        raise KnownMapError(f"a map of {size_m[0]:.0f} × {size_m[1]:.0f} m is too large")
    return CorrelationField(
        np.zeros((rows * ratio, columns * ratio), dtype=np.uint8),
        np.zeros((rows, columns), dtype=np.uint8),
        np.array(origin, dtype=np.float64),
    )


def _at_nodes(grid: OccupancyGrid, cells: BoolArray, field: CorrelationField) -> BoolArray:
    """Which nodes of a field lie in cells of a grid that are marked."""
    height, width = field.nodes.shape
    x = field.origin[0] + RESOLUTION_M * np.arange(width) - grid.origin_x
    y = field.origin[1] + RESOLUTION_M * np.arange(height) - grid.origin_y
    columns = np.floor(x / grid.resolution).astype(np.int64)
    rows = np.floor(y / grid.resolution).astype(np.int64)
    inside = (rows < cells.shape[0])[:, None] & (columns < cells.shape[1])[None, :]
    rows, columns = np.minimum(rows, cells.shape[0] - 1), np.minimum(columns, cells.shape[1] - 1)
    found: BoolArray = cells[rows[:, None], columns[None, :]] & inside
    return found


def _to_surface(free: BoolArray, solid: BoolArray) -> FloatArray:
    """Metres from each node to the surface between free and solid ones; far where it is neither."""
    if not free.any() or not solid.any():
        raise KnownMapError("the map holds no walls, or nothing that is known to be free")
    # Two nodes on either side of a surface are one step apart, and half a step from it.
    to_solid = ndimage.distance_transform_edt(~solid) - 0.5
    to_free = ndimage.distance_transform_edt(~free) - 0.5
    away = np.where(free, to_solid, np.where(solid, to_free, np.inf))
    return np.asarray(RESOLUTION_M * away, dtype=np.float64)
