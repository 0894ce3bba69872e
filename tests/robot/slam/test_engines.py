"""Engines by name, dead reckoning, and the trajectory that all of them keep."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.config import BodyConfig, LidarConfig
from protocol.pose import Pose2
from robot.jobs import Jobs
from robot.perception.odometry import STILL, Motion
from robot.slam.dead_reckoning import DeadReckoning
from robot.slam.engine import Anchor, Keyframe
from robot.slam.engines import UnknownEngineError, make_engine
from robot.slam.gaussian import carry
from robot.slam.graph import GraphSlam
from robot.slam.trajectory import RelativeTrajectory

START = Pose2(3.0, -2.0, 1.0)


@pytest.mark.parametrize(
    ("name", "kind"), [("graph", GraphSlam), ("dead-reckoning", DeadReckoning)]
)
def test_engines_are_made_by_name(name: str, kind: Any) -> None:
    engine = make_engine(name, LidarConfig(), BodyConfig(), START, Jobs())
    assert isinstance(engine, kind)
    assert engine.step(0, STILL, None).pose == START


def test_an_unknown_engine_is_refused_with_the_known_ones() -> None:
    with pytest.raises(UnknownEngineError, match=r"'grpah'.*dead-reckoning, graph"):
        make_engine("grpah", LidarConfig(), BodyConfig(), START, Jobs())


def test_dead_reckoning_adds_motions_up(lap: Any) -> None:
    engine = DeadReckoning(lap.lidar, lap.body, START, Jobs())
    pose, grown = START, 0.0
    for k in range(60):
        estimate = engine.step(k, lap.motions[k], lap.scans[k])
        pose = pose @ lap.motions[k].T_before_now
        assert np.allclose(estimate.pose.to_array(), pose.to_array(), atol=1e-12)
        assert np.trace(estimate.covariance) > grown
        grown = float(np.trace(estimate.covariance))
    entries = engine.take_entries()
    assert isinstance(entries[0], Anchor)
    assert entries[0].T_previous_anchor == START
    assert all(isinstance(entry, Keyframe) for entry in entries[1:])
    assert len(entries) > 10
    assert engine.take_entries() == []
    assert np.allclose(engine.trajectory()[-1], pose.to_array())
    assert engine.loop_closures == 0
    assert engine.graph().nodes.shape == (1, 3)


def test_the_trajectory_follows_its_anchors() -> None:
    trajectory = RelativeTrajectory()
    for k in range(3000):
        trajectory.append(k // 1500, Pose2(0.001 * (k % 1500), 0.0, 0.0))
    anchors = np.array([[0.0, 0.0, 0.0], [5.0, 5.0, np.pi / 2]])
    poses = trajectory.poses(anchors)
    assert len(trajectory) == len(poses) == 3000
    assert np.allclose(poses[1499], [1.499, 0.0, 0.0])
    assert np.allclose(poses[2999], [5.0, 6.499, np.pi / 2])


@given(x=st.floats(-5, 5), y=st.floats(-5, 5), theta=st.floats(-3.1, 3.1))
def test_a_carried_covariance_comes_back(x: float, y: float, theta: float) -> None:
    covariance = np.array([[0.02, 0.005, 0.001], [0.005, 0.01, 0.0], [0.001, 0.0, 0.003]])
    T = Pose2(x, y, theta)
    there = carry(covariance, T)
    assert np.linalg.eigvalsh(there).min() > 0.0
    assert np.allclose(carry(there, T.inverse()), covariance, atol=1e-12)


def test_a_covariance_is_carried_as_samples_are() -> None:
    rng = np.random.default_rng(0)
    covariance, T = np.diag([1e-4, 4e-4, 1e-4]), Pose2(2.0, -1.0, 0.7)
    tangents = rng.multivariate_normal(np.zeros(3), covariance, 4000)
    moved = np.array([(T.inverse() @ Pose2.exp(v) @ T).log() for v in tangents])
    assert np.allclose(np.cov(moved.T), carry(covariance, T), atol=4e-5)


def test_motions_without_scans_are_followed() -> None:
    engine = GraphSlam(LidarConfig(), BodyConfig(), START, Jobs())
    step = Motion(Pose2(0.1, 0.0, 0.05), np.diag([1e-4, 1e-4, 1e-5]))
    pose = START
    for k in range(20):
        pose = pose @ step.T_before_now
        estimate = engine.step(k, step, None)
    assert np.allclose(estimate.pose.to_array(), pose.to_array())
    assert estimate.covariance[0, 0] > 1e-3
