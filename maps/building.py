"""A building while it is drawn: a solid block, out of which rooms and doors are cut.

Things are put in only where they leave a way of `passage_m` past them. Everything follows from
the seed.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from maps.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from protocol.model import Model


class BuildingConfig(Model):
    """What to build. `office`: rooms on both sides of a corridor ring; `loop`: the ring alone;
    `rooms`: four rooms that lead into each other."""

    layout: Literal["office", "loop", "rooms"] = "office"
    seed: int = Field(0, ge=0)
    width_m: float = Field(30.5, ge=6.0, le=500.0)
    height_m: float = Field(20.5, ge=6.0, le=500.0)
    resolution_m: float = Field(0.05, ge=0.02, le=0.2)
    wall_m: float = Field(0.15, ge=0.1, le=1.0)
    margin_m: float = Field(0.5, ge=0.0, description="unknown ground around the building")
    corridor_m: float = Field(1.8, ge=1.0)
    room_depth_m: float = Field(4.2, ge=2.0, description="of the rooms along the outer walls")
    room_width_m: float = Field(5.8, ge=2.0, description="rooms are about as wide as this")
    door_min_m: float = Field(0.9, ge=0.7)
    door_max_m: float = Field(1.2, ge=0.7)
    passage_m: float = Field(0.9, ge=0.6, description="way left free past furniture and at doors")
    things_per_room: int = Field(3, ge=0)


@dataclass(frozen=True, slots=True)
class Box:
    """A rectangle of cells: columns x0 … x1 − 1, rows y0 … y1 − 1."""

    x0: int
    y0: int
    x1: int
    y1: int

    @property
    def width(self) -> int:
        return self.x1 - self.x0

    @property
    def height(self) -> int:
        return self.y1 - self.y0

    def grown(self, by: int) -> "Box":
        return Box(self.x0 - by, self.y0 - by, self.x1 + by, self.y1 + by)

    def within(self, other: "Box") -> "Box":
        """The part that lies in another box; may be empty."""
        return Box(
            max(self.x0, other.x0),
            max(self.y0, other.y0),
            min(self.x1, other.x1),
            min(self.y1, other.y1),
        )

    @property
    def slices(self) -> tuple[slice, slice]:
        return slice(max(self.y0, 0), max(self.y1, 0)), slice(max(self.x0, 0), max(self.x1, 0))


class Building:
    """Cells while they are drawn, without the margin. Lengths are in cells."""

    def __init__(self, config: BuildingConfig) -> None:
        self.config = config
        self.rng = np.random.default_rng(config.seed)
        self.box = Box(0, 0, self.cells_of(config.width_m), self.cells_of(config.height_m))
        self.wall = self.cells_of(config.wall_m)
        self._cells = np.full((self.box.height, self.box.width), OCCUPIED, dtype=np.int8)
        # Where nothing may be put: ways through doors.
        self._kept_free = np.zeros(self._cells.shape, dtype=bool)

    def cells_of(self, metres: float) -> int:
        return round(metres / self.config.resolution_m)

    def grid(self) -> OccupancyGrid:
        """The finished map; its margin is unknown, the building's corner lies at (0, 0)."""
        margin = self.cells_of(self.config.margin_m)
        cells = np.pad(self._cells, margin, constant_values=UNKNOWN)
        corner = -margin * self.config.resolution_m
        return OccupancyGrid(cells, self.config.resolution_m, corner, corner)

    def clear(self, box: Box) -> None:
        """Cut a room or corridor out."""
        self._cells[box.slices] = FREE

    def bury(self, box: Box) -> None:
        """What nobody can enter or see: unknown, with a wall around."""
        self._cells[box.grown(-self.wall).slices] = UNKNOWN

    def between(self, low: int, high: int) -> int:
        """A random whole number, both ends included."""
        return int(self.rng.integers(low, max(low, high) + 1))

    def split(self, low: int, high: int, about: int, ends: int = 0) -> list[tuple[int, int]]:
        """Cut low … high into pieces about so wide with walls between, at uneven places; the
        first and the last are at least `ends` wide."""
        count = max(1, round((high - low + self.wall) / (about + self.wall)))
        pitch = (high - low + self.wall) / count
        sway = int(0.15 * pitch)
        cuts = [round(low + pitch * i) + self.between(-sway, sway) for i in range(1, count)]
        cuts = [min(max(cut, low + ends + self.wall), high - ends) for cut in cuts]
        firsts = [low, *cuts]
        lasts = [*(cut - self.wall for cut in cuts), high]
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
        self._kept_free[opening.grown(self.cells_of(config.passage_m)).slices] = True
        return True

    def furnish(self, room: Box, count: int, deepest_m: float = 0.8) -> None:
        """Put up to `count` things into a room, along its walls or free in it."""
        placed = 0
        for _ in range(20 * count):
            if placed == count:
                break
            thing = self._against_wall(room, deepest_m)
            if room.width > 4 * thing.width and room.height > 4 * thing.height:
                thing = thing if self.rng.random() < 0.6 else self._free_standing(room)
            placed += self._put(room, thing)

    def _put(self, room: Box, thing: Box) -> bool:
        """Put a thing where it leaves a way past it, and report whether it did."""
        way = thing.grown(self.cells_of(self.config.passage_m)).within(room)
        fits = thing.within(room) == thing and not self._kept_free[thing.slices].any()
        if not fits or (self._cells[way.slices] != FREE).any():
            return False
        # Beside a wall either no gap or one to walk through: narrower ones are traps.
        gaps = np.array(
            [thing.x0 - room.x0, room.x1 - thing.x1, thing.y0 - room.y0, room.y1 - thing.y1]
        )
        if ((gaps > 0) & (gaps < self.cells_of(self.config.passage_m))).any():
            return False
        self._cells[thing.slices] = OCCUPIED
        return True

    def _against_wall(self, room: Box, deepest_m: float) -> Box:
        depth = self.between(self.cells_of(0.25), self.cells_of(deepest_m))
        length = self.between(self.cells_of(0.5), self.cells_of(1.6))
        side = self.between(0, 3)
        if side < 2:
            x = self.between(room.x0, room.x1 - length)
            y = room.y0 if side == 0 else room.y1 - depth
            return Box(x, y, x + length, y + depth)
        y = self.between(room.y0, room.y1 - length)
        x = room.x0 if side == 2 else room.x1 - depth
        return Box(x, y, x + depth, y + length)

    def _free_standing(self, room: Box) -> Box:
        """A table, or a pillar."""
        pillar = self.rng.random() < 0.4
        low, high = (0.3, 0.5) if pillar else (0.7, 1.6)
        width = self.between(self.cells_of(low), self.cells_of(high))
        height = width if pillar else self.between(self.cells_of(low), self.cells_of(high))
        x = self.between(room.x0, room.x1 - width)
        y = self.between(room.y0, room.y1 - height)
        return Box(x, y, x + width, y + height)
