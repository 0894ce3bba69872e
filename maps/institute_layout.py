"""A floor as real buildings have it: long corridors, uneven rooms, niches, clutter, shut doors."""

from itertools import pairwise

from maps.box import Box
from maps.building import Building
from maps.furniture import furnish, put_legs
from maps.office_layouts import open_rooms

SHUT = 0.12
"""The share of rooms that are not there for a robot: shut, or a shaft or a stairwell."""


def build_institute(building: Building) -> None:
    """Long corridors side by side with uneven rooms along both, joined at their ends."""
    config = building.config
    corridors = _corridors(building)
    rooms = [
        room
        for low, corridor, high in _strips(building, corridors)
        for room in (
            *_row(building, corridor, low, below=True),
            *_row(building, corridor, high, below=False),
        )
    ]
    if len(corridors) > 1:
        corridors += _crossings(building, corridors)
    for box in (*rooms, *corridors):
        building.clear(box)
    open_rooms(building, rooms, corridors)
    for room in rooms:
        _put_pillars(building, room)
        furnish(building, room, config.things_per_room)
        put_legs(building, room, config.legs_per_room)
    for corridor in corridors:
        furnish(building, corridor, max(corridor.width, corridor.height) // 100, deepest_m=0.3)


def _crossing_width(building: Building) -> int:
    return building.cells_of(building.config.corridor_m)


def _corridors(building: Building) -> list[Box]:
    """Corridors from end to end, as many as the height has room for."""
    config, inside = building.config, building.box.grown(-building.wall)
    width, depth = building.cells_of(config.corridor_m), building.cells_of(config.room_depth_m)
    strip = width + 2 * (depth + building.wall)
    strips = building.split(inside.y0, inside.y1, strip)
    sway = int(0.1 * depth)
    corridors = []
    for y0, y1 in strips:
        low = (y0 + y1 - width) // 2 + building.between(-sway, sway)
        corridors.append(Box(inside.x0, low, inside.x1, low + width))
    return corridors


def _strips(building: Building, corridors: list[Box]) -> list[tuple[int, Box, int]]:
    """Each corridor with the rows up to which its rooms may reach."""
    inside, wall = building.box.grown(-building.wall), building.wall
    borders = [(a.y1 + b.y0) // 2 for a, b in pairwise(corridors)]
    lows = [inside.y0, *borders]
    highs = [*(border - wall for border in borders), inside.y1]
    return list(zip(lows, corridors, highs, strict=True))


def _row(building: Building, corridor: Box, limit: int, below: bool) -> list[Box]:
    """The rooms on one side of a corridor: of uneven width and depth, some shut."""
    config, wall = building.config, building.wall
    ends = wall + _crossing_width(building)
    shortest = building.cells_of(2.0)
    rooms = []
    for x0, x1 in building.split(
        corridor.x0 + ends, corridor.x1 - ends, building.cells_of(config.room_width_m)
    ):
        # Some rooms are small offices, two of which fit where one large room would.
        halved = building.rng.random() < 0.3 and x1 - x0 > 2 * shortest + wall
        middle = (x0 + x1 - wall) // 2
        for left, right in ((x0, middle), (middle + wall, x1)) if halved else ((x0, x1),):
            if building.rng.random() < SHUT:
                continue
            full = (corridor.y0 - wall - limit) if below else (limit - corridor.y1 - wall)
            depth = building.between(max(shortest, int(0.65 * full)), full)
            if below:
                rooms.append(Box(left, corridor.y0 - wall - depth, right, corridor.y0 - wall))
            else:
                rooms.append(Box(left, corridor.y1 + wall, right, corridor.y1 + wall + depth))
    return rooms


def _crossings(building: Building, corridors: list[Box]) -> list[Box]:
    """What joins the corridors at either end."""
    width, first, last = _crossing_width(building), corridors[0], corridors[-1]
    return [Box(x, first.y0, x + width, last.y1) for x in (first.x0, first.x1 - width)]


def _put_pillars(building: Building, room: Box) -> None:
    """What stands out of the walls in corners: pipes, pillars, cupboards up to the ceiling."""
    for corner in room.corners(building.between(building.cells_of(0.2), building.cells_of(0.5))):
        if building.rng.random() < 0.35 and not building.kept_free[corner.slices].any():
            building.fill(corner)
