"""A team in closed loop with perfect poses: exploration alone, without SLAM and radio."""

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
import pytest

from maps.grid import OccupancyGrid
from protocol.config import LidarConfig, PoseModel
from protocol.messages import Action, Sense
from protocol.pose import FloatArray, Pose2
from protocol.state import adopt_state, dump_state
from robot.explore.explorer import Decision, Explorer
from robot.explore.policy import Teammate
from robot.jobs import Jobs
from robot.mapping.occupancy import OccupancyMap
from robot.perception.odometry import WheelOdometry
from robot.perception.scan import LaserScan, beam_angles, perceive
from world.scenario import RobotSpec, Scenario
from world.simulation import Simulation

EARSHOT_M = 10.0


@dataclass
class Walk:
    """What came of a run: true poses (T×n×3), commands (T×n×2), activities by robot."""

    simulation: Simulation
    grid: OccupancyGrid
    poses: FloatArray
    commands: FloatArray
    activities: dict[str, list[str]] = field(default_factory=dict)

    @property
    def ended_by_itself(self) -> bool:
        return self.simulation.exit_reason == "all robots finished"

    @property
    def collisions(self) -> int:
        return sum(self.simulation.collisions.values())

    def known_share(self, margin: int = 3) -> float:
        """Share of the free cells, some cells away from walls, that the map calls free."""
        truth = self.simulation.terrain.grid
        rows, columns = np.nonzero(self.simulation.terrain.room_for(margin * truth.resolution))
        rows, columns = self.grid.to_cells(truth.to_points(rows, columns))
        inside = self.grid.inside(rows, columns)
        cells = self.grid.cells[rows[inside], columns[inside]]
        return float(((cells >= 0) & (cells < 50)).sum() / len(rows))


class _Shared:
    """The one map of the team, as a grid provider for one robot."""

    def __init__(self, shared: OccupancyMap) -> None:
        self.shared, self.pose = shared, Pose2(0.0, 0.0, 0.0)
        self.scan: LaserScan | None = None

    def snapshot(self) -> OccupancyGrid:
        if self.scan is None:
            return self.shared.grid()
        return self.shared.live(self.pose, self.scan)

    def lookouts(self) -> FloatArray:
        return np.empty((0, 2))

    def meeting_place(self) -> Pose2 | None:
        return None


