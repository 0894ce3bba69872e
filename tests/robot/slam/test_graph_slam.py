"""GraphSlam on a small building with a loop: accuracy, entries, determinism, hostile input."""

from typing import Any

import numpy as np
import pytest

from protocol.pose import FloatArray, Pose2, compose, invert
from protocol.state import dump_state, load_state
from robot.jobs import Jobs
from robot.perception.odometry import STILL, Motion
from robot.perception.scan import LaserScan
from robot.slam.dead_reckoning import DeadReckoning
from robot.slam.engine import Anchor, Closure, Estimate, Keyframe
from robot.slam.graph import GraphSlam


def run(engine: Any, drive: Any, first: int = 0, last: int | None = None) -> list[Estimate]:
    ticks = range(first, len(drive.scans) if last is None else last)
    return [engine.step(k, drive.motions[k], drive.scans[k]) for k in ticks]


def make(drive: Any, kind: Any = GraphSlam) -> Any:
    return kind(drive.lidar, drive.body, Pose2.from_array(drive.truth[0]), Jobs())


def errors(poses: FloatArray, truth: FloatArray) -> FloatArray:
    off = poses - truth
    return np.asarray(np.hypot(off[:, 0], off[:, 1]), dtype=np.float64)


@pytest.fixture(scope="module")
def done(lap: Any) -> tuple[GraphSlam, list[Estimate]]:
    slam = make(lap)
    estimates = run(slam, lap)
    return slam, estimates


def test_the_loop_closes_to_centimetres(lap: Any, done: Any) -> None:
    slam, estimates = done
    dead = make(lap, DeadReckoning)
    run(dead, lap)
    final = errors(slam.trajectory(), lap.truth)
    assert slam.loop_closures > 5
    assert np.sqrt(np.mean(final**2)) < 0.03
    assert final.max() < 0.08
    online = np.array([e.pose.to_array() for e in estimates])
    assert errors(online, lap.truth).max() < 0.12
    assert errors(dead.trajectory(), lap.truth).max() > 5 * final.max()


def test_every_step_has_a_pose_and_a_covariance(lap: Any, done: Any) -> None:
    slam, estimates = done
    assert slam.trajectory().shape == (len(lap.scans), 3)
    for estimate in estimates:
        assert np.isfinite(estimate.covariance).all()
        assert np.linalg.eigvalsh(estimate.covariance).min() > 0.0
        assert np.allclose(estimate.covariance, estimate.covariance.T)


def test_the_covariance_is_honest(lap: Any, done: Any) -> None:
    """Errors squared by the covariance: 3 on average if it is exact; far more is a lie."""
    _, estimates = done
    poses = np.array([e.pose.to_array() for e in estimates])
    off = compose(invert(lap.truth), poses)[5:]
    covariances = [e.covariance for e in estimates[5:]]
    nees = [v @ np.linalg.solve(C, v) for v, C in zip(off, covariances, strict=True)]
    assert np.mean(nees) < 6.0


def test_entries_can_be_replayed(lap: Any) -> None:
    """Anchors in order, each before its keyframes; both ends of a closure before it; and the chain
    of relative poses leads to where the robot was."""
    slam = make(lap)
    entries = []
    for k in range(len(lap.scans)):
        slam.step(k, lap.motions[k], lap.scans[k])
        entries += slam.take_entries()
    assert slam.take_entries() == []
    anchors, keyframes = 0, 0
    for entry in entries:
        if isinstance(entry, Anchor):
            assert entry.index == anchors
            anchors += 1
        elif isinstance(entry, Keyframe):
            assert entry.index == keyframes
            assert entry.anchor < anchors
            keyframes += 1
        else:
            assert isinstance(entry, Closure)
            assert entry.of < anchors
            assert entry.to < anchors
        if not isinstance(entry, Keyframe):
            assert np.linalg.eigvalsh(entry.information).min() > 0.0
    assert anchors == len(slam.graph().nodes) > 3
    assert keyframes > 60
    graph = slam.graph()
    for entry in entries:
        if isinstance(entry, Keyframe):
            pose = Pose2.from_array(graph.nodes[entry.anchor]) @ entry.T_anchor_keyframe
            assert errors(pose.to_array()[None], lap.truth[entry.tick][None])[0] < 0.1


