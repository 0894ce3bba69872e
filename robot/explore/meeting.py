"""With nothing left to explore: to where the team can hear each other again.

What a robot found while it was out of earshot, the others lack. Of two robots the one that is first
by name is looked for where it was when they heard each other last; so both know the place, and
neither drives past the other.
"""

import math

from protocol.pose import Pose2
from robot.explore.footprints import square_of
from robot.explore.planner import Terrain, TravelField, path_to
from robot.explore.policy import Plan, View

# Where one of the team was within this time nobody is to be met by going there again: the one who
# is waited for there may come, and the next one's place has its turn.
WAIT_S = 60.0


def go_to_meet(view: View, terrain: Terrain, field: TravelField, frontier_m: float) -> Plan | None:
    """The way to the first meeting place that can be reached and where nobody was lately."""
    last = {square_of(x, y): tick for x, y, tick in view.visits.tolist()}
    for x, y in view.meeting_places.tolist():
        if (view.tick - last.get(square_of(x, y), -math.inf)) * view.tick_s < WAIT_S:
            continue
        block = terrain.block_at(x, y)
        if block is None or not math.isfinite(field.cost[block]):
            continue
        path = path_to(terrain, field, *block)
        return Plan(
            Pose2(x, y, view.pose.theta),
            path,
            "going to meet a teammate",
            False,
            frontier_m,
            explores=False,
        )
    return None
