"""Layouts for studying how robots meet: in a corridor, between wings, among look-alikes."""

from maps.box import Box
from maps.building import Building
from maps.furniture import furnish
from maps.office_layouts import open_rooms


def build_corridor(building: Building) -> None:
    """Two halls, joined by one long corridor with a side room here and there."""
    config, wall = building.config, building.wall
    inside = building.box.grown(-wall)
    hall = building.cells_of(config.room_width_m)
    width = building.cells_of(config.corridor_m)
    low = (inside.y0 + inside.y1 - width) // 2
    halls = [
        Box(inside.x0, inside.y0, inside.x0 + hall, inside.y1),
        Box(inside.x1 - hall, inside.y0, inside.x1, inside.y1),
    ]
    corridor = Box(inside.x0 + hall, low, inside.x1 - hall, low + width)
    depth = building.cells_of(min(config.room_depth_m, 0.5 * config.height_m))
    places = building.split(corridor.x0 + wall, corridor.x1 - wall, hall)
    rooms = []
    for number, (x0, x1) in enumerate(places):
        if number % 3 == 1:  # the others are places where nobody can step aside
            below = building.rng.random() < 0.5
            y0 = max(low - wall - depth, inside.y0) if below else low + width + wall
            y1 = low - wall if below else min(low + width + wall + depth, inside.y1)
            rooms.append(Box(x0, y0, x1, y1))
    for box in (*halls, corridor, *rooms):
        building.clear(box)
    for mouth in (corridor.x0, corridor.x1):
        _keep_mouth_free(building, corridor, mouth)
    open_rooms(building, rooms, [corridor])
    for room in (*halls, *rooms):
        furnish(building, room, config.things_per_room)


def build_wings(building: Building) -> None:
    """Two wings, each with rooms on both sides of a corridor, and one passage between them."""
    left, right = _draw_wings(building)
    width = building.cells_of(building.config.corridor_m)
    low = (building.box.height - width) // 2
    building.clear(Box(left.x1, low, right.x0, low + width))


def build_apart(building: Building) -> None:
    """Two wings with no way from one to the other."""
    _draw_wings(building)


def build_symmetric(building: Building) -> None:
    """Uneven rooms on both sides of a corridor, in a building that looks the same turned by 180°:
    no map of it tells its two ends apart."""
    config = building.config
    corridor = _middle_corridor(building)
    about = building.cells_of(config.room_width_m)
    rooms = [
        _below(building, corridor, x0, x1)
        for x0, x1 in building.split(corridor.x0, corridor.x1, about)
    ]
    for box in (corridor, *rooms):
        building.clear(box)
    open_rooms(building, rooms, [corridor])
    for room in rooms:
        furnish(building, room, config.things_per_room)
    half = building.box.height // 2
    lower = Box(0, 0, building.box.width, half)
    building.repeat(lower, Box(0, building.box.height - half, lower.x1, building.box.height), True)


def build_rows(building: Building) -> None:
    """Rows of identical rooms on both sides of a corridor. A hall at one end tells where one is:
    who has not seen it cannot know."""
    config, wall = building.config, building.wall
    inside, corridor = building.box.grown(-wall), _middle_corridor(building)
    width = building.cells_of(config.room_width_m)
    hall = Box(inside.x0, inside.y0, inside.x0 + width, inside.y1)
    first = _below(building, corridor, hall.x1 + wall, hall.x1 + wall + width)
    for box in (corridor, hall, first):
        building.clear(box)
    open_rooms(building, [first], [corridor])
    furnish(building, first, config.things_per_room)
    _keep_mouth_free(building, corridor, hall.x1)
    furnish(building, hall, 2 * config.things_per_room)
    unit = Box(first.x0, inside.y0, first.x1, corridor.y0)
    above = corridor.y1 + unit.height
    for x in range(first.x0, inside.x1 - width + 1, width + wall):
        building.repeat(unit, Box(x, unit.y0, x + width, unit.y1), False)
        building.repeat(unit, Box(x, corridor.y1, x + width, above), True)


def _middle_corridor(building: Building) -> Box:
    """From end to end, as far from the bottom as from the top."""
    inside = building.box.grown(-building.wall)
    half = building.cells_of(building.config.corridor_m) // 2
    middle = building.box.height // 2
    return Box(inside.x0, middle - half, inside.x1, building.box.height - middle + half)


def _keep_mouth_free(building: Building, corridor: Box, x: int) -> None:
    """Nothing may be put where a corridor opens into a hall."""
    reach = building.cells_of(building.config.passage_m)
    building.kept_free[Box(x - reach, corridor.y0, x + reach, corridor.y1).slices] = True


def _below(building: Building, corridor: Box, x0: int, x1: int) -> Box:
    """A room below a corridor."""
    y1 = corridor.y0 - building.wall
    depth = building.cells_of(building.config.room_depth_m)
    return Box(x0, max(building.wall, y1 - depth), x1, y1)


def _draw_wings(building: Building) -> tuple[Box, Box]:
    """Two wings at the ends of the building, and between them in the middle of each a gap in the
    rooms that a passage can lead through; returns their corridors."""
    config, wall = building.config, building.wall
    inside = building.box.grown(-wall)
    depth, width = building.cells_of(config.room_depth_m), building.cells_of(config.corridor_m)
    about = building.cells_of(config.room_width_m)
    low = (building.box.height - width) // 2
    whole = [(inside.y0, inside.y1)]
    halves = [(inside.y0, low - wall), (low + width + wall, inside.y1)]
    corridors = []
    for x in (inside.x0 + depth + wall, inside.x1 - depth - wall - width):
        corridor = Box(x, inside.y0, x + width, inside.y1)
        left, right = corridor.x0 - wall, corridor.x1 + wall
        rooms = [
            Box(x0, y0, x1, y1)
            for x0, x1 in ((left - depth, left), (right, right + depth))
            for span in (whole if x0 == inside.x0 or x1 == inside.x1 else halves)
            for y0, y1 in building.split(*span, about)
        ]
        for box in (corridor, *rooms):
            building.clear(box)
        open_rooms(building, rooms, [corridor])
        for room in rooms:
            furnish(building, room, config.things_per_room)
        corridors.append(corridor)
    return corridors[0], corridors[1]
