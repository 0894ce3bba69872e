"""Real logs, forwards and backwards, with the parameters that every robot has.

Relations: Kümmerle et al., "On measuring the accuracy of SLAM algorithms", 2009; a relation counts
when both of its ends lie within 0.02 s of a scan. The data is research data beside the repository.
"""

import math
import os
from pathlib import Path

import numpy as np
import pytest

from protocol.config import BodyConfig, LidarConfig
from protocol.pose import IDENTITY, FloatArray, Pose2, compose, invert
from robot.jobs import Jobs
from robot.perception.odometry import Motion
from robot.perception.scan import perceive
from robot.slam.graph import GraphSlam
from robot.slam.pose_graph import optimise
from station.carmen import CarmenScan, read_scans

SHARED = Path(os.environ.get("EARSHOT_DATA") or Path(__file__).parents[4] / "shared")
DATA = SHARED / "data"

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not DATA.is_dir(), reason=f"no logs in {DATA}; EARSHOT_DATA names their folder"
    ),
]

# 180 beams stand at −90…+89°, 361 at −90…+90°.
FIELDS = {180: math.radians(179.0), 361: math.pi}


def motion_between(before: Pose2, now: Pose2) -> Motion:
    """Raw odometry, whose turns are worth little: stamps are late and wheels scrub."""
    T = before.inverse() @ now
    metres, radians = math.hypot(T.x, T.y), abs(T.theta)
    along = 0.10 * metres + 0.02 * radians + 0.001
    across = 0.05 * metres + 0.02 * radians + 0.001
    turned = 0.20 * radians + 0.05 * metres + 0.001
    return Motion(T, np.diag([along**2, across**2, turned**2]))


def run(scans: list[CarmenScan]) -> tuple[GraphSlam, FloatArray]:
    beams = len(scans[0].ranges)
    lidar = LidarConfig(
        beams=beams,
        field_of_view_rad=FIELDS[beams],
        angle_min_rad=-0.5 * math.pi,
        max_range_m=40.0,
        noise="none",
    )
    slam = GraphSlam(lidar, BodyConfig(), IDENTITY, Jobs())
    before = scans[0].odometry
    for tick, scan in enumerate(scans):
        ranges = perceive(scan.ranges.astype(np.float32), lidar)
        slam.step(tick, motion_between(before, scan.odometry), ranges)
        before = scan.odometry
    return slam, slam.trajectory()


def load(name: str, backwards: bool) -> tuple[list[CarmenScan], FloatArray]:
    """The scans in the order of the log, and their poses."""
    scans = read_scans(DATA / "carmen" / f"{name}.clf")
    _, poses = run(scans[::-1] if backwards else scans)
    return scans, poses[::-1] if backwards else poses


def nearest(stamps: FloatArray, wanted: FloatArray) -> np.ndarray:
    after = np.clip(np.searchsorted(stamps, wanted), 1, len(stamps) - 1)
    return np.where(stamps[after] - wanted < wanted - stamps[after - 1], after, after - 1)


def aligned_error(poses: FloatArray, truth: FloatArray) -> float:
    """RMSE (m) of positions after the best rotation and translation."""
    a, b = poses[:, :2] - poses[:, :2].mean(axis=0), truth[:, :2] - truth[:, :2].mean(axis=0)
    H = a.T @ b
    turn = Pose2(0.0, 0.0, math.atan2(H[0, 1] - H[1, 0], H[0, 0] + H[1, 1]))
    return float(np.sqrt(((turn.apply(a) - b) ** 2).sum(axis=1).mean()))


def read_tum(path: Path) -> tuple[FloatArray, FloatArray]:
    table = np.loadtxt(path)
    theta = 2.0 * np.arctan2(table[:, 6], table[:, 7])
    return table[:, 0], np.column_stack([table[:, 1:3], theta])


@pytest.mark.parametrize("backwards", [False, True])
def test_intel_relations(backwards: bool) -> None:
    scans, poses = load("intel-dense", backwards)
    stamps = np.array([scan.logger_stamp for scan in scans])
    relations = np.loadtxt(DATA / "relations" / "intel.relations")
    i, j = nearest(stamps, relations[:, 0]), nearest(stamps, relations[:, 1])
    near = (np.abs(stamps[i] - relations[:, 0]) < 0.02) & (
        np.abs(stamps[j] - relations[:, 1]) < 0.02
    )
    measured = compose(invert(poses[i[near]]), poses[j[near]])
    off = compose(invert(relations[near][:, [2, 3, 7]]), measured)
    assert near.sum() == 1030
    assert np.hypot(off[:, 0], off[:, 1]).mean() <= 0.018
    assert np.degrees(np.abs(off[:, 2]).mean()) <= 0.25


@pytest.mark.parametrize("backwards", [False, True])
def test_synthetic_building(backwards: bool) -> None:
    scans, poses = load("synth-361", backwards)
    stamps, truth = read_tum(DATA / "carmen" / "synth-361.truth.tum")
    places = nearest(np.array([scan.stamp for scan in scans]), stamps)
    assert aligned_error(poses[places], truth) <= 0.013


@pytest.mark.parametrize(("name", "limit_m"), [("mit-csail", 0.15), ("intel-910", 0.12)])
def test_loops_of_other_logs_close(name: str, limit_m: float) -> None:
    """Against the poses of another SLAM system: agreement, not truth."""
    scans, poses = load(name, False)
    stamps, reference = read_tum(DATA / "carmen" / f"{name}.reference.tum")
    own = np.array([scan.stamp for scan in scans])
    places = nearest(own, stamps)
    near = np.abs(own[places] - stamps) < 0.05
    assert near.sum() > 300
    assert aligned_error(poses[places[near]], reference[near]) <= limit_m


@pytest.mark.parametrize(("name", "chi2"), [("intel", 45.00), ("manhattan", 3549.04)])
def test_public_pose_graphs_from_odometry(name: str, chi2: float) -> None:
    rows = [
        [float(field) for field in line.split()[1:]]
        for line in (DATA / "pose_graphs" / f"{name}.g2o").read_text().splitlines()
        if line.startswith("EDGE_SE2")
    ]
    edges = np.array(rows)
    ids = edges[:, :2].astype(int)
    information = np.empty((len(edges), 3, 3))
    upper = np.triu_indices(3)
    information[:, upper[0], upper[1]] = edges[:, 5:]
    information[:, upper[1], upper[0]] = edges[:, 5:]
    nodes = np.zeros((ids.max() + 1, 3))
    for (a, b), measured in zip(ids, edges[:, 2:5], strict=True):
        if b == a + 1:
            nodes[b] = compose(nodes[a], measured)
    fixed = np.zeros(len(nodes), dtype=bool)
    fixed[0] = True
    solution = optimise(nodes, ids, edges[:, 2:5], information, fixed)
    assert solution.converged
    assert solution.chi2 == pytest.approx(chi2, abs=0.01)
