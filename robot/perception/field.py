"""Correlation field: how likely a surface is at each place, as far as some scans have seen."""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from protocol.pose import FloatArray, Pose2
from robot.perception import drawing_kernels, field_kernels
from robot.perception.returns import Returns

ByteArray = npt.NDArray[np.uint8]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

# Between nodes the field is straight: with nodes 5 cm apart matches are drawn to them, which bends
# a map by a milliradian per metre driven.
RESOLUTION_M = 0.025
SIGMA_M = 0.03
FREE_RESOLUTION_M = 0.1
# A ray is free up to this distance before its return, where the ridge of the wall begins.
FREE_MARGIN_M = 0.15
# From this share of what the field is expected to be there, a return is on a wall.
HIT_LEVEL = 0.15
# Rays that end nearer than this behind a wall touch it rather than cross it.
CROSSING_MARGIN_M = 0.3
# First and last row, first and last column of what is used: everything, or nothing yet.
ALL = np.array([0, 1 << 40, 0, 1 << 40])
NONE = np.array([1 << 40, -1, 1 << 40, -1])


@dataclass(frozen=True, slots=True)
class Overlay:
    """How a scan lies on a field, by what the matcher does not look at.

    `overlap` is the share of returns that lie where the field knows the place, `hits` the share of
    those on its walls, `crossing` the share of rays through its walls.
    """

    overlap: float
    hits: float
    crossing: float

    @staticmethod
    def of(sums: FloatArray, weight: float) -> "Overlay":
        """From what `CorrelationField.compare` says, added up over scans of that weight."""
        compared, hits, traced, crossing = (float(value) for value in sums)
        return Overlay(
            overlap=compared / weight if weight > 0.0 else 0.0,
            hits=hits / compared if compared > 0.0 else 0.0,
            crossing=crossing / traced if traced > 0.0 else 1.0,
        )