class Team:
    """Explorers in a simulation. `checkpoint_at` replaces each of them by its checkpoint at that
    tick; what is seen from the points of `known_from` is on the map from the start."""

    def __init__(
        self,
        truth: OccupancyGrid,
        starts: list[tuple[float, float, float]],
        *,
        noise: str = "modern",
        policy: str = "frontier",
        max_sim_s: float = 200.0,
        executor: ThreadPoolExecutor | None = None,
        checkpoint_at: int | None = None,
        known_from: tuple[tuple[float, float], ...] = (),
    ) -> None:
        robots = tuple(
            RobotSpec(name=f"r{i + 1}", start=PoseModel(x_m=x, y_m=y, theta_rad=a), policy=policy)
            for i, (x, y, a) in enumerate(starts)
        )
        lidar = LidarConfig.model_validate({"noise": noise})
        self.scenario = Scenario(robots=robots, starts="known", lidar=lidar, max_sim_s=max_sim_s)
        self.simulation = Simulation(self.scenario, truth)
        self.names = self.simulation.names
        self.shared = OccupancyMap(truth.resolution, lidar)
        configs = [self.simulation.robot_config(name) for name in self.names]
        self.jobs = [Jobs(executor) for _ in configs]
        self.explorers = [Explorer(c, j) for c, j in zip(configs, self.jobs, strict=True)]
        self.odometry = [WheelOdometry(config.body) for config in configs]
        self.goals: list[Pose2 | None] = [None] * len(configs)
        self.drawn_at: list[Pose2 | None] = [None] * len(configs)
        self.checkpoint_at = checkpoint_at
        angles = beam_angles(lidar)
        for x, y in known_from:
            ranges = self.simulation.terrain.cast(x, y, angles, lidar.max_range_m)
            self.shared.add(Pose2(x, y, 0.0), LaserScan(ranges, angles, lidar.max_range_m))

    def run(self) -> Walk:
        simulation = self.simulation
        activities: dict[str, list[str]] = {name: [] for name in self.names}
        poses, commands = [], []
        senses = simulation.step({})
        while not simulation.done:
            if simulation.tick == self.checkpoint_at:
                self._checkpoint()
            here = [Pose2.from_array(pose.tolist()) for pose in simulation.poses]
            scans = [self._look(i, senses[n], here[i]) for i, n in enumerate(self.names)]
            decisions = [
                self._decide(i, senses[n], scans[i], here) for i, n in enumerate(self.names)
            ]
            self.goals = [decision.goal for decision in decisions]
            for name, decision in zip(self.names, decisions, strict=True):
                activities[name].append(decision.activity)
            poses.append(simulation.poses.copy())
            commands.append([[d.drive.forward_mps, d.drive.turn_rps] for d in decisions])
            senses = simulation.step(
                {
                    name: Action(tick=simulation.tick, drive=d.drive, finished=d.finished)
                    for name, d in zip(self.names, decisions, strict=True)
                }
            )
        grid = self.shared.grid()
        return Walk(simulation, grid, np.array(poses), np.array(commands), activities)

    def _look(self, i: int, sense: Sense, here: Pose2) -> LaserScan:
        assert sense.ranges is not None
        scan = perceive(sense.ranges, self.scenario.lidar, sense.sightings)
        before = self.drawn_at[i]
        turned = 0.0 if before is None else math.remainder(here.theta - before.theta, math.tau)
        if before is None or before.distance_to(here) > 0.15 or abs(turned) > 0.15:
            self.shared.add(here, scan)
            self.drawn_at[i] = here
        return scan

    def _decide(self, i: int, sense: Sense, scan: LaserScan, here: list[Pose2]) -> Decision:
        shared = _Shared(self.shared)
        shared.pose, shared.scan = here[i], scan
        mates = tuple(
            Teammate(self.names[k], here[k], self.goals[k], 0, True)
            for k in range(len(here))
            if k != i and here[k].distance_to(here[i]) <= EARSHOT_M
        )
        motion = self.odometry[i].step(sense.encoders)
        return self.explorers[i].step(sense.tick, here[i], motion, scan, shared, mates)

    def _checkpoint(self) -> None:
        for i, name in enumerate(self.names):
            self.jobs[i].settle()
            data = dump_state(self.explorers[i])
            fresh = Explorer(self.simulation.robot_config(name), Jobs())
            adopt_state(fresh, data)
            self.explorers[i] = fresh


@pytest.fixture(name="team")
def make_team() -> Callable[..., Team]:
    return Team


def _walls(cells: np.ndarray) -> OccupancyGrid:
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = 100, 100, 100, 100
    return OccupancyGrid(cells, 0.05, 0.0, 0.0)


@pytest.fixture(name="two_rooms")
def make_two_rooms() -> Callable[[float], OccupancyGrid]:
    """Two rooms of 3.4 × 4 m with a door of the given width (m) in a wall of 0.1 m."""

    def build(door_m: float) -> OccupancyGrid:
        cells = np.zeros((80, 140), dtype=np.int8)
        cells[:, 68:70] = 100
        width = round(door_m / 0.05)
        cells[40 - width // 2 : 40 - width // 2 + width, 68:70] = 0
        return _walls(cells)

    return build


@pytest.fixture(name="corridor")
def make_corridor() -> OccupancyGrid:
    """Two rooms of 3 × 4 m joined by a corridor 0.9 m wide and 6 m long."""
    cells = np.full((84, 240), 100, dtype=np.int8)
    cells[2:-2, 2:62] = 0
    cells[2:-2, -62:-2] = 0
    cells[33:51, 60:-60] = 0
    return _walls(cells)
