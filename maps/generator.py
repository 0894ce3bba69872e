"""Buildings made by rule: rooms, doors, corridors, furniture.

`python -m maps.generator [FOLDER]` makes the maps that ship.
"""

import sys
from collections.abc import Callable
from pathlib import Path

from maps.building import Building, BuildingConfig, Layout
from maps.grid import OccupancyGrid, write_map
from maps.institute_layout import build_institute
from maps.meeting_layouts import (
    build_apart,
    build_corridor,
    build_rows,
    build_symmetric,
    build_wings,
)
from maps.office_layouts import build_loop, build_office, build_rooms

FOLDER = Path(__file__).resolve().parent

LAYOUTS: dict[Layout, Callable[[Building], None]] = {
    "apart": build_apart,
    "corridor": build_corridor,
    "institute": build_institute,
    "loop": build_loop,
    "office": build_office,
    "rooms": build_rooms,
    "rows": build_rows,
    "symmetric": build_symmetric,
    "wings": build_wings,
}

_WINGS = BuildingConfig(layout="wings", seed=6, width_m=42.0, height_m=20.0)

SHIPPED = {
    "apart": _WINGS.model_copy(update={"layout": "apart"}),
    "corridor": BuildingConfig(
        layout="corridor", seed=4, width_m=44.0, height_m=9.0, corridor_m=1.2, room_depth_m=3.0
    ),
    "institute": BuildingConfig(
        layout="institute",
        seed=5,
        width_m=46.0,
        height_m=27.0,
        tilt_rad=0.06,
        room_width_m=5.0,
        room_depth_m=5.0,
        legs_per_room=4,
    ),
    "loop": BuildingConfig(layout="loop", seed=2, width_m=20.0, height_m=14.0, corridor_m=2.0),
    "office": BuildingConfig(layout="office", seed=1),
    "rooms-small": BuildingConfig(
        layout="rooms", seed=3, width_m=10.0, height_m=8.0, things_per_room=1
    ),
    "rows": BuildingConfig(
        layout="rows", seed=8, width_m=32.0, height_m=10.8, room_width_m=4.4, room_depth_m=4.2
    ),
    "symmetric": BuildingConfig(layout="symmetric", seed=7, width_m=30.0, height_m=10.8),
    "wings": _WINGS,
}


def make_building(config: BuildingConfig) -> OccupancyGrid:
    """The building of a configuration; the same one each time.

    Raises BuildingError when its size leaves no room for its layout.
    """
    building = Building(config)
    LAYOUTS[config.layout](building)
    return building.grid()


def main(folder: Path = FOLDER) -> None:
    """Write the maps that ship."""
    for name, config in SHIPPED.items():
        write_map(make_building(config), folder / f"{name}.yaml")
        sys.stdout.write(f"wrote {folder / name}.yaml\n")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