@dataclass(slots=True)
class CorrelationField:
    """A grid of nodes at `origin + (column, row) * RESOLUTION_M`: 0 nothing … 255 surface.

    `free` is a coarser grid with the same origin, 1 where rays passed. Nothing is known outside of
    `used_nodes` and `used_free` (first and last row, first and last column, all if not told).
    """

    nodes: ByteArray
    free: ByteArray
    origin: FloatArray
    used_nodes: IntArray = dataclasses.field(default_factory=ALL.copy)
    used_free: IntArray = dataclasses.field(default_factory=ALL.copy)

    @staticmethod
    def around(half_extent_m: float) -> "CorrelationField":
        """An empty field that reaches `half_extent_m` to all sides of its frame's origin."""
        half = math.ceil(half_extent_m / FREE_RESOLUTION_M)
        ratio = round(FREE_RESOLUTION_M / RESOLUTION_M)
        return CorrelationField(
            np.zeros((2 * half * ratio + 1,) * 2, dtype=np.uint8),
            np.zeros((2 * half + 1,) * 2, dtype=np.uint8),
            np.full(2, -half * FREE_RESOLUTION_M),
            NONE.copy(),
            NONE.copy(),
        )

    def draw(self, pose: Pose2, returns: Returns) -> None:
        """Add what a scan at `pose` (`T_field_base`) saw."""
        at = pose.to_array()
        count = len(returns)
        drawing_kernels.draw_returns(
            self.nodes,
            self.used_nodes,
            self.origin,
            RESOLUTION_M,
            at,
            returns.values,
            returns.links,
            count,
            SIGMA_M,
        )
        drawing_kernels.mark_free(
            self.free,
            self.used_free,
            self.origin,
            FREE_RESOLUTION_M,
            at,
            returns.values,
            count,
            FREE_MARGIN_M,
            1e3,
        )

    def overlay(self, pose: Pose2, returns: Returns, rays: bool = True) -> Overlay:
        """How a scan at `pose` (`T_field_base`) lies on what this field knows.

        Without `rays` none is traced, which takes most of the time; `crossing` is then 1.
        """
        weight = float(returns.values[:, 4].sum())
        return Overlay.of(self.compare(pose, returns, rays), weight)

    def compare(self, pose: Pose2, returns: Returns, rays: bool = True) -> FloatArray:
        """The sums (4,) an overlay is made of, which add up over scans: weight of the returns where
        the field knows the place, of those on its walls; rays traced, rays through its walls."""
        return np.array(
            field_kernels.overlay(
                self.nodes,
                self.origin,
                RESOLUTION_M,
                self.free,
                FREE_RESOLUTION_M,
                pose.to_array(),
                returns.values,
                len(returns),
                SIGMA_M,
                HIT_LEVEL,
                CROSSING_MARGIN_M if rays else math.inf,
            )
        )

    def on_walls(self, points: FloatArray) -> int:
        """How many of n×2 points (m, field frame) lie on walls."""
        return int(self.is_wall(points).sum())

    def passed(self, points: FloatArray) -> BoolArray:
        """Which of n×2 points (m, field frame) rays went through."""
        return _at(self.free, points, self.origin, FREE_RESOLUTION_M) > 0

    def is_wall(self, points: FloatArray) -> BoolArray:
        """Which of n×2 points (m, field frame) lie on walls."""
        return _at(self.nodes, points, self.origin, RESOLUTION_M) >= HIT_LEVEL * 255.0

    def is_wall_near(self, points: FloatArray, reach_m: float) -> BoolArray:
        """Which of n×2 points (m, field frame) have a wall in the square that reaches so far to all
        sides; steps across it are as wide as walls are drawn."""
        sides = np.linspace(-reach_m, reach_m, 1 + 2 * math.ceil(reach_m / (2.0 * SIGMA_M)))
        near = np.zeros(len(points), dtype=bool)
        for x in sides:
            for y in sides:
                near |= self.is_wall(points + np.array([x, y]))
        return near

    def hits(self, points: FloatArray) -> float:
        """The share on walls of n×2 points (m, field frame) that lie where this field knows the
        place; 0 where none does."""
        walls = self.is_wall(points)
        return float(walls.sum() / max(1, (walls | self.passed(points)).sum()))

    def cropped(self) -> "CorrelationField":
        """The same field without the empty margin, in arrays of its own."""
        nodes, free, origin = self._used()
        return CorrelationField(nodes.copy(), free.copy(), origin)

    def clear(self) -> None:
        """Make it empty again, which takes less time than a new one of its size."""
        nodes, free, _ = self._used()
        nodes[:], free[:] = 0, 0
        self.used_nodes, self.used_free = NONE.copy(), NONE.copy()

    def _used(self) -> tuple[ByteArray, ByteArray, FloatArray]:
        """Nodes, free ground and origin without the empty margin but for one cell, as views."""
        ratio = round(FREE_RESOLUTION_M / RESOLUTION_M)
        drawn, passed = (self.used_nodes // ratio).tolist(), self.used_free.tolist()
        row0, column0 = (max(0, min(drawn[i], passed[i]) - 1) for i in (0, 2))
        row1, column1 = (max(drawn[i], passed[i]) + 2 for i in (1, 3))
        if row1 <= row0:
            return self.nodes[:3, :3], self.free[:2, :2], self.origin
        return (
            self.nodes[row0 * ratio : row1 * ratio, column0 * ratio : column1 * ratio],
            self.free[row0:row1, column0:column1],
            self.origin + np.array([column0, row0]) * FREE_RESOLUTION_M,
        )


def _at(grid: ByteArray, points: FloatArray, origin: FloatArray, resolution: float) -> ByteArray:
    """The values (n) of a grid at n×2 points, 0 beyond it."""
    cells = np.floor((points - origin) / resolution + 0.5).astype(np.int64)
    inside = (cells >= 0).all(axis=1) & (cells < grid.shape[::-1]).all(axis=1)
    values = np.zeros(len(points), dtype=np.uint8)
    columns, rows = cells[inside].T
    values[inside] = grid[rows, columns]
    return values
