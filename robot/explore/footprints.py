"""Where the team has been, and when: what a patrol goes by."""

import math

import numpy as np

from protocol.pose import FloatArray, Pose2

SQUARE_M = 3.0


class Footprints:
    """The tick of the latest visit to each square of the plane, as far as this robot knows.

    As many numbers as the map has squares, however long the robots walk.
    """

    def __init__(self) -> None:
        self._visits: dict[tuple[int, int], int] = {}

    def mark(self, tick: int, pose: Pose2) -> None:
        """Someone is at a pose, or found it out of reach: there is nothing to go there for now."""
        self._visits[square_of(pose.x, pose.y)] = tick

    def visits(self) -> FloatArray:
        """Middle of each square (x, y in m) and the tick of its latest visit: n×3."""
        rows = [
            ((column + 0.5) * SQUARE_M, (row + 0.5) * SQUARE_M, tick)
            for (column, row), tick in sorted(self._visits.items())
        ]
        return np.array(rows, dtype=np.float64).reshape(-1, 3)


def square_of(x: float, y: float) -> tuple[int, int]:
    """Column and row of the square that holds a point (m)."""
    return math.floor(x / SQUARE_M), math.floor(y / SQUARE_M)
