"""With nothing left to explore: to where a robot can hear its team again.

What a robot found while it was out of earshot, the others lack. Of two robots the one that is first
by name is looked for where it was when they heard each other last; so both know the place, and
neither drives past the other (`robot.whereabouts`).
"""

import math

from robot.explore.planner import Terrain, TravelField, path_to
from robot.explore.policy import Plan, View


def go_to_meet(view: View, terrain: Terrain, field: TravelField, frontier_m: float) -> Plan | None:
    """The way to the meeting place, if there is one and it can be reached."""
    place = view.meeting_place
    block = terrain.block_at(place.x, place.y) if place else None
    if block is None or not math.isfinite(field.cost[block]):
        return None
    path = path_to(terrain, field, *block)
    return Plan(place, path, "going to meet a teammate", False, frontier_m, explores=False)
