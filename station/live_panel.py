"""One panel of the live picture: what a group of robots knows, over the truth, and the robots."""

import math
from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from maps.grid import OccupancyGrid
from protocol.pose import IDENTITY, FloatArray, Pose2
from station.pictures import (
    FREE_COLOUR,
    INK,
    TRUE_WALL_COLOUR,
    UNKNOWN_COLOUR,
    WALL_COLOUR,
    free_box,
    robot_colour,
    wall_skin,
)

MARGIN_M = 0.4
# cv2 draws lines at fractions of a pixel when coordinates are shifted by so many bits.
SHIFT = 4
FONT = cv2.FONT_HERSHEY_SIMPLEX
HEAD_PX = 36

Image = npt.NDArray[np.uint8]


class Panel:
    """Draws into pictures of one size, in which the whole building has room."""

    def __init__(self, truth: OccupancyGrid, long_side_px: int) -> None:
        left, right, bottom, top = free_box(truth, MARGIN_M)
        self._scale = long_side_px / max(right - left, top - bottom)
        self._left, self._top = left, top
        shape = (round((top - bottom) * self._scale), round((right - left) * self._scale))
        self._walls = np.zeros(shape, dtype=np.uint8)
        self._place(truth, IDENTITY, wall_skin(truth), self._walls)

    def ground(self, maps: Sequence[tuple[OccupancyGrid, Pose2]]) -> Image:
        """Unknown, then what maps know, each at `T_world_map`, with true walls where they know
        none."""
        ground = np.empty((*self._walls.shape, 3), dtype=np.uint8)
        ground[:] = bgr(UNKNOWN_COLOUR)
        free, occupied = np.zeros_like(self._walls), np.zeros_like(self._walls)
        for grid, T_world_map in maps:
            self._place(grid, T_world_map, grid.free, free)
            self._place(grid, T_world_map, grid.occupied, occupied)
        ground[free > 127] = bgr(FREE_COLOUR)
        ground[self._walls > 127] = bgr(TRUE_WALL_COLOUR)
        ground[occupied > 127] = bgr(WALL_COLOUR)
        return ground

    def draw_link(self, picture: Image, ends: FloatArray) -> None:
        """Two robots that can talk (2×2, m)."""
        self._polyline(picture, ends, "#8a93a1", 1)

    def draw_robot(
        self, picture: Image, index: int, name: str, pose: FloatArray, trail: FloatArray
    ) -> None:
        """A robot at its true pose, and the way it came (n×2)."""
        colour = robot_colour(index)
        self._polyline(picture, trail, colour, 2)
        ahead = pose[:2] + 0.35 * np.array([np.cos(pose[2]), np.sin(pose[2])])
        (x, y), nose = self._pixels(np.array([pose[:2], ahead])).tolist()
        radius = round(0.2 * self._scale * (1 << SHIFT))
        cv2.circle(picture, (x, y), radius, bgr(colour), -1, cv2.LINE_AA, SHIFT)
        cv2.line(picture, (x, y), tuple(nose), bgr(INK), 2, cv2.LINE_AA, SHIFT)
        corner = (x // (1 << SHIFT) + 10, y // (1 << SHIFT) - 10)
        cv2.putText(picture, name, corner, FONT, 0.55, (255, 255, 255), 4, cv2.LINE_AA)
        cv2.putText(picture, name, corner, FONT, 0.55, bgr(colour), 2, cv2.LINE_AA)

    def draw_path(self, picture: Image, index: int, path: FloatArray) -> None:
        """Where a robot wants to go (n×2, m)."""
        colour = robot_colour(index)
        self._polyline(picture, path, colour, 1)
        x, y = self._pixels(path[-1:])[0] / (1 << SHIFT)
        cv2.drawMarker(picture, (round(x), round(y)), bgr(colour), cv2.MARKER_TILTED_CROSS, 12, 2)

    def _place(
        self, grid: OccupancyGrid, T_world_map: Pose2, mask: npt.NDArray[np.bool_], canvas: Image
    ) -> None:
        """Paint the cells of a mask onto the canvas, over what is there."""
        size = grid.resolution * self._scale
        c, s = size * math.cos(T_world_map.theta), size * math.sin(T_world_map.theta)
        half = 0.5 * grid.resolution
        corner = np.array([[grid.origin_x + half, grid.origin_y + half]])
        ((x, y),) = self._scaled(T_world_map.apply(corner))
        placed = cv2.warpAffine(
            np.where(mask, np.uint8(255), np.uint8(0)),
            # A pixel's centre, not its corner, is at whole numbers: hence the halves.
            np.array([[c, -s, x - 0.5], [-s, -c, y - 0.5]]),
            (canvas.shape[1], canvas.shape[0]),
            flags=cv2.INTER_NEAREST,
        )
        np.maximum(canvas, placed, out=canvas)

    def _scaled(self, points: FloatArray) -> FloatArray:
        """Points (n×2, m) in pixels (n×2)."""
        return (
            np.stack([points[:, 0] - self._left, self._top - points[:, 1]], axis=-1) * self._scale
        )

    def _pixels(self, points: FloatArray) -> npt.NDArray[np.int32]:
        """Likewise, in the shifted pixels of cv2."""
        return np.round(self._scaled(points) * (1 << SHIFT)).astype(np.int32)

    def _polyline(self, picture: Image, points: FloatArray, colour: str, width: int) -> None:
        pixels = self._pixels(points)
        cv2.polylines(picture, [pixels], False, bgr(colour), width, cv2.LINE_AA, SHIFT)


def with_head(picture: Image, text: str) -> Image:
    """A picture under a line of text."""
    head = np.full((HEAD_PX, picture.shape[1], 3), 255, dtype=np.uint8)
    # The font of cv2 has no letter beyond ASCII.
    plain = text.replace("·", "|").encode("ascii", "replace").decode()
    cv2.putText(head, plain, (12, 24), FONT, 0.55, bgr(INK), 1, cv2.LINE_AA)
    return np.vstack([head, picture])


def bgr(colour: str) -> tuple[int, int, int]:
    """A colour as cv2 has it."""
    return int(colour[5:7], 16), int(colour[3:5], 16), int(colour[1:3], 16)
