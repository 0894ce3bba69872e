"""Following a robot in one submap, where a climb from the odometry's pose ends on a lesser peak."""

import math

import numpy as np
import pytest

from protocol.config import LidarConfig
from protocol.pose import IDENTITY, Pose2
from robot.perception.odometry import Motion
from robot.perception.returns import Returns, describe_returns, noise_model
from robot.perception.scan import LaserScan
from robot.slam.config import FrontEndConfig
from robot.slam.submap import Submap
from robot.slam.tracker import Tracker

BEAMS = 720
STEP = math.tau / BEAMS
LIDAR = LidarConfig(beams=BEAMS, angle_min_rad=-math.pi, noise="none")
CONFIG = FrontEndConfig()
# Pillars three metres off, two degrees wide, as the robot sees them at heading 0.
BEARINGS = np.cumsum(np.random.default_rng(3).uniform(4.0, 14.0, 34))


def seen(heading: float, range_m: float = 3.0) -> Returns:
    """The pillars, and nothing between them, after a turn on the spot."""
    angles = -math.pi + STEP * np.arange(BEAMS, dtype=np.float64)
    ranges = np.full(BEAMS, np.inf)
    for bearing in np.radians(BEARINGS):
        off = (angles + heading - bearing + math.pi) % math.tau - math.pi
        ranges[np.abs(off) <= math.radians(1.0)] = range_m
    return describe_returns(LaserScan(ranges, angles, 12.0), noise_model(LIDAR), 20.0)


def turned(degrees: float, sigma_rad: float) -> Motion:
    covariance = np.diag([1e-4, 1e-4, sigma_rad**2])
    return Motion(Pose2(0.0, 0.0, math.radians(degrees)), covariance)


def following(degrees: float) -> tuple[Tracker, Submap]:
    """A robot that turns by so much from scan to scan, and has drawn the first."""
    tracker, submap = Tracker(CONFIG), Submap.start(0, 6.0)
    tracker.correct(submap, seen(0.0))
    submap.insert(tracker.pose, seen(0.0))
    tracker.predict(turned(degrees, 0.01))
    tracker.correct(submap, seen(math.radians(degrees)))
    return tracker, submap


@pytest.mark.parametrize("wrong", [-4.0, -3.0, 3.0, 4.0])
def test_a_turn_that_the_wheels_misjudge_is_searched(wrong: float) -> None:
    """Nothing tells that the odometry is wrong but a poor match: it goes on as it did, and what the
    scan shows between the pillars is unknown ground."""
    tracker, submap = following(10.0)
    tracker.predict(turned(10.0, 0.018))
    match = tracker.correct(submap, seen(math.radians(20.0 - wrong)))
    # The wheels draw it by a little; the peak that a climb ends on is three degrees off.
    assert math.degrees(tracker.pose.theta) == pytest.approx(20.0 - wrong, abs=0.3)
    assert match.score > 0.75


@pytest.mark.parametrize("told", [0.0, 40.0])
def test_wheels_that_stop_or_jump_do_not_hold_the_robot(told: float) -> None:
    tracker, submap = following(12.0)
    tracker.predict(turned(told, 0.02 + 0.2 * math.radians(told)))
    tracker.correct(submap, seen(math.radians(24.0)))
    assert math.degrees(tracker.pose.theta) == pytest.approx(24.0, abs=0.2)


def test_few_returns_leave_the_robot_to_its_wheels() -> None:
    tracker, submap = following(10.0)
    before = tracker.pose
    tracker.predict(turned(10.0, 0.02))
    nothing = Returns.unlinked(np.empty((0, 6)))
    assert tracker.correct(submap, nothing).reason == "few returns"
    assert math.degrees(tracker.pose.theta - before.theta) == pytest.approx(10.0)
    assert tracker.covariance[2, 2] > 0.02**2


def test_another_submap_changes_the_frame_alone() -> None:
    tracker, submap = following(10.0)
    T_new_old = Pose2(1.0, -2.0, 0.7)
    there = Submap.start(1, 6.0)
    there.insert(T_new_old, seen(0.0))
    tracker.enter(T_new_old, T_new_old @ tracker.pose)
    tracker.predict(turned(0.0, 0.018))  # held back: constant velocity knows better
    tracker.correct(there, seen(math.radians(20.0)))
    found = T_new_old.inverse() @ tracker.pose
    assert math.hypot(found.x, found.y) < 0.02
    assert math.degrees(found.theta) == pytest.approx(20.0, abs=0.2)
    assert submap.keyframes[0] == pytest.approx(IDENTITY.to_array())
