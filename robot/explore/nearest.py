"""The nearest frontier by travel, left to a teammate that is on its way there and nearer."""

import math

from protocol.pose import Pose2
from robot.explore.frontier import Frontier, find_frontiers
from robot.explore.meeting import go_to_meet
from robot.explore.planner import (
    NO_PATH,
    Terrain,
    TravelField,
    is_cut_off,
    path_to,
    survey,
    travel_field,
)
from robot.explore.policy import Plan, Teammate, View

CLAIM_RADIUS_M = 2.0
KEEP_GOAL_M = 1.0  # another frontier must be this much nearer before the robot turns round
BEHIND_M = 0.5  # what turning round costs, as a distance
LOOKING_M = 0.6
WORTH_FOLLOWING_M = 2.5
FRESH_TICKS = 50


class NearestFrontier:
    """Yamauchi's exploration with the simplest coordination that keeps robots apart."""

    def plan(self, view: View) -> Plan:
        """See `robot.explore.policy.Policy`."""
        terrain = survey(view.grid, view.body)
        field = travel(view, terrain)
        if field is None:
            return Plan(None, NO_PATH, "waiting for a first map", False, 0.0)
        plan = nearest_frontier(view, terrain, field)
        if plan.exhausted:
            return go_to_meet(view, terrain, field, plan.frontier_m) or plan
        return plan


def travel(view: View, terrain: Terrain, squeeze: bool = False) -> TravelField | None:
    """Travel from the robot's pose, rather round teammates; None if that is off the map."""
    near = tuple(mate.pose for mate in view.teammates if mate.age_ticks <= FRESH_TICKS)
    return travel_field(terrain, view.pose, near, squeeze=squeeze, blocked=view.blocked)


def nearest_frontier(view: View, terrain: Terrain, field: TravelField) -> Plan:
    """The plan of `NearestFrontier`, for a terrain and travel from the robot's pose over it."""
    found = find_frontiers(terrain, field, view.refused, view.lookouts)
    if not found and is_cut_off(terrain, field, view.home):
        field = travel(view, terrain, squeeze=True) or field
        found = find_frontiers(terrain, field, view.refused, view.lookouts)
    frontiers = [f for f in found if not _looks_at(view.teammates, terrain, f)]
    left = sum(frontier.length_m for frontier in frontiers)
    if not frontiers:
        # A teammate at work will say what it sees; one without a goal has said it.
        waiting = bool(found) and any(mate.goal is not None for mate in view.teammates)
        reason = "a teammate looks at what is left" if waiting else "nothing reachable is left"
        return Plan(None, NO_PATH, reason, not waiting, left)
    claimed = [
        any(_claims(mate, frontier, view) for mate in view.teammates) for frontier in frontiers
    ]
    if all(claimed) and left < WORTH_FOLLOWING_M:
        return Plan(None, NO_PATH, "a teammate is on its way to what is left", False, left)
    # Where much is left, going along beats standing about: the way may fork ahead.
    free = [f for f, taken in zip(frontiers, claimed, strict=True) if not taken] or frontiers
    chosen = min(free, key=lambda frontier: _price(frontier, terrain, view))
    path = path_to(terrain, field, chosen.row, chosen.column)
    goal = _goal(terrain, chosen)
    reason = f"nearest frontier {chosen.travel_m:.1f} m away"
    if chosen is not frontiers[0] and claimed[0]:
        reason += ", a nearer one is a teammate's"
    return Plan(goal, path, reason, False, left)


def _price(frontier: Frontier, terrain: Terrain, view: View) -> float:
    """Travel, less for the frontier the robot is heading for, more for one behind it."""
    goal = _goal(terrain, frontier)
    price = frontier.travel_m
    if view.goal is not None and goal.distance_to(view.goal) <= CLAIM_RADIUS_M:
        price -= KEEP_GOAL_M
    bearing = math.atan2(goal.y - view.pose.y, goal.x - view.pose.x) - view.pose.theta
    return price + BEHIND_M * 0.5 * (1.0 - math.cos(bearing))


def _claims(mate: Teammate, frontier: Frontier, view: View) -> bool:
    """Whether a teammate in range is heading for a frontier and is nearer to it.

    Ties go to the smaller name, so that of two robots exactly one leaves it.
    """
    if not mate.in_range or mate.goal is None:
        return False
    if math.hypot(mate.goal.x - frontier.x, mate.goal.y - frontier.y) > CLAIM_RADIUS_M:
        return False
    theirs = math.hypot(mate.pose.x - frontier.x, mate.pose.y - frontier.y)
    ours = math.hypot(view.pose.x - frontier.x, view.pose.y - frontier.y)
    return (theirs, mate.name) < (ours, view.name)


def _looks_at(teammates: tuple[Teammate, ...], terrain: Terrain, frontier: Frontier) -> bool:
    """Whether a teammate stands where the frontier can be seen from."""
    goal = _goal(terrain, frontier)
    return any(
        mate.age_ticks <= FRESH_TICKS and mate.pose.distance_to(goal) <= LOOKING_M
        for mate in teammates
    )


def _goal(terrain: Terrain, frontier: Frontier) -> Pose2:
    """The viewpoint, turned towards the middle of the frontier."""
    x, y = terrain.point_of(frontier.row, frontier.column)
    return Pose2(x, y, math.atan2(frontier.y - y, frontier.x - x))
