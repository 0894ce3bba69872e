"""Does a robot find out where it is in a known map, wherever it starts?

    python -m studies.localisation --maps MAPS/intel.yaml,MAPS/willow.yaml,office --starts 200 \\
        --json localisation.json

Starts and headings are drawn evenly over all ground where a robot fits. It gets the map as an
occupancy grid, its wheels' counts and its scans, all with the noise of the simulation, and turns
away from walls as it comes to them for 5 m. `right` is settled within 0.3 m and 5° of the truth,
`false` settled elsewhere, `undecided` not settled; also told is what it would have said from its
first scan alone (the best place by score, right or not).
"""

import math
import sys
import time
from typing import Any

import numpy as np

from maps.grid import OccupancyGrid
from maps.library import load_map
from protocol.config import BodyConfig, LidarConfig
from protocol.pose import FloatArray, Pose2, wrap_angle
from robot.localisation.hypotheses import GlobalLocaliser, Hypothesis
from robot.localisation.known_map import KnownMap
from robot.perception.odometry import WheelOdometry
from robot.perception.scan import LaserScan, perceive
from station.warm_up import ensure_warm
from studies.command import aligned, one_line_errors, study_parser, write_figures
from world.drive import Drives
from world.lidar import Lidars
from world.noise import Noise
from world.starts import draw_starts
from world.terrain import Terrain

NAME = "r1"
TICK_S = 0.1
NEAR_M, NEAR_RAD = 0.3, math.radians(5.0)
# The driver: turns where there is less room than this ahead, to the side with more of it.
ROOM_M = 0.8
AHEAD_RAD, SIDE_RAD = math.radians(25.0), math.radians(100.0)
SPEED_MPS, TURN_RPS = 0.5, 0.9
MAX_TICKS = 900


def locate(
    terrain: Terrain, known: KnownMap, start: FloatArray, drive_m: float, seed: int
) -> dict[str, Any]:
    """One start: what the robot knows after its first scan, and after driving so far."""
    body, lidar, noise = BodyConfig(), LidarConfig(), Noise(seed)
    drives = Drives(terrain, body, (NAME,), start[None])
    lidars = Lidars(lidar, (NAME,), body.radius_m)
    odometry, localiser = WheelOdometry(body), GlobalLocaliser(known, lidar)
    driven, tick, turning, longest = 0.0, 0, 0.0, 0.0
    first: str | None = None
    began = time.perf_counter()
    while driven < drive_m and tick < MAX_TICKS:
        (ranges,) = lidars.scan(terrain, drives.poses, tick, noise)
        scan = perceive(ranges, lidar)
        stepped = time.perf_counter()
        localiser.step(odometry.step(tuple(drives.encoders[0].tolist())), scan)
        longest = max(longest, time.perf_counter() - stepped)
        if first is None:
            first = _verdict(localiser.hypotheses[:1], drives.poses[0])
        if localiser.settled is not None:
            break
        turning = _turn(scan, turning)
        before = drives.poses[0].copy()
        command = [0.0 if turning else SPEED_MPS, turning]
        drives.step(np.array([command]), tick, TICK_S, noise)
        driven += float(np.hypot(*(drives.poses[0] - before)[:2]))
        tick += 1
    settled = localiser.settled
    return {
        "first_scan": first,
        "verdict": _verdict([settled] if settled else [], drives.poses[0]),
        "driven_m": driven,
        "hypotheses": len(localiser.hypotheses),
        "start": start.tolist(),
        "seconds": time.perf_counter() - began,
        "longest_step_s": longest,
    }


def _verdict(found: list[Hypothesis], truth: FloatArray) -> str:
    if not found:
        return "undecided"
    pose, true = found[0].pose, Pose2.from_array(truth)
    near = pose.distance_to(true) <= NEAR_M
    return "right" if near and abs(wrap_angle(pose.theta - true.theta)) <= NEAR_RAD else "false"


def _turn(scan: LaserScan, turning: float) -> float:
    """How to turn (rad/s): on in the same direction until there is room ahead, else not at all."""
    ranges = np.where(np.isnan(scan.ranges), 0.0, np.minimum(scan.ranges, scan.max_range_m))
    ahead = ranges[np.abs(scan.angles) <= AHEAD_RAD].min()
    if ahead >= ROOM_M * (1.5 if turning else 1.0):
        return 0.0
    if turning:
        return turning
    left = ranges[(scan.angles > 0.0) & (scan.angles < SIDE_RAD)].mean()
    right = ranges[(scan.angles < 0.0) & (scan.angles > -SIDE_RAD)].mean()
    return TURN_RPS if left >= right else -TURN_RPS


def measure(grid: OccupancyGrid, starts: int, drive_m: float, seed: int) -> dict[str, Any]:
    """All starts in one map."""
    terrain = Terrain(grid)
    began = time.perf_counter()
    # The world takes what is unknown as solid, and the robot is told so.
    known = KnownMap.of_grid(grid, unknown_is_solid=True)
    made_s = time.perf_counter() - began
    rng = np.random.default_rng(seed)
    poses = draw_starts(terrain, rng, starts, BodyConfig().radius_m, np.zeros((0, 2)))
    trials = []
    for number, pose in enumerate(poses):
        trials.append(locate(terrain, known, pose, drive_m, seed + number))
        if (number + 1) % 20 == 0:
            done = [trial["verdict"] for trial in trials]
            print(f"    {number + 1}: {done.count('right')} right, {done.count('undecided')} "
                  f"undecided, {done.count('false')} false", flush=True)  # fmt: skip
    verdicts = [trial["verdict"] for trial in trials]
    return {
        **{word: verdicts.count(word) for word in ("right", "undecided", "false")},
        "best_of_first_scan_right": sum(trial["first_scan"] == "right" for trial in trials),
        "driven_m_median": float(np.median([trial["driven_m"] for trial in trials])),
        "seconds_median": float(np.median([trial["seconds"] for trial in trials])),
        "longest_step_s_median": float(np.median([t["longest_step_s"] for t in trials])),
        "longest_step_s": max(trial["longest_step_s"] for trial in trials),
        "map_s": made_s,
        "trials": trials,
    }


@one_line_errors
def main(argv: list[str] | None = None) -> int:
    parser = study_parser("studies.localisation", __doc__)
    parser.add_argument("--maps", default="office", help="shipped maps or map_server files, by ,")
    parser.add_argument("--starts", type=int, default=200, help="in each map")
    parser.add_argument("--drive", type=float, default=5.0, metavar="METRES")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(argv)
    ensure_warm()
    figures: dict[str, Any] = {}
    for name in arguments.maps.split(","):
        print(f"  {name}", flush=True)
        grid = load_map(name)
        figures[name] = measure(grid, arguments.starts, arguments.drive, arguments.seed)
    for name, result in figures.items():
        print(name)
        told = {key: value for key, value in result.items() if key != "trials"}
        print(aligned([(key, f"{value:.4g}") for key, value in told.items()]))
    write_figures(figures, arguments.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
