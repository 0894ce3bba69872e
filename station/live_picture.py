"""A picture file of the run as it is now, redrawn so that any viewer can keep it open."""

import time
from collections.abc import Callable, Mapping
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from maps.grid import OccupancyGrid
from maps.pixels import write_whole
from protocol.messages import MapReply, Report
from protocol.pose import FloatArray
from station.live_status import grid_of
from station.observer import RunOutcome
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
from station.wording import clock_time, describe
from world.simulation import Simulation

REDRAW_S = 1.0
LONG_SIDE_PX = 1200
HEAD_PX = 36
MARGIN_M = 0.4
# cv2 draws lines at fractions of a pixel when coordinates are shifted by so many bits.
SHIFT = 4
FONT = cv2.FONT_HERSHEY_SIMPLEX

Image = npt.NDArray[np.uint8]


class LivePicture:
    """Draws truth, the team's maps, ways, goals and links into a PNG about once a second."""

    def __init__(
        self,
        path: Path,
        clock: Callable[[], float] = time.monotonic,
        every_s: float = REDRAW_S,
    ) -> None:
        self.path = path
        self._clock = clock
        self._every_s = every_s
        self._drawn_at = -every_s
        self._maps: dict[str, OccupancyGrid] = {}
        self._walls: Image | None = None
        self._ground: Image | None = None
        self._trails: list[list[FloatArray]] = []
        self._left = self._top = self._scale = 0.0
        self._title = ""

    def started(self, simulation: Simulation) -> None:
        truth = simulation.terrain.grid
        left, right, bottom, top = free_box(truth, MARGIN_M)
        self._scale = LONG_SIDE_PX / max(right - left, top - bottom)
        self._left, self._top = left, top
        shape = (round((top - bottom) * self._scale), round((right - left) * self._scale))
        self._walls = np.zeros(shape, dtype=np.uint8)
        self._place(truth, np.where(wall_skin(truth), np.uint8(255), np.uint8(0)), self._walls)
        self._trails = [[] for _ in simulation.names]
        self._title = describe(simulation.scenario)

    def ticked(self, simulation: Simulation, reports: Mapping[str, Report]) -> None:
        for trail, pose in zip(self._trails, simulation.poses, strict=True):
            # A tenth of a metre is three pixels: a nearer point would not be seen.
            if not trail or np.abs(trail[-1] - pose[:2]).max() > 0.1:
                trail.append(np.array(pose[:2]))
        now = self._clock()
        if now - self._drawn_at >= self._every_s:
            self._drawn_at = now
            self._draw(simulation, reports)

    def mapped(self, robot: str, reply: MapReply) -> None:
        self._maps[robot] = grid_of(reply.joint)
        self._ground = None

    def ended(self, outcome: RunOutcome) -> None:
        for name, robot in outcome.robots.items():
            if robot.map is not None:
                self.mapped(name, robot.map)
        # Where they wanted to go no longer matters.
        self._draw(outcome.simulation, {}, f"ended: {outcome.exit_reason}")

    # -- drawing, from the ground up

    def _draw(
        self, simulation: Simulation, reports: Mapping[str, Report], remark: str = ""
    ) -> None:
        if self._ground is None:
            self._ground = self._draw_ground()
        picture = self._ground.copy()
        self._draw_links(picture, simulation)
        for index, name in enumerate(simulation.names):
            self._draw_robot(picture, index, simulation.poses[index], reports.get(name), name)
        said = f"{self._title}   simulated {clock_time(simulation.stamp)}   {remark}"
        # The font of cv2 has no letter beyond ASCII.
        said = said.replace("·", "|").encode("ascii", "replace").decode()
        head = np.full((HEAD_PX, picture.shape[1], 3), 255, dtype=np.uint8)
        cv2.putText(head, said, (12, 24), FONT, 0.55, _bgr(INK), 1, cv2.LINE_AA)
        done, png = cv2.imencode(
            ".png", np.vstack([head, picture]), [cv2.IMWRITE_PNG_COMPRESSION, 1]
        )
        if done:
            write_whole(self.path, png.tobytes())

    def _draw_ground(self) -> Image:
        """Unknown, then what the team's maps know, with true walls where they know none."""
        assert self._walls is not None
        ground = np.empty((*self._walls.shape, 3), dtype=np.uint8)
        ground[:] = _bgr(UNKNOWN_COLOUR)
        free, occupied = np.zeros_like(self._walls), np.zeros_like(self._walls)
        for name in sorted(self._maps):
            grid = self._maps[name]
            self._place(grid, np.where(grid.free, np.uint8(255), np.uint8(0)), free)
            self._place(grid, np.where(grid.occupied, np.uint8(255), np.uint8(0)), occupied)
        ground[free > 127] = _bgr(FREE_COLOUR)
        ground[self._walls > 127] = _bgr(TRUE_WALL_COLOUR)
        ground[occupied > 127] = _bgr(WALL_COLOUR)
        return ground

    def _place(self, grid: OccupancyGrid, mask: Image, canvas: Image) -> None:
        """Paint the cells of a mask onto the canvas, over what is there."""
        size = grid.resolution * self._scale
        # A pixel's centre, not its corner, is at whole numbers: hence the halves.
        x = (grid.origin_x - self._left) * self._scale + 0.5 * size - 0.5
        y = (self._top - grid.origin_y) * self._scale - 0.5 * size - 0.5
        placed = cv2.warpAffine(
            mask,
            np.array([[size, 0.0, x], [0.0, -size, y]]),
            (canvas.shape[1], canvas.shape[0]),
            flags=cv2.INTER_NEAREST,
        )
        np.maximum(canvas, placed, out=canvas)

    def _draw_links(self, picture: Image, simulation: Simulation) -> None:
        pixels = self._pixels(simulation.poses[:, :2])
        for i, j in np.argwhere(np.triu(simulation.links)):
            _polyline(picture, pixels[[i, j]], "#8a93a1", 1)

    def _draw_robot(
        self, picture: Image, index: int, pose: FloatArray, report: Report | None, name: str
    ) -> None:
        colour = robot_colour(index)
        trail = np.array([*self._trails[index], pose[:2]])
        _polyline(picture, self._pixels(trail), colour, 2)
        if report is not None and len(report.path) > 1 and not report.finished:
            path = self._pixels(report.path)
            _polyline(picture, path, colour, 1)
            x, y = path[-1] / (1 << SHIFT)
            cv2.drawMarker(
                picture, (round(x), round(y)), _bgr(colour), cv2.MARKER_TILTED_CROSS, 12, 2
            )
        ahead = pose[:2] + 0.35 * np.array([np.cos(pose[2]), np.sin(pose[2])])
        (x, y), (nose_x, nose_y) = self._pixels(np.array([pose[:2], ahead]))
        radius = round(0.2 * self._scale * (1 << SHIFT))
        cv2.circle(picture, (int(x), int(y)), radius, _bgr(colour), -1, cv2.LINE_AA, SHIFT)
        cv2.line(
            picture,
            (int(x), int(y)),
            (int(nose_x), int(nose_y)),
            _bgr(INK),
            2,
            cv2.LINE_AA,
            SHIFT,
        )
        corner = (int(x) // (1 << SHIFT) + 10, int(y) // (1 << SHIFT) - 10)
        cv2.putText(picture, name, corner, FONT, 0.55, (255, 255, 255), 4, cv2.LINE_AA)
        cv2.putText(picture, name, corner, FONT, 0.55, _bgr(colour), 2, cv2.LINE_AA)

    def _pixels(self, points: FloatArray) -> npt.NDArray[np.int32]:
        """Points (n×2, m) in the shifted pixels of cv2 (n×2)."""
        scaled = np.stack([points[:, 0] - self._left, self._top - points[:, 1]], axis=-1)
        return np.round(scaled * self._scale * (1 << SHIFT)).astype(np.int32)


def _polyline(picture: Image, pixels: npt.NDArray[np.int32], colour: str, width: int) -> None:
    cv2.polylines(picture, [pixels], False, _bgr(colour), width, cv2.LINE_AA, SHIFT)


def _bgr(colour: str) -> tuple[int, int, int]:
    return int(colour[5:7], 16), int(colour[3:5], 16), int(colour[1:3], 16)
