"""Layouts for everyday use: floors of an office, a corridor ring, a few rooms."""

from collections.abc import Sequence
from itertools import pairwise

from maps.box import Box
from maps.building import Building, BuildingError
from maps.furniture import furnish

BLOCK_ROOMS = 5
"""In the core of a large office so many rooms stand side by side between two corridors."""


def build_office(building: Building) -> None:
    """Rooms on both sides of a corridor ring. What is too deep inside it for one row of halls is
    laid out in blocks of two rows of rooms, with corridors between."""
    config, wall = building.config, building.wall
    depth, about = building.cells_of(config.room_depth_m), building.cells_of(config.room_width_m)
    inside = building.box.grown(-wall)
    around = inside.grown(-depth - wall)
    core = around.grown(-building.cells_of(config.corridor_m) - wall)
    corridors = ring(around, building.cells_of(config.corridor_m))
    # Rooms in the corners must reach along the corridor far enough for a door.
    corner = depth + building.cells_of(config.door_max_m + 0.6)
    rows = [
        Box(x0, y0, x1, y1)
        for y0, y1 in ((inside.y0, inside.y0 + depth), (inside.y1 - depth, inside.y1))
        for x0, x1 in building.split(inside.x0, inside.x1, about, corner)
    ]
    columns = [
        Box(x0, y0, x1, y1)
        for x0, x1 in ((inside.x0, inside.x0 + depth), (inside.x1 - depth, inside.x1))
        for y0, y1 in building.split(around.y0, around.y1, about)
    ]
    halls: list[Box] = []
    if core.height <= 3 * depth:
        halls = [
            Box(x0, core.y0, x1, core.y1) for x0, x1 in building.split(core.x0, core.x1, about)
        ]
    else:
        blocks, streets = _blocks(building, core)
        corridors += streets
        for block in blocks:
            rows += _back_to_back(building, block, about)
    for box in (*corridors, *rows, *columns, *halls):
        building.clear(box)
    open_rooms(building, [*rows, *columns], corridors)
    for hall in halls:
        for corridor in corridors:
            building.join_through_wall(hall, corridor)
    for room in (*rows, *columns, *halls):
        furnish(building, room, config.things_per_room)
    for corridor in corridors:
        furnish(building, corridor, 3, deepest_m=0.35)


def build_loop(building: Building) -> None:
    """A corridor ring and nothing else."""
    width = building.cells_of(building.config.corridor_m)
    inside = building.box.grown(-building.wall)
    building.bury(inside.grown(-width))
    corridors = ring(inside, width)
    for corridor in corridors:
        building.clear(corridor)
    for corridor in corridors:
        furnish(building, corridor, 4, deepest_m=0.5)


def build_rooms(building: Building) -> None:
    """Four rooms that lead into each other."""
    inside, wall = building.box.grown(-building.wall), building.wall
    sway = building.cells_of(0.6)
    x = (inside.x0 + inside.x1 - wall) // 2 + building.between(-sway, sway)
    y = (inside.y0 + inside.y1 - wall) // 2 + building.between(-sway, sway)
    rooms = [
        Box(x0, y0, x1, y1)
        for y0, y1 in ((inside.y0, y), (y + wall, inside.y1))
        for x0, x1 in ((inside.x0, x), (x + wall, inside.x1))
    ]
    for room in rooms:
        building.clear(room)
    for a, b in ((0, 1), (1, 3), (3, 2), (2, 0)):
        building.join_through_wall(rooms[a], rooms[b])
    for room in rooms:
        furnish(building, room, building.config.things_per_room)


def ring(outer: Box, width: int) -> list[Box]:
    """Four corridors that make a ring along the inside of a box: bottom, top, left, right."""
    return [
        Box(outer.x0, outer.y0, outer.x1, outer.y0 + width),
        Box(outer.x0, outer.y1 - width, outer.x1, outer.y1),
        Box(outer.x0, outer.y0, outer.x0 + width, outer.y1),
        Box(outer.x1 - width, outer.y0, outer.x1, outer.y1),
    ]


def open_rooms(building: Building, rooms: Sequence[Box], corridors: Sequence[Box]) -> None:
    """Give each room a door, to the corridor that it has most wall in common with, and some a
    second one, to the room beside."""
    for room in rooms:
        by_wall = sorted(corridors, key=lambda box: -max(_shared(room, box)))
        if not any(building.join_through_wall(room, corridor) for corridor in by_wall):
            raise BuildingError(
                "a room has no wall in common with a corridor: enlarge room_width_m"
            )
    for first, second in pairwise(rooms):
        if building.rng.random() < 0.3:
            building.join_through_wall(first, second)


def _shared(a: Box, b: Box) -> tuple[int, int]:
    """How far two boxes lie side by side along x and along y."""
    shared = a.within(b)
    return shared.width, shared.height


def _blocks(building: Building, core: Box) -> tuple[list[Box], list[Box]]:
    """Blocks of two rows of rooms, and the corridors between them from end to end."""
    config, wall = building.config, building.wall
    depth, about = building.cells_of(config.room_depth_m), building.cells_of(config.room_width_m)
    width = building.cells_of(config.corridor_m)
    gap = width + 2 * wall
    across = building.split(core.x0, core.x1, BLOCK_ROOMS * (about + wall), gap=gap)
    upwards = building.split(core.y0, core.y1, 2 * depth + wall, gap=gap)
    blocks = [Box(x0, y0, x1, y1) for y0, y1 in upwards for x0, x1 in across]
    streets = [
        Box(core.x0 - wall, y1 + wall, core.x1 + wall, y1 + wall + width) for _, y1 in upwards[:-1]
    ]
    streets += [
        Box(x1 + wall, core.y0 - wall, x1 + wall + width, core.y1 + wall) for _, x1 in across[:-1]
    ]
    return blocks, streets


def _back_to_back(building: Building, block: Box, about: int) -> list[Box]:
    """Two rows of rooms."""
    middle = (block.y0 + block.y1 - building.wall) // 2
    return [
        Box(x0, y0, x1, y1)
        for y0, y1 in ((block.y0, middle), (middle + building.wall, block.y1))
        for x0, x1 in building.split(block.x0, block.x1, about)
    ]
