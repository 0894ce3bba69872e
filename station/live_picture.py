"""A picture file of the run as it is now, redrawn so that any viewer can keep it open.

Robots whose maps share a frame are drawn together, in one panel; what is not aligned with it stands
in a panel of its own.
"""

import math
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import cv2
import numpy as np

from maps.grid import OccupancyGrid
from maps.pixels import write_whole
from protocol.messages import MapReply, Report
from protocol.pose import FloatArray, Pose2
from station.live_groups import Group, final_frames, final_groups, groups_of, standing_of
from station.live_panel import Image, Panel, with_head
from station.live_status import grid_of
from station.observer import RunOutcome
from station.wording import clock_time, describe
from world.frames import frame_of
from world.simulation import Simulation

REDRAW_S = 1.0
LONG_SIDE_PX = 1200
# More groups than this are named, not drawn.
MAX_PANELS = 6


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
        self._simulation: Simulation | None = None
        self._maps: dict[str, tuple[OccupancyGrid, Pose2]] = {}
        self._panels: dict[int, Panel] = {}
        self._grounds: dict[tuple[int, Group], Image] = {}
        self._trails: list[list[FloatArray]] = []
        self._title = ""

    def started(self, simulation: Simulation) -> None:
        self._simulation = simulation
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
            self._draw(simulation, groups_of(simulation, reports), reports)

    def mapped(self, robot: str, reply: MapReply) -> None:
        if self._simulation is not None:
            self._take(robot, reply, frame_of(self._simulation, robot))

    def ended(self, outcome: RunOutcome) -> None:
        frames = final_frames(outcome)
        for name, robot in outcome.robots.items():
            if robot.map is not None and name in frames:
                self._take(name, robot.map, frames[name])
        latest = {name: log.latest for name, log in outcome.reports.items() if log.latest}
        remark = f"ended: {outcome.exit_reason}"
        self._draw(outcome.simulation, final_groups(outcome), latest, remark)

    def _take(self, robot: str, reply: MapReply, T_world_map: Pose2) -> None:
        self._maps[robot] = (grid_of(reply.joint), T_world_map)
        self._grounds.clear()

    # -- drawing, from the ground up

    def _draw(
        self,
        simulation: Simulation,
        groups: tuple[Group, ...],
        reports: Mapping[str, Report],
        remark: str = "",
    ) -> None:
        shown, left_out = groups[:MAX_PANELS], groups[MAX_PANELS:]
        columns = math.ceil(math.sqrt(len(shown)))
        pictures = [self._draw_group(columns, group, simulation, reports) for group in shown]
        if len(shown) > 1:
            pictures = [
                with_head(picture, standing_of(group, simulation, reports))
                for group, picture in zip(shown, pictures, strict=True)
            ]
        if left_out:
            remark += "   not shown: " + " ".join(name for group in left_out for name in group)
        said = f"{self._title}   simulated {clock_time(simulation.stamp)}   {remark}"
        done, png = cv2.imencode(
            ".png", with_head(_tiled(pictures, columns), said), [cv2.IMWRITE_PNG_COMPRESSION, 1]
        )
        if done:
            write_whole(self.path, png.tobytes())

    def _draw_group(
        self, columns: int, group: Group, simulation: Simulation, reports: Mapping[str, Report]
    ) -> Image:
        """The map that a group shares, its robots, and who can talk to whom in it."""
        if columns not in self._panels:
            self._panels[columns] = Panel(simulation.terrain.grid, LONG_SIDE_PX // columns)
        panel = self._panels[columns]
        if (columns, group) not in self._grounds:
            maps = [self._maps[name] for name in group if name in self._maps]
            self._grounds[columns, group] = panel.ground(maps)
        picture = self._grounds[columns, group].copy()
        members = [simulation.names.index(name) for name in group]
        poses = simulation.poses
        for i, j in np.argwhere(np.triu(simulation.links)):
            if i in members and j in members:
                panel.draw_link(picture, poses[[i, j], :2])
        for index, name in zip(members, group, strict=True):
            trail = np.array([*self._trails[index], poses[index, :2]])
            panel.draw_robot(picture, index, name, poses[index], trail)
            report = reports.get(name)
            # Once a run is over it no longer matters where they wanted to go.
            arrived = simulation.done or (report is not None and report.finished)
            if report is not None and len(report.path) > 1 and not arrived:
                path = frame_of(simulation, name).apply(np.array(report.path))
                panel.draw_path(picture, index, path)
        return picture


def _tiled(pictures: list[Image], columns: int) -> Image:
    """Pictures of one size, row by row; the last row is filled up with white."""
    white = np.full_like(pictures[0], 255)
    filled = pictures + [white] * (-len(pictures) % columns)
    rows = [np.hstack(filled[k : k + columns]) for k in range(0, len(filled), columns)]
    return np.vstack(rows)
