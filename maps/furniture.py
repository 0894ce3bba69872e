"""Things in rooms and corridors. They are put in only where they leave a way past them."""

from maps.box import Box
from maps.building import Building
from maps.grid import FREE


def furnish(building: Building, room: Box, count: int, deepest_m: float = 0.8) -> None:
    """Put up to `count` things into a room, along its walls or free in it."""
    placed = 0
    for _ in range(20 * count):
        if placed == count:
            break
        thing = _against_wall(building, room, deepest_m)
        if room.width > 4 * thing.width and room.height > 4 * thing.height:
            thing = thing if building.rng.random() < 0.6 else _free_standing(building, room)
        if _fits(building, room, thing):
            building.fill(thing)
            placed += 1


def put_legs(building: Building, room: Box, count: int) -> None:
    """Put up to `count` tables and chairs into a room, of which a range finder sees the legs."""
    placed = 0
    for _ in range(20 * count):
        if placed == count:
            break
        thing = _on_legs(building, room)
        if _fits(building, room, thing):
            leg = building.cells_of(0.1 if thing.width > building.cells_of(0.5) else 0.05)
            for corner in thing.corners(leg):
                building.fill(corner)
            placed += 1


def _fits(building: Building, room: Box, thing: Box) -> bool:
    """Whether a thing leaves a way past it."""
    passage = building.cells_of(building.config.passage_m)
    way = thing.grown(passage).within(room)
    inside = thing.within(room) == thing and not building.kept_free[thing.slices].any()
    if not inside or (building.cells[way.slices] != FREE).any():
        return False
    # Beside a wall either no gap or one to walk through: narrower ones are traps.
    gaps = (thing.x0 - room.x0, room.x1 - thing.x1, thing.y0 - room.y0, room.y1 - thing.y1)
    return not any(0 < gap < passage for gap in gaps)


def _against_wall(building: Building, room: Box, deepest_m: float) -> Box:
    depth = building.between(building.cells_of(0.25), building.cells_of(deepest_m))
    length = building.between(building.cells_of(0.5), building.cells_of(1.6))
    side = building.between(0, 3)
    if side < 2:
        x = building.between(room.x0, room.x1 - length)
        y = room.y0 if side == 0 else room.y1 - depth
        return Box(x, y, x + length, y + depth)
    y = building.between(room.y0, room.y1 - length)
    x = room.x0 if side == 2 else room.x1 - depth
    return Box(x, y, x + depth, y + length)


def _free_standing(building: Building, room: Box) -> Box:
    """A table, or a pillar."""
    pillar = building.rng.random() < 0.4
    low, high = (0.3, 0.5) if pillar else (0.7, 1.6)
    width = building.between(building.cells_of(low), building.cells_of(high))
    height = width if pillar else building.between(building.cells_of(low), building.cells_of(high))
    return _somewhere(building, room, width, height)


def _on_legs(building: Building, room: Box) -> Box:
    """A chair, or a table that a robot can pass under along its short side."""
    if building.rng.random() < 0.6:
        side = building.cells_of(0.45)
        return _somewhere(building, room, side, side)
    long, short = building.cells_of(1.4), building.cells_of(0.8)
    lengthwise = building.rng.random() < 0.5
    return _somewhere(building, room, *((long, short) if lengthwise else (short, long)))


def _somewhere(building: Building, room: Box, width: int, height: int) -> Box:
    x = building.between(room.x0, room.x1 - width)
    y = building.between(room.y0, room.y1 - height)
    return Box(x, y, x + width, y + height)