def test_two_runs_are_equal_to_the_last_bit(lap: Any) -> None:
    results = []
    for _ in range(2):
        slam = make(lap)
        poses = [e.pose.to_array().tobytes() for e in run(slam, lap, last=150)]
        results.append((poses, slam.trajectory().tobytes(), slam.graph().information.tobytes()))
    assert results[0] == results[1]


def test_a_checkpoint_goes_on_as_if_nothing_had_been(lap: Any) -> None:
    straight = make(lap)
    run(straight, lap, last=140)
    kept = make(lap)
    run(kept, lap, last=100)
    restored = load_state(dump_state(kept), GraphSlam)
    run(restored, lap, first=100, last=140)
    assert restored.trajectory().tobytes() == straight.trajectory().tobytes()


def test_without_returns_it_falls_back_to_odometry(lap: Any) -> None:
    """In open space the pose follows the wheels and the covariance grows; back inside it heals."""
    slam = make(lap)
    run(slam, lap, last=40)
    before = slam.step(40, STILL, None)
    blind = LaserScan(np.full(lap.lidar.beams, np.inf), lap.scans[0].angles, 12.0)
    for k in range(41, 81):
        during = slam.step(k, lap.motions[k], blind)
    after = slam.step(81, lap.motions[81], lap.scans[81])
    assert during.covariance[0, 0] > 2.0 * before.covariance[0, 0]
    assert errors(during.pose.to_array()[None], lap.truth[80][None])[0] < 0.3
    assert errors(after.pose.to_array()[None], lap.truth[81][None])[0] < 0.1


def test_beams_that_say_nothing_do_no_harm(lap: Any) -> None:
    rng = np.random.default_rng(8)
    slam = make(lap)
    for k in range(120):
        ranges = lap.scans[k].ranges.copy()
        ranges[rng.random(len(ranges)) < 0.3] = np.nan
        ranges[rng.random(len(ranges)) < 0.1] = np.inf
        slam.step(k, lap.motions[k], LaserScan(ranges, lap.scans[k].angles, 12.0))
    assert errors(slam.trajectory(), lap.truth[:120]).max() < 0.05


def test_wheels_that_freeze_and_jump_are_overruled(lap: Any) -> None:
    """Counts that stand still for some scans and then arrive at once must not bend the map."""
    slam = make(lap)
    held = Pose2(0.0, 0.0, 0.0)
    for k in range(120):
        motion = lap.motions[k]
        if 60 <= k % 70 < 66:
            held = held @ motion.T_before_now
            motion = STILL
        elif held != Pose2(0.0, 0.0, 0.0):
            motion = Motion(held @ motion.T_before_now, np.diag([0.3**2, 0.1**2, 0.1**2]))
            held = Pose2(0.0, 0.0, 0.0)
        slam.step(k, motion, lap.scans[k])
    assert errors(slam.trajectory()[-1:], lap.truth[119:120])[0] < 0.1


@pytest.mark.parametrize("still", [2, 4])
def test_wheels_that_stutter_all_the_way_bend_nothing(lap: Any, still: int) -> None:
    """Every so often some readings are held back and come with the next one, which says no more
    about itself than others do."""
    slam = make(lap)
    held = STILL
    for k in range(len(lap.scans)):
        motion = lap.motions[k]
        together = Motion(
            held.T_before_now @ motion.T_before_now, held.covariance + motion.covariance
        )
        if k % 12 < still and k > 12:
            held, motion = together, STILL
        else:
            held, motion = STILL, together
        slam.step(k, motion, lap.scans[k])
    final = errors(slam.trajectory(), lap.truth)
    assert slam.loop_closures > 5
    assert np.sqrt(np.mean(final**2)) < 0.03
    assert final.max() < 0.1


def test_steps_without_a_scan_follow_the_wheels(lap: Any) -> None:
    slam = make(lap)
    run(slam, lap, last=10)
    pose = slam.step(10, STILL, None).pose
    moved = slam.step(11, Motion(Pose2(0.05, 0.0, 0.0), STILL.covariance), None).pose
    assert (pose.inverse() @ moved).x == pytest.approx(0.05)
