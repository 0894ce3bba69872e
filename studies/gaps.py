"""How safely a robot drives through gaps that it hardly fits through.

    python -m studies.gaps
    python -m studies.gaps --drives 500 --json gaps.json

In each drive a path leads through a gap between two wall ends, thick or thin and not always
opposite each other, a little off its middle, and on between posts. The pilot drives on its scans
alone, so that what is counted is its own doing: contacts, and how often it got through in time.
A robot of 0.40 m need not dare 0.42 m; it must not touch at any width.
"""

import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass

import numpy as np

from maps.grid import OccupancyGrid
from protocol.config import PoseModel
from protocol.messages import Action
from protocol.pose import FloatArray, Pose2
from robot.explore.pilot import Pilot
from robot.explore.planner import resample
from robot.jobs import Jobs
from robot.perception.odometry import WheelOdometry
from robot.perception.scan import perceive
from studies.command import study_parser, write_figures
from world.scenario import RobotSpec, Scenario
from world.simulation import Simulation

WIDTHS_M = (0.42, 0.44, 0.46, 0.48, 0.50, 0.54, 0.60, 0.70)
CELL_M = 0.02
HEIGHT, LENGTH = 150, 200  # cells
WALL_COLUMN = 90
POSTS = 4
TIME_S = 40.0


@dataclass(frozen=True, slots=True)
class Course:
    """A world with one gap, and the way through it (n×2, m)."""

    width_m: float
    grid: OccupancyGrid
    start: Pose2
    way: FloatArray
    through_x_m: float


@dataclass(slots=True)
class Row:
    """All drives through gaps of one width."""

    width_m: float
    drives: int = 0
    through: int = 0
    contacts: int = 0


class _Surroundings:
    """The true map, for a pilot that has nobody to make room for."""

    def __init__(self, grid: OccupancyGrid) -> None:
        self._grid = grid

    def snapshot(self) -> OccupancyGrid:
        return self._grid

    def lookouts(self) -> FloatArray:
        return np.empty((0, 2))

    def meeting_place(self) -> Pose2 | None:
        return None


def make_course(seed: int) -> Course:
    """A course drawn by its seed."""
    rng = np.random.default_rng(seed)
    cells = np.zeros((HEIGHT, LENGTH), dtype=np.int8)
    cells[:3] = cells[-3:] = cells[:, :3] = cells[:, -3:] = 100
    width = float(rng.choice(WIDTHS_M))
    thick, shift, low = (
        int(rng.choice([1, 3, 5, 10, 30])),
        int(rng.integers(25)),
        rng.integers(55, 75),
    )
    high = int(low) + round(width / CELL_M)
    cells[:low, WALL_COLUMN : WALL_COLUMN + thick] = 100
    cells[high:, WALL_COLUMN + shift : WALL_COLUMN + shift + thick] = 100
    for row, column in rng.integers([5, 120], [140, 190], (POSTS, 2)):
        cells[row : row + 3, column : column + 3] = 100
    x = (WALL_COLUMN + 0.5 * (shift + thick)) * CELL_M
    y = 0.5 * (low + high) * CELL_M + rng.uniform(-0.04, 0.04)
    start = Pose2(*rng.uniform([0.5, 0.6, -3.0], [1.0, 2.4, 3.0]).tolist())
    corners = [[start.x, start.y], [x - 0.5, y], [x + 0.5, y], [3.4, rng.uniform(0.6, 2.4)]]
    grid = OccupancyGrid(cells, CELL_M, 0.0, 0.0)
    return Course(width, grid, start, resample(np.array(corners), 0.05), x + 0.5)


def drive(course: Course, seed: int) -> tuple[bool, int]:
    """Whether the robot got through, and how often it touched something."""
    robot = RobotSpec(name="r1", start=PoseModel.of(course.start))
    simulation = Simulation(Scenario(seed=seed, robots=(robot,), max_sim_s=TIME_S), course.grid)
    config = simulation.robot_config("r1")
    pilot, odometry = Pilot(config, Jobs()), WheelOdometry(config.body)
    goal = Pose2(float(course.way[-1, 0]), float(course.way[-1, 1]), 0.0)
    grids = _Surroundings(course.grid)
    pilot.follow(course.way)
    senses = simulation.step({})
    while not simulation.done and not pilot.arrived:
        sense = senses["r1"]
        assert sense.ranges is not None
        steering = pilot.step(
            sense.tick,
            Pose2.from_array(simulation.poses[0]),
            odometry.step(sense.encoders),
            perceive(sense.ranges, config.lidar),
            goal,
            grids,
            (),
        )
        if steering.wants_plan:
            pilot.follow(course.way)
        action = Action(
            tick=sense.tick, drive=steering.command, finished=False, frame_count=0, frames=()
        )
        senses = simulation.step({"r1": action})
    return bool(simulation.poses[0, 0] > course.through_x_m), simulation.collisions["r1"]


def gaps(drives: int) -> Iterator[Row]:
    """One row for each width, over so many drives in all."""
    rows = {width: Row(width) for width in WIDTHS_M}
    for seed in range(drives):
        course = make_course(seed)
        through, contacts = drive(course, seed)
        row = rows[course.width_m]
        row.drives, row.through = row.drives + 1, row.through + through
        row.contacts += contacts
    yield from rows.values()


def main(argv: list[str] | None = None) -> int:
    parser = study_parser("studies.gaps", __doc__)
    parser.add_argument("--drives", type=int, default=500, help="in all, over all widths")
    arguments = parser.parse_args(argv)
    rows = list(gaps(arguments.drives))
    print("gap m  drives  through  contacts")
    for row in rows:
        print(f"{row.width_m:5.2f}  {row.drives:6d}  {row.through:7d}  {row.contacts:8d}")
    contacts = sum(row.contacts for row in rows)
    print(f"contacts in all: {contacts}")
    table = {"contacts": contacts, "gaps": [asdict(row) for row in rows]}
    write_figures(table, arguments.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
