"""A building while it is drawn: a solid block, out of which rooms and doors are cut."""

import math
from typing import Literal

import numpy as np
from pydantic import Field
from scipy import ndimage

from maps.box import Box
from maps.grid import FREE, OCCUPIED, UNKNOWN, CellArray, OccupancyGrid
from protocol.errors import EarshotError
from protocol.model import Model

Layout = Literal[
    "office", "loop", "rooms", "institute", "corridor", "wings", "apart", "symmetric", "rows"
]


class BuildingConfig(Model):
    """What to build; `maps.generator` says what the layouts are. Everything follows from the
    seed."""

    layout: Layout = "office"
    seed: int = Field(0, ge=0)
    width_m: float = Field(30.5, ge=6.0, le=500.0)
    height_m: float = Field(20.5, ge=6.0, le=500.0)
    resolution_m: float = Field(0.05, ge=0.02, le=0.2)
    wall_m: float = Field(0.15, ge=0.1, le=1.0)
    margin_m: float = Field(0.5, ge=0.0, le=50.0, description="unknown ground around the building")
    tilt_rad: float = Field(
        0.0, ge=-math.pi, le=math.pi, description="of the building against the map's axes"
    )
    corridor_m: float = Field(1.8, ge=1.0, le=10.0)
    room_depth_m: float = Field(4.2, ge=2.0, le=50.0, description="of rooms, from their corridor")
    room_width_m: float = Field(5.8, ge=2.0, le=50.0, description="rooms are about as wide as this")
    door_min_m: float = Field(0.9, ge=0.7, le=5.0)
    door_max_m: float = Field(1.2, ge=0.7, le=5.0)
    passage_m: float = Field(
        0.9, ge=0.6, le=5.0, description="way left free past furniture and at doors"
    )
    things_per_room: int = Field(3, ge=0, le=100)
    legs_per_room: int = Field(0, ge=0, le=100, description="tables and chairs: only legs are seen")


class BuildingError(EarshotError):
    """A configuration whose size leaves no room for its layout."""


class Building:
    """Cells while they are drawn, without the margin. Lengths are in cells."""

    def __init__(self, config: BuildingConfig) -> None:
        self.config = config
        self.rng = np.random.default_rng(config.seed)
        self.box = Box(0, 0, self.cells_of(config.width_m), self.cells_of(config.height_m))
        self.wall = self.cells_of(config.wall_m)
        self.cells = np.full((self.box.height, self.box.width), OCCUPIED, dtype=np.int8)
        self.kept_free = np.zeros(self.cells.shape, dtype=bool)
        """Where nothing may be put: ways through doors."""

    def cells_of(self, metres: float) -> int:
        return round(metres / self.config.resolution_m)

    def grid(self) -> OccupancyGrid:
        """The finished map; its margin is unknown. The building's corner lies at (0, 0), if it is
        not tilted."""
        margin = self.cells_of(self.config.margin_m)
        cells = np.pad(_tilted(self.cells, self.config.tilt_rad), margin, constant_values=UNKNOWN)
        corner = -margin * self.config.resolution_m
        return OccupancyGrid(cells, self.config.resolution_m, corner, corner)

    def clear(self, box: Box) -> None:
        """Cut a room, a corridor or a door out. Raises BuildingError where there is no room."""
        if min(box.width, box.height) < 1 or box.within(self.box) != box:
            config = self.config
            raise BuildingError(
                f"{config.width_m:g} × {config.height_m:g} m are too little for the layout "
                f"{config.layout!r}: enlarge them, or make rooms and corridors smaller"
            )
        self.cells[box.slices] = FREE

    def fill(self, box: Box) -> None:
        """Put something solid."""
        self.cells[box.slices] = OCCUPIED

    def bury(self, box: Box) -> None:
        """What nobody can enter or see: unknown, with a wall around."""
        self.cells[box.grown(-self.wall).slices] = UNKNOWN

    def between(self, low: int, high: int) -> int:
        """A random whole number, both ends included."""
        return int(self.rng.integers(low, max(low, high) + 1))

    def split(
        self, low: int, high: int, about: int, ends: int = 0, gap: int | None = None
    ) -> list[tuple[int, int]]:
        """Cut low … high into pieces about so wide with a gap (a wall) between, at uneven places;
        the first and the last are at least `ends` wide."""
        gap = self.wall if gap is None else gap
        count = max(1, round((high - low + gap) / (about + gap)))
        pitch = (high - low + gap) / count
        sway = int(0.15 * pitch)
        cuts = [round(low + pitch * i) + self.between(-sway, sway) for i in range(1, count)]
        cuts = [min(max(cut, low + ends + gap), high - ends) for cut in cuts]
        firsts = [low, *cuts]
        lasts = [*(cut - gap for cut in cuts), high]
        return list(zip(firsts, lasts, strict=True))

    def join(self, a: Box, b: Box) -> bool:
        """Put a door into the wall that two boxes share; False if they share too little."""
        config = self.config
        door = self.between(self.cells_of(config.door_min_m), self.cells_of(config.door_max_m))
        ledge = self.cells_of(0.2)
        shared = a.within(b)
        if shared.width >= door + 2 * ledge:
            x = self.between(shared.x0 + ledge, shared.x1 - ledge - door)
            opening = Box(x, shared.y1, x + door, shared.y0)
        elif shared.height >= door + 2 * ledge:
            y = self.between(shared.y0 + ledge, shared.y1 - ledge - door)
            opening = Box(shared.x1, y, shared.x0, y + door)
        else:
            return False
        self.clear(opening)
        self.kept_free[opening.grown(self.cells_of(config.passage_m)).slices] = True
        return True

    def join_through_wall(self, a: Box, b: Box) -> bool:
        """`join`, if one wall is all that is between the boxes."""
        gap_x = max(a.x0, b.x0) - min(a.x1, b.x1)
        gap_y = max(a.y0, b.y0) - min(a.y1, b.y1)
        return self.wall in (gap_x, gap_y) and self.join(a, b)

    def repeat(self, box: Box, at: Box, turned: bool) -> None:
        """Draw once more what is in a box, into one of the same size, as it is or turned by
        180°."""
        drawn = self.cells[box.slices].copy()
        self.cells[at.slices] = drawn[::-1, ::-1] if turned else drawn


def _tilted(cells: CellArray, tilt: float) -> CellArray:
    """Cells turned counter-clockwise, on unknown ground large enough for all of them."""
    if tilt == 0.0:
        return cells
    cos, sin = math.cos(tilt), math.sin(tilt)
    height, width = cells.shape
    sides = abs(cos) * height + abs(sin) * width, abs(cos) * width + abs(sin) * height
    shape = tuple(math.ceil(side - 1e-9) for side in sides)
    back = np.array([[cos, -sin], [sin, cos]])  # (row, column) in the result to those in `cells`
    middle = 0.5 * (np.array(cells.shape) - 1.0)
    offset = middle - back @ (0.5 * (np.array(shape) - 1.0))
    turned: CellArray = ndimage.affine_transform(
        cells, back, offset, output_shape=shape, order=0, mode="grid-constant", cval=UNKNOWN
    )
    return turned
