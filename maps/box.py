"""Rectangles of cells."""

from dataclasses import dataclass


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

    def corners(self, size: int) -> tuple["Box", ...]:
        """The squares of `size` in its four corners."""
        return tuple(
            Box(x, y, x + size, y + size)
            for y in (self.y0, self.y1 - size)
            for x in (self.x0, self.x1 - size)
        )

    @property
    def slices(self) -> tuple[slice, slice]:
        return slice(max(self.y0, 0), max(self.y1, 0)), slice(max(self.x0, 0), max(self.x1, 0))
