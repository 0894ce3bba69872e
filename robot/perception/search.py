"""Exhaustive search for the pose of a scan (or of a whole submap's points) on a field.

Branch and bound over (x, y, θ) finds the best pose in a window on a 10 cm grid for certain, and
the best one elsewhere in the window, which says how ambiguous the place is.
"""

import math
from dataclasses import dataclass

import numpy as np

from protocol.pose import FloatArray, Pose2, wrap_angle
from robot.perception import search_kernels
from robot.perception.field import RESOLUTION_M, SIGMA_M, ByteArray, CorrelationField
from robot.perception.returns import Returns
from robot.perception.search_kernels import NODES_PER_CELL

SEARCH_RESOLUTION_M = NODES_PER_CELL * RESOLUTION_M
MAX_LEVELS = 6
MAX_NODES = 60_000
# Peaks nearer than this to the best one are the best one.
SAME_PEAK_M = 0.5
SAME_PEAK_RAD = math.radians(15.0)
MIN_ANGLE_STEP_RAD = math.radians(0.5)
MAX_ANGLE_STEP_RAD = math.radians(3.0)


@dataclass(frozen=True, slots=True)
class Window:
    """Where to search: ± metres in x and y and ± radians round a pose."""

    centre: Pose2
    half_m: float
    half_rad: float


@dataclass(frozen=True, slots=True)
class Peak:
    """The best pose in a window, and how it compares with the best one elsewhere in it.

    `score` and `runner_up` are as in Match, but on the coarser grid; a runner-up of less than the
    share that was asked for, and any at all after `MAX_NODES`, is an upper bound.
    """

    pose: Pose2
    score: float
    runner_up: float


@dataclass(frozen=True, slots=True)
class Blocks:
    """A field, and its maxima over the cells of a search (10 cm), the first of them at `origin`."""

    field: CorrelationField
    maxima: ByteArray
    origin: FloatArray

    @staticmethod
    def of(field: CorrelationField) -> "Blocks":
        """Of a whole field."""
        nodes = field.nodes
        rows, columns = (-(-extent // NODES_PER_CELL) for extent in nodes.shape)
        maxima = search_kernels.block_maxima(nodes, 0, 0, rows, columns)
        return Blocks(field, maxima, field.origin)

    @staticmethod
    def under(field: CorrelationField, points: FloatArray, window: "Window") -> "Blocks":
        """Of the part in which points (n×2, robot's frame) can lie in a window."""
        centre = window.centre
        row, column, rows, columns = search_kernels.cells_under(
            points,
            centre.x,
            centre.y,
            centre.theta,
            window.half_m,
            window.half_rad,
            field.origin,
            RESOLUTION_M,
            *field.nodes.shape,
        )
        maxima = search_kernels.block_maxima(
            field.nodes, row * NODES_PER_CELL, column * NODES_PER_CELL, rows, columns
        )
        first = np.array([column, row]) * SEARCH_RESOLUTION_M
        return Blocks(field, maxima, field.origin + first)


@dataclass(frozen=True, slots=True)
class Pyramid:
    """Maxima over larger and larger blocks of cells, to be searched as often as wanted."""

    field: CorrelationField
    levels: ByteArray
    origin: FloatArray

    @staticmethod
    def of(blocks: Blocks, half_m: float) -> "Pyramid":
        """As many levels as a window of ± `half_m` makes use of."""
        levels = search_kernels.build_pyramid(blocks.maxima, _levels(half_m))
        return Pyramid(blocks.field, levels, blocks.origin)

    def is_enough(self, half_m: float) -> bool:
        """Whether a window of ± `half_m` makes use of no more levels than there are."""
        return _levels(half_m) <= len(self.levels)

    def up_to(self, half_m: float) -> "Pyramid":
        """The same as it would have been made for a smaller window."""
        return Pyramid(self.field, self.levels[: _levels(half_m)], self.origin)


def _levels(half_m: float) -> int:
    cells = max(2.0 * half_m / SEARCH_RESOLUTION_M, 2.0)
    return min(MAX_LEVELS, max(2, math.ceil(math.log2(cells))))


def search(
    pyramid: Pyramid,
    returns: Returns,
    window: Window,
    floor: float,
    share: float = 0.0,
    known: Pose2 | None = None,
) -> Peak | None:
    """The best pose (`T_field_base`) in a window; None when none reaches the score `floor`, or when
    it is the one `known` already.

    All returns count alike: thin them before (`Returns.thinned`), to a hundred or so. A runner-up
    is looked for down to a `share` of the best, most of the work where that is low.
    """
    if len(returns) == 0:
        return None
    points = returns.points
    sigma2 = returns.values[:, 5] ** 2
    expected = float((SIGMA_M / np.sqrt(SIGMA_M**2 + 2.0 * sigma2)).sum())
    full = 255.0 * expected
    angles = rotations(points, window)
    cells = search_kernels.rotated_cells(
        np.ascontiguousarray(points),
        angles,
        window.centre.x,
        window.centre.y,
        pyramid.origin,
        RESOLUTION_M,
    )
    half = max(1, math.ceil(window.half_m / SEARCH_RESOLUTION_M))
    step = float(angles[1] - angles[0]) if len(angles) > 1 else 1.0
    best, second, _ = search_kernels.branch_and_bound(
        pyramid.levels,
        cells,
        np.arange(float(len(angles))),
        half,
        half,
        round(SAME_PEAK_M / SEARCH_RESOLUTION_M),
        max(1, round(SAME_PEAK_RAD / step)),
        int(floor * full),
        share,
        MAX_NODES,
    )
    total, angle, row, column = best
    if angle < 0:
        return None
    coarse = np.array(
        [
            window.centre.x + column * SEARCH_RESOLUTION_M,
            window.centre.y + row * SEARCH_RESOLUTION_M,
            angles[angle],
        ]
    )
    pose = _within_cell(pyramid.field, points, coarse, step)
    if known is not None and _is_same(pose, known, step):
        return None
    return Peak(pose, total / full, max(floor, second[0] / full))


def _is_same(found: Pose2, known: Pose2, step_rad: float) -> bool:
    """Whether what was found on a grid is a pose that a climb led to: a step of the grid apart."""
    turned = abs(wrap_angle(found.theta - known.theta))
    return found.distance_to(known) <= 1.5 * RESOLUTION_M and turned <= 0.5 * step_rad


def _within_cell(
    field: CorrelationField, points: FloatArray, coarse: FloatArray, step_rad: float
) -> Pose2:
    """The best pose between the nodes of the cell that a search ended in."""
    pose = coarse.copy()
    search_kernels.best_nearby(
        field.nodes,
        field.origin,
        RESOLUTION_M,
        np.ascontiguousarray(points),
        coarse,
        NODES_PER_CELL // 2 * RESOLUTION_M,
        NODES_PER_CELL // 2,
        0.5 * step_rad,
        pose,
    )
    return Pose2(pose[0], pose[1], wrap_angle(pose[2]))


def rotations(points: FloatArray, window: Window) -> FloatArray:
    """Rotations at which the far points move by one cell from one to the next."""
    far = np.sort(np.hypot(points[:, 0], points[:, 1]))
    reach = float(np.interp(0.9 * (len(far) - 1), np.arange(len(far)), far))
    step = SEARCH_RESOLUTION_M / max(reach, SEARCH_RESOLUTION_M)
    step = min(max(step, MIN_ANGLE_STEP_RAD), MAX_ANGLE_STEP_RAD)
    count = max(1, math.ceil(window.half_rad / step))
    return np.asarray(window.centre.theta + step * np.arange(-count, count + 1), dtype=np.float64)
