"""What can be said about a run at this moment: the numbers behind every live display."""

import math
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from maps.grid import OccupancyGrid
from protocol.messages import GridPatch, MapReply, Report
from protocol.pose import FloatArray, Pose2
from station.live_groups import PairStatus, final_frames, pairs_of
from station.observer import RunOutcome
from world.frames import frame_of
from world.referee import Referee
from world.simulation import Simulation

PACE_WINDOW_S = 5.0
# A report names the tick it was made at; the truth of so many ticks is kept to be held against it.
TRUTH_TICKS = 200
# Exploration slows down towards its end, so the rate of the last part says more than the mean.
RATE_SHARE = 1.0 / 3.0
COMPLETE = 0.995
GONE = "gone: answers no more"


@dataclass(frozen=True, slots=True)
class RobotStatus:
    """One robot now. `error_m` is its position as reported against the truth of the same tick."""

    name: str
    activity: str
    error_m: float | None
    driven_m: float
    entries: int
    loop_closures: int
    hears: tuple[str, ...]
    finished: bool


@dataclass(frozen=True, slots=True)
class Status:
    """The run now. `pace` is simulated per wall second, lately; `coverage` a share, as last seen;
    `expected_end_s` in simulated time, none while nothing can be said."""

    stamp: float
    wall_s: float
    pace: float | None
    coverage: float | None
    expected_end_s: float | None
    robots: tuple[RobotStatus, ...]
    links: int
    pairs: int
    maps: tuple[PairStatus, ...] = ()
    """How the maps of each two robots stand to each other; empty where all know their starts."""


class RunTracker:
    """Follows a run from tick to tick; `status()` is made only when somebody looks."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._began = clock()
        self._pace: deque[tuple[float, float]] = deque()  # wall and simulated time
        self._truth: deque[tuple[int, FloatArray]] = deque(maxlen=TRUTH_TICKS)
        self._driven: FloatArray = np.zeros(0)
        self._maps: dict[str, GridPatch] = {}
        self._referee: Referee | None = None
        self._simulation: Simulation | None = None
        self._frames: dict[str, Pose2] = {}
        self.coverage: list[tuple[float, float]] = []
        """Simulated time (s) and share covered by the union of the robots' own maps."""

    def started(self, simulation: Simulation) -> None:
        self._began = self._clock()
        self._referee, self._simulation = Referee(simulation), simulation
        self._driven = np.zeros(len(simulation.names))
        self._truth.append((0, np.array(simulation.poses)))

    def ticked(self, simulation: Simulation) -> None:
        poses = np.array(simulation.poses)
        self._driven += np.hypot(*(poses - self._truth[-1][1])[:, :2].T)
        self._truth.append((simulation.tick, poses))
        wall = self._clock()
        # A pace over hundreds of points is none the better: ten a second are enough.
        if not self._pace or wall - self._pace[-1][0] >= 0.1:
            self._pace.append((wall, simulation.stamp))
            while len(self._pace) > 2 and wall - self._pace[0][0] > PACE_WINDOW_S:
                self._pace.popleft()

    def mapped(
        self, robot: str, reply: MapReply, stamp: float, T_world_map: Pose2 | None = None
    ) -> None:
        """Score the union of the latest maps; `stamp` is the simulated time now, and the map lies
        where the robot's frame does unless it is said."""
        if self._referee is None or self._simulation is None:
            return
        self._maps[robot] = reply.own
        self._frames[robot] = T_world_map or frame_of(self._simulation, robot)
        if self.coverage and self.coverage[-1][0] == stamp:
            self.coverage.pop()  # robots answer one after the other; the last one completes it
        self.coverage.append((stamp, self._referee.coverage(self._maps, self._frames)))

    def ended(self, outcome: RunOutcome) -> Status:
        """The run at its end, with the robots' last maps."""
        simulation, frames = outcome.simulation, final_frames(outcome)
        for name, robot in sorted(outcome.robots.items()):
            if robot.map is not None:
                self.mapped(name, robot.map, simulation.stamp, frames.get(name))
        latest = {name: log.latest for name, log in outcome.reports.items() if log.latest}
        return self.status(simulation, latest)

    def status(self, simulation: Simulation, reports: Mapping[str, Report]) -> Status:
        robots = tuple(
            self._robot(i, name, reports.get(name), simulation)
            for i, name in enumerate(simulation.names)
        )
        n, ends = len(robots), expected_end(self.coverage)
        return Status(
            stamp=simulation.stamp,
            wall_s=self._clock() - self._began,
            pace=self._recent_pace(),
            coverage=self.coverage[-1][1] if self.coverage else None,
            expected_end_s=None if ends is None else max(ends, simulation.stamp),
            robots=robots,
            links=int(np.count_nonzero(np.triu(simulation.links))),
            pairs=n * (n - 1) // 2,
            maps=pairs_of(simulation, reports),
        )

    def _recent_pace(self) -> float | None:
        if len(self._pace) < 2:
            return None
        (wall_0, stamp_0), (wall_1, stamp_1) = self._pace[0], self._pace[-1]
        return (stamp_1 - stamp_0) / (wall_1 - wall_0)

    def _robot(
        self, index: int, name: str, report: Report | None, simulation: Simulation
    ) -> RobotStatus:
        driven_m = float(self._driven[index])
        finished, alive = name in simulation.finished, name in simulation.alive
        if report is None:
            activity = "not heard of yet" if alive else GONE
            return RobotStatus(name, activity, None, driven_m, 0, 0, (), finished)
        return RobotStatus(
            name=name,
            activity=report.activity if alive else GONE,
            error_m=self._error_m(index, report, frame_of(simulation, name)),
            driven_m=driven_m,
            entries=report.journal_entries,
            loop_closures=report.loop_closures,
            hears=tuple(mate.robot for mate in report.team if mate.in_range and alive),
            finished=finished,
        )

    def _error_m(self, index: int, report: Report, T_world_frame: Pose2) -> float | None:
        """Distance between a reported pose and the truth at the tick it was reported for."""
        for tick, poses in reversed(self._truth):
            if tick == report.tick:
                x, y = poses[index, :2]
                said = T_world_frame @ report.pose.to_pose()
                return math.hypot(said.x - x, said.y - y)
        return None


def grid_of(patch: GridPatch) -> OccupancyGrid:
    """A map as it came over the wire, as a grid."""
    return OccupancyGrid(patch.cells, patch.resolution_m, patch.origin_x_m, patch.origin_y_m)


def expected_end(coverage: Sequence[tuple[float, float]]) -> float | None:
    """When (simulated s) the team will have covered what it can, going on as it did lately.

    A straight line through the last part of `coverage`, pairs of time and share. None before
    there are three points, and where the line does not rise.
    """
    if len(coverage) < 3:
        return None
    now, covered = coverage[-1]
    since = now - RATE_SHARE * (now - coverage[0][0])
    recent = np.array([point for point in coverage if point[0] >= since])
    if len(recent) < 2 or covered >= COMPLETE:
        return now if covered >= COMPLETE else None
    times = recent[:, 0] - recent[:, 0].mean()
    spread = float(times @ times)
    rate = float(times @ (recent[:, 1] - recent[:, 1].mean())) / spread if spread > 0.0 else 0.0
    return now + (COMPLETE - covered) / rate if rate > 1e-6 else None
