"""Frontiers: where known free space ends at the unknown, and from where that can be looked at.

Source: Yamauchi, "A frontier-based approach for autonomous exploration", 1997.
"""

import math
from dataclasses import dataclass

import numpy as np

from protocol.pose import FloatArray
from robot.explore.frontier_kernels import components, frontier_mask, viewpoints
from robot.explore.planner import Terrain, TravelField
from robot.explore.planner_kernels import UNKNOWN

VIEW_RADIUS_M = 2.0
REFUSED_RADIUS_M = 0.5
LOOKED_RADIUS_M = 0.3  # keyframes are taken at least this often along a way
MIN_LENGTH_M = 0.4  # a gap that the smallest body fits through


@dataclass(frozen=True, slots=True)
class Frontier:
    """A connected piece of frontier and the viewpoint of it that is cheapest to reach.

    `row`, `column`: the viewpoint's block. `x`, `y`: the middle (m) of the frontier blocks.
    """

    length_m: float
    travel_m: float
    row: int
    column: int
    x: float
    y: float


NOWHERE: FloatArray = np.empty((0, 2))


def find_frontiers(
    terrain: Terrain, field: TravelField, refused: FloatArray, lookouts: FloatArray = NOWHERE
) -> list[Frontier]:
    """All frontiers that can be looked at from where the robot can go, cheapest first.

    Frontier blocks count only if they touch an unknown region that a body could stand in, if no
    goal in `refused` (n×2, m) lies within `REFUSED_RADIUS_M` of their viewpoint, and if the map
    holds no scan from there (`lookouts`, n×2, within `LOOKED_RADIUS_M`): what is unknown in spite
    of that scan, whoever took it, no ray gets to.
    """
    state = terrain.state
    unknown_labels, unknown_sizes = components(state == UNKNOWN, False)
    hiding_blocks = math.ceil(math.pi * (terrain.needed / terrain.resolution) ** 2)
    mask = frontier_mask(state, unknown_labels, unknown_sizes, hiding_blocks)
    views = viewpoints(
        mask, state, field.cost, terrain.clearance, terrain.needed, _offsets(terrain.resolution)
    )
    views[mask & _is_refused(terrain, views, refused)] = -1
    views[_around(terrain, lookouts).ravel()[views] & (views >= 0)] = -1
    labels, sizes = components(views >= 0, True)
    rows, columns = np.nonzero(labels >= 0)
    label, seen_from = labels[rows, columns], views[rows, columns]
    middles = np.stack(
        [
            np.bincount(label, weights, minlength=len(sizes)) / sizes
            for weights in terrain.points_of(rows, columns).T
        ],
        axis=-1,
    )
    costs = field.cost.ravel()[seen_from]
    order = np.lexsort((seen_from, costs, label))
    cheapest = order[np.searchsorted(label[order], np.arange(len(sizes)))]
    found = [
        Frontier(
            float(sizes[piece]) * terrain.resolution,
            float(costs[best]),
            int(seen_from[best]) // state.shape[1],
            int(seen_from[best]) % state.shape[1],
            float(middles[piece, 0]),
            float(middles[piece, 1]),
        )
        for piece, best in enumerate(cheapest)
        if sizes[piece] * terrain.resolution >= MIN_LENGTH_M
    ]
    return sorted(found, key=lambda frontier: (frontier.travel_m, frontier.row, frontier.column))


def _offsets(resolution: float) -> np.ndarray[tuple[int, int], np.dtype[np.int64]]:
    """Blocks (k×2) within the view radius, nearest first."""
    reach = round(VIEW_RADIUS_M / resolution)
    rows, columns = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    squares = (rows**2 + columns**2).ravel()
    order = np.argsort(squares, kind="stable")
    order = order[squares[order] <= reach**2]
    return np.stack([rows.ravel()[order], columns.ravel()[order]], axis=-1).astype(np.int64)


def _around(
    terrain: Terrain, points: FloatArray
) -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
    """Which blocks (h×w) are within `LOOKED_RADIUS_M` of any of the points (n×2, m)."""
    height, width = terrain.state.shape
    reach = round(LOOKED_RADIUS_M / terrain.resolution)
    units = np.floor(terrain.to_units(points)).astype(np.int64)
    units = units[((units >= 0) & (units < (height, width))).all(axis=1)] + reach
    near = np.zeros((height + 2 * reach, width + 2 * reach), dtype=np.bool_)
    for row, column in np.ndindex(2 * reach + 1, 2 * reach + 1):
        if math.hypot(row - reach, column - reach) <= reach:
            near[units[:, 0] + row - reach, units[:, 1] + column - reach] = True
    return near[reach : reach + height, reach : reach + width]


def _is_refused(
    terrain: Terrain, views: np.ndarray[tuple[int, int], np.dtype[np.int64]], refused: FloatArray
) -> np.ndarray[tuple[int, int], np.dtype[np.bool_]]:
    """Which blocks (h×w) have their viewpoint near a refused goal."""
    near = np.zeros(views.shape, dtype=np.bool_)
    rows, columns = np.nonzero(views >= 0)
    if len(rows) and len(refused):
        at = views[rows, columns]
        points = terrain.points_of(at // views.shape[1], at % views.shape[1])
        gaps = np.hypot(*(points[:, None, :] - refused[None, :, :]).transpose(2, 0, 1))
        near[rows, columns] = gaps.min(axis=1) <= REFUSED_RADIUS_M
    return near
