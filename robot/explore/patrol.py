"""Exploration without an end: frontiers first, then the known map again and again.

Of the places of the map each robot takes the one that nobody has been to for the longest, less
the time that it takes to get there, and leaves to a teammate what is nearer to it. (Machado et
al., "Multi-agent patrolling: an empirical analysis of alternative architectures", 2002, call that
time idleness.)
"""

import math
from dataclasses import dataclass

import numpy as np

from protocol.pose import FloatArray, Pose2
from robot.explore.footprints import SQUARE_M, square_of
from robot.explore.nearest import nearest_frontier, travel
from robot.explore.patrol_kernels import roomiest
from robot.explore.planner import (
    NO_PATH,
    WANTED_CLEARANCE_M,
    Terrain,
    TravelField,
    is_cut_off,
    path_to,
    survey,
)
from robot.explore.policy import Plan, View

KEEP_GOAL_M = 6.0  # so much nearer another place must be before the robot turns to it
THEIRS_M = 30.0  # what it costs, as a distance, to go where a teammate is nearer or heading


@dataclass(frozen=True, slots=True)
class Place:
    """A roomy spot of a square, near its middle, that the robot can reach: block, point, travel."""

    row: int
    column: int
    x: float
    y: float
    travel_m: float


class Patrol:
    """The nearest frontier while there is one; then the place that was left alone longest."""

    def plan(self, view: View) -> Plan:
        """See `robot.explore.policy.Policy`. Never exhausted."""
        terrain = survey(view.grid, view.body)
        field = travel(view, terrain)
        if field is None:
            return Plan(None, NO_PATH, "waiting for a first map", False, 0.0)
        frontier = nearest_frontier(view, terrain, field)
        if frontier.goal is not None:
            return frontier
        if is_cut_off(terrain, field, view.home):
            field = travel(view, terrain, squeeze=True) or field
        places = _places(terrain, field)
        if not places:
            return Plan(None, NO_PATH, "there is no room to patrol in", False, frontier.frontier_m)
        idle = _idle_m(view, places)
        chosen = places[int(np.argmax(idle - _prices(view, places)))]
        path = path_to(terrain, field, chosen.row, chosen.column)
        before = path[-2] if len(path) > 1 else np.array([view.pose.x, view.pose.y])
        goal = Pose2(chosen.x, chosen.y, math.atan2(chosen.y - before[1], chosen.x - before[0]))
        reason = f"patrolling: a place {chosen.travel_m:.1f} m away"
        return Plan(goal, path, reason, False, frontier.frontier_m, explores=False)


def _places(terrain: Terrain, field: TravelField) -> list[Place]:
    """One place in each square of the plane that the robot can get to, in order of the squares."""
    best = roomiest(
        field.cost, terrain.clearance, terrain.centres, terrain.resolution, terrain.origin_x,
        terrain.origin_y, terrain.needed, WANTED_CLEARANCE_M, SQUARE_M,
    )  # fmt: skip
    rows, columns = np.divmod(best, field.cost.shape[1])
    found = (rows, columns, *terrain.points_of(rows, columns).T, field.cost[rows, columns])
    return [Place(*each) for each in zip(*(values.tolist() for values in found), strict=True)]


def _idle_m(view: View, places: list[Place]) -> FloatArray:
    """How far (n, m) a robot could have driven since somebody was last at each place."""
    last = {square_of(x, y): tick for x, y, tick in view.visits.tolist()}
    ticks = np.array([view.tick - last.get(square_of(p.x, p.y), 0) for p in places])
    return np.asarray(ticks * view.tick_s * view.body.max_speed_mps, dtype=np.float64)


def _prices(view: View, places: list[Place]) -> FloatArray:
    """What it costs (n, m) to go to each place: the way, and to be there beside a teammate."""
    return np.array([place.travel_m + _surcharge(view, place) for place in places])


def _surcharge(view: View, place: Place) -> float:
    ours = math.hypot(view.pose.x - place.x, view.pose.y - place.y)
    price = 0.0
    if view.goal is not None and _is_at(view.goal, place):
        price -= KEEP_GOAL_M
    for mate in view.teammates:
        theirs = math.hypot(mate.pose.x - place.x, mate.pose.y - place.y)
        heading = mate.goal is not None and _is_at(mate.goal, place)
        if heading or (theirs, mate.name) < (ours, view.name):
            price += THEIRS_M
    return price


def _is_at(goal: Pose2, place: Place) -> bool:
    return square_of(goal.x, goal.y) == square_of(place.x, place.y)
