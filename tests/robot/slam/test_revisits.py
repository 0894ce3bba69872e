"""A building driven round again and again: what is known well is mapped no more."""

from typing import Any

import numpy as np
import pytest

from protocol.pose import Pose2
from protocol.state import dump_state, load_state
from robot.jobs import Jobs
from robot.perception.scan import LaserScan
from robot.slam.config import GraphSlamConfig
from robot.slam.engine import Anchor, Closure, Keyframe
from robot.slam.graph import GraphSlam

LAPS = 6
CONFIG = GraphSlamConfig()


@pytest.fixture(scope="module")
def patrol(drive_laps: Any) -> Any:
    """Some laps, and most of one more."""
    return drive_laps(LAPS + 0.8, seed=5, every=3)


def make(drive: Any) -> GraphSlam:
    return GraphSlam(drive.lidar, drive.body, Pose2.from_array(drive.truth[0]), Jobs())


def scans_of_a_lap(patrol: Any) -> int:
    return int(len(patrol.scans) / (LAPS + 0.8))


@pytest.fixture(scope="module")
def driven(patrol: Any) -> tuple[GraphSlam, list[Any], list[int]]:
    """The engine at the end, all entries, and the anchors there were after each lap."""
    slam, entries, anchors = make(patrol), [], []
    lap = scans_of_a_lap(patrol)
    for k in range(LAPS * lap):
        slam.step(k, patrol.motions[k], patrol.scans[k])
        entries += slam.take_entries()
        if k % lap == lap - 1:
            anchors.append(len(slam.anchors))
    return slam, entries, anchors


def test_the_graph_stops_growing(driven: Any) -> None:
    slam, entries, anchors = driven
    assert anchors[3] < 4.5 * anchors[0]
    assert anchors[-1] == anchors[3]
    assert len(slam.submaps) <= anchors[-1]
    pairs = [(min(e.of, e.to), max(e.of, e.to)) for e in entries if isinstance(e, Closure)]
    most = max(pairs.count(pair) for pair in pairs)
    # A job that was under way may add what another way of closing loops has added meanwhile.
    assert most <= 2 * CONFIG.closures.max_per_pair


def test_keyframes_stop_too(driven: Any, patrol: Any) -> None:
    _, entries, _ = driven
    ticks = np.array([e.tick for e in entries if isinstance(e, Keyframe)])
    lap = scans_of_a_lap(patrol)
    laps = np.bincount(ticks // lap, minlength=LAPS)
    assert laps[1] < laps[0]
    assert laps[3:].sum() < 0.1 * laps[0]


@pytest.fixture(scope="module")
def explored(patrol: Any) -> tuple[GraphSlam, list[list[Any]]]:
    """The engine, and the entries of each lap, when after two laps nothing is left to explore."""
    slam, laps = make(patrol), []
    lap = scans_of_a_lap(patrol)
    for k in range(5 * lap):
        slam.step(k, patrol.motions[k], patrol.scans[k], explored=k >= 2 * lap)
        if k % lap == lap - 1:
            laps.append(slam.take_entries())
    return slam, laps


def test_laps_of_an_explored_building_add_nothing(explored: Any, patrol: Any) -> None:
    slam, laps = explored
    lap = scans_of_a_lap(patrol)
    assert len(laps[1]) > 50
    assert len(laps[2]) < 0.2 * len(laps[1])
    assert not laps[3]
    assert not laps[4]
    off = np.hypot(*(slam.trajectory() - patrol.truth[: 5 * lap])[:, :2].T)
    assert np.sqrt(np.mean(off[-lap:] ** 2)) < 0.015


def test_what_has_changed_in_an_explored_building_is_mapped_again(
    explored: Any, patrol: Any
) -> None:
    slam = load_state(dump_state(explored[0]), GraphSlam)
    first, before = len(slam.trajectory()), len(slam.anchors)
    for k in range(first, first + 60):
        ranges = patrol.scans[k].ranges.copy()
        ranges[:120] = np.minimum(ranges[:120], 0.6)
        scan = LaserScan(ranges, patrol.scans[k].angles, 12.0)
        slam.step(k, patrol.motions[k], scan, explored=True)
    assert len(slam.anchors) > before
    assert any(isinstance(entry, Keyframe) for entry in slam.take_entries())


def test_the_pose_does_not_drift_on_known_ground(driven: Any, patrol: Any) -> None:
    slam, _, _ = driven
    lap = scans_of_a_lap(patrol)
    off = np.hypot(*(slam.trajectory() - patrol.truth[: LAPS * lap])[:, :2].T)
    early, late = np.sqrt(np.mean(off[:lap] ** 2)), np.sqrt(np.mean(off[-lap:] ** 2))
    assert late < 0.012
    assert late < 1.5 * early


def test_entries_can_be_replayed(driven: Any) -> None:
    """An anchor that follows known ground is held by a closure, and both lead to the same place."""
    slam, entries, _ = driven
    anchors = 0
    for entry in entries:
        if isinstance(entry, Anchor):
            assert entry.index == anchors
            anchors += 1
        elif isinstance(entry, Keyframe):
            assert entry.anchor < anchors
        else:
            assert max(entry.of, entry.to) < anchors
            assert entry.of != entry.to
    assert anchors == len(slam.anchors)


def test_what_has_changed_is_mapped_again(driven: Any, patrol: Any) -> None:
    """With something large beside it that no submap knows, the robot maps, and stays where it is;
    when that is gone it needs no new submaps again."""
    slam = load_state(dump_state(driven[0]), GraphSlam)
    first, before, settled = len(slam.trajectory()), len(slam.anchors), []
    for k in range(first, len(patrol.scans)):
        scan = patrol.scans[k]
        if k < first + 60:
            ranges = scan.ranges.copy()
            ranges[:120] = np.minimum(ranges[:120], 0.6)
            scan = LaserScan(ranges, scan.angles, 12.0)
        slam.step(k, patrol.motions[k], scan)
        settled.append(len(slam.anchors))
    assert settled[60] > before
    assert settled[-1] <= settled[60] + 3
    off = slam.trajectory()[first:] - patrol.truth[first:]
    assert np.hypot(off[:, 0], off[:, 1]).max() < 0.1


def test_a_checkpoint_on_known_ground_goes_on_alike(driven: Any, patrol: Any) -> None:
    checkpoint, first = dump_state(driven[0]), len(driven[0].trajectory())
    poses = []
    for _ in range(2):
        slam = load_state(checkpoint, GraphSlam)
        for k in range(first, first + 60):
            slam.step(k, patrol.motions[k], patrol.scans[k])
        poses.append(slam.trajectory().tobytes())
    assert poses[0] == poses[1]
