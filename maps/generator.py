"""Buildings made by rule: rooms, doors, corridors, furniture.

`python -m maps.generator [FOLDER]` makes the maps that ship.
"""

import sys
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from maps.building import Box, Building, BuildingConfig
from maps.grid import OccupancyGrid, write_map
from maps.library import FOLDER

SHIPPED = {
    "loop": BuildingConfig(layout="loop", seed=2, width_m=20.0, height_m=14.0, corridor_m=2.0),
    "office": BuildingConfig(layout="office", seed=1),
    "rooms-small": BuildingConfig(
        layout="rooms", seed=3, width_m=10.0, height_m=8.0, things_per_room=1
    ),
}


def make_building(config: BuildingConfig) -> OccupancyGrid:
    """The building of a configuration; the same one each time."""
    building = Building(config)
    {"office": _build_office, "loop": _build_loop, "rooms": _build_rooms}[config.layout](building)
    return building.grid()


def _ring(outer: Box, width: int) -> list[Box]:
    """Four corridors that make a ring along the inside of a box: bottom, top, left, right."""
    return [
        Box(outer.x0, outer.y0, outer.x1, outer.y0 + width),
        Box(outer.x0, outer.y1 - width, outer.x1, outer.y1),
        Box(outer.x0, outer.y0, outer.x0 + width, outer.y1),
        Box(outer.x1 - width, outer.y0, outer.x1, outer.y1),
    ]


def _build_office(building: Building) -> None:
    config, wall = building.config, building.wall
    depth, about = building.cells_of(config.room_depth_m), building.cells_of(config.room_width_m)
    inside = building.box.grown(-wall)
    ring = inside.grown(-depth - wall)
    core = ring.grown(-building.cells_of(config.corridor_m) - wall)
    corridors = _ring(ring, building.cells_of(config.corridor_m))
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
        for y0, y1 in building.split(ring.y0, ring.y1, about)
    ]
    halls = [Box(x0, core.y0, x1, core.y1) for x0, x1 in building.split(core.x0, core.x1, about)]
    for box in (*corridors, *rows, *columns, *halls):
        building.clear(box)
    _open_rooms(building, [*rows, *columns], corridors)
    for hall in halls:
        for corridor in corridors:
            _join_through_wall(building, hall, corridor)
    for room in (*rows, *columns, *halls):
        building.furnish(room, config.things_per_room)
    for corridor in corridors:
        building.furnish(corridor, 3, deepest_m=0.35)


def _open_rooms(building: Building, rooms: Sequence[Box], corridors: Sequence[Box]) -> None:
    """Give each room a door, to the corridor that it has most wall in common with."""
    for room in rooms:
        by_wall = sorted(corridors, key=lambda box: -max(_shared(room, box)))
        if not any(_join_through_wall(building, room, corridor) for corridor in by_wall):
            raise ValueError("a room has no wall in common with a corridor: widen room_width_m")
    for first, second in pairwise(rooms):
        if building.rng.random() < 0.3:
            _join_through_wall(building, first, second)


def _shared(a: Box, b: Box) -> tuple[int, int]:
    """How far two boxes lie side by side along x and along y."""
    shared = a.within(b)
    return shared.width, shared.height


def _join_through_wall(building: Building, a: Box, b: Box) -> bool:
    """`join`, if one wall is all that is between the boxes."""
    gap_x = max(a.x0, b.x0) - min(a.x1, b.x1)
    gap_y = max(a.y0, b.y0) - min(a.y1, b.y1)
    return building.wall in (gap_x, gap_y) and building.join(a, b)


def _build_loop(building: Building) -> None:
    width = building.cells_of(building.config.corridor_m)
    inside = building.box.grown(-building.wall)
    building.bury(inside.grown(-width))
    corridors = _ring(inside, width)
    for corridor in corridors:
        building.clear(corridor)
    for corridor in corridors:
        building.furnish(corridor, 4, deepest_m=0.5)


def _build_rooms(building: Building) -> None:
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
        _join_through_wall(building, rooms[a], rooms[b])
    for room in rooms:
        building.furnish(room, building.config.things_per_room)


def main(folder: Path = FOLDER) -> None:
    """Write the maps that ship."""
    for name, config in SHIPPED.items():
        write_map(make_building(config), folder / f"{name}.yaml")
        sys.stdout.write(f"wrote {folder / name}.yaml\n")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
