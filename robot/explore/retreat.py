"""Which of two robots that block each other makes room, and where it goes.

Both work it out from what both know (the joint map, where the two are and want to go), so that
they agree without a word: the one whose way to a place beside the other's path is shorter.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from maps.grid import OccupancyGrid
from protocol.config import BodyConfig
from protocol.pose import FloatArray, Pose2
from robot.explore.planner import (
    NO_PATH,
    Terrain,
    disc,
    path_to,
    resample,
    survey,
    travel_field,
)
from robot.explore.planner_kernels import OCCUPIED

# Between the bodies when one drives past the other: roomy, or else what the follower needs.
PASSING_GAPS_M = (0.35, 0.15)
FARTHEST_M = 15.0  # of travel, to a place where the other gets past
SAMPLE_M = 0.2
BEHIND_COS = 0.7


@dataclass(frozen=True, slots=True)
class Retreat:
    """This robot's way (n×2, m) out of a teammate's path, its cost and that of the teammate's way
    out of this robot's path; infinite where there is none."""

    mate: str
    way: FloatArray
    cost: float
    mate_cost: float


def find_retreat(
    grid: OccupancyGrid,
    body: BodyConfig,
    pose: Pose2,
    goal: Pose2 | None,
    mate: str,
    mate_pose: Pose2,
    mate_goal: Pose2 | None,
) -> Retreat:
    """Both robots' ways out of each other's path. Pure: a job.

    A robot without a goal is in nobody's path: there is nothing to make room for, and it is the
    other one that makes room if it can.
    """
    terrain = survey(grid, body)
    cost, way, mate_cost = math.inf, NO_PATH, math.inf
    if mate_goal is not None:
        cost, way = _way_out(terrain, body, pose, mate_pose, mate_goal)
    if goal is not None:
        mate_cost, _ = _way_out(terrain, body, mate_pose, pose, goal)
    return Retreat(mate, way, cost, mate_cost)


def _way_out(
    terrain: Terrain, body: BodyConfig, mover: Pose2, other: Pose2, other_goal: Pose2
) -> tuple[float, FloatArray]:
    """The cheapest way from `mover`, not through `other`, to a place off the other's path."""
    path = _path_of(terrain, other, other_goal)
    for gap in PASSING_GAPS_M:
        cost, way = _way_off(terrain, mover, other, path, 2.0 * body.radius_m + gap)
        if len(way):
            return cost, way
    return math.inf, NO_PATH


def _way_off(
    terrain: Terrain, mover: Pose2, other: Pose2, path: FloatArray, apart: float
) -> tuple[float, FloatArray]:
    """The cheapest way to a place at least `apart` from every point of a path (n×2, m)."""
    blocked = _blocked(terrain, mover, other, apart)
    field = travel_field(blocked, mover)
    if field is None:
        return math.inf, NO_PATH
    rows, columns = np.nonzero((field.cost <= FARTHEST_M) & blocked.open)
    if len(rows) == 0:
        return math.inf, NO_PATH
    places = blocked.points_of(rows, columns)
    gaps = np.hypot(*(places[:, None, :] - path[None, :, :]).transpose(2, 0, 1)).min(axis=1)
    costs = np.where(gaps >= apart, field.cost[rows, columns], np.inf)
    best = int(np.argmin(costs))
    if not math.isfinite(costs[best]):
        return math.inf, NO_PATH
    return float(costs[best]), path_to(blocked, field, int(rows[best]), int(columns[best]))


def _path_of(terrain: Terrain, robot: Pose2, goal: Pose2) -> FloatArray:
    """The path (n×2, m) that a robot is likely to take: only where it stands, if unknown."""
    here = np.array([[robot.x, robot.y]])
    field = travel_field(terrain, robot)
    block = terrain.block_at(goal.x, goal.y)
    if field is None or block is None:
        return here
    return np.concatenate([here, resample(path_to(terrain, field, *block), SAMPLE_M)])


def _blocked(terrain: Terrain, mover: Pose2, other: Pose2, apart: float) -> Terrain:
    """The terrain with a robot standing in it, which `mover` may only leave straight behind it if
    it is nearer already than `apart`."""
    rows, columns = disc(terrain, other, apart)
    away = np.array([mover.x - other.x, mover.y - other.y])
    from_other = terrain.points_of(rows, columns) - [other.x, other.y]
    distance, gaps = np.hypot(*away), np.hypot(*from_other.T)
    behind = (from_other @ away >= BEHIND_COS * gaps * distance) & (
        gaps >= distance - terrain.resolution
    )
    state, clearance = terrain.state.copy(), terrain.clearance.copy()
    clearance[rows, columns] = 0.0
    state[rows[~behind], columns[~behind]] = OCCUPIED
    return replace(terrain, state=state, clearance=clearance)
