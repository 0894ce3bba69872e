"""One scan matched on another, in rooms of straight walls."""

import math

import numpy as np
import pytest

from protocol.config import LidarConfig
from protocol.pose import FloatArray, Pose2
from robot.perception.pair_matching import PairMatch, match_pair
from robot.perception.returns import Returns, describe_returns, noise_model
from robot.perception.scan import LaserScan, beam_angles

LIDAR = LidarConfig()
NOISE = noise_model(LIDAR)
# Walls as (normal x, normal y, distance): a room, and a corridor without ends.
ROOM = ((1.0, 0.0, 4.0), (-1.0, 0.0, 3.0), (0.0, 1.0, 2.5), (0.0, -1.0, 2.0), (0.8, 0.6, 3.5))
CORRIDOR = ((0.0, 1.0, 1.0), (0.0, -1.0, 1.0))


def seen(walls: tuple[tuple[float, float, float], ...], pose: Pose2, seed: int) -> Returns:
    """Returns of a scan at a pose among walls nᵀp = d, with noise."""
    angles = beam_angles(LIDAR)
    ranges = np.full(len(angles), np.inf)
    for nx, ny, distance in walls:
        facing = nx * np.cos(pose.theta + angles) + ny * np.sin(pose.theta + angles)
        with np.errstate(divide="ignore"):
            reach = (distance - nx * pose.x - ny * pose.y) / facing
        ranges = np.minimum(ranges, np.where(facing > 1e-9, reach, np.inf))
    rng = np.random.default_rng(seed)
    ranges = ranges + (0.01 + 0.005 * np.minimum(ranges, 100.0)) * rng.standard_normal(len(ranges))
    ranges[ranges > LIDAR.max_range_m] = np.inf
    scan = LaserScan(ranges, angles, LIDAR.max_range_m)
    return describe_returns(scan, NOISE, LIDAR.max_range_m)


def error(found: Pose2, truth: Pose2) -> FloatArray:
    return (truth.inverse() @ found).log()


@pytest.mark.parametrize("seed", range(8))
def test_a_room_is_recognised_from_a_wrong_guess(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T_a_b = Pose2.from_array(rng.uniform(-1.0, 1.0, 3) * (0.3, 0.3, 0.25))
    off = Pose2.from_array(rng.uniform(-1.0, 1.0, 3) * (0.2, 0.2, 0.25))
    here = Pose2(0.2, -0.1, 0.3)
    match = match_pair(
        seen(ROOM, here, seed), seen(ROOM, here @ T_a_b, 100 + seed), T_a_b @ off, NOISE
    )
    e = error(match.T_target_source, T_a_b)
    assert match.converged
    assert match.share > 0.8
    assert math.hypot(e[0], e[1]) < 0.02
    assert abs(e[2]) < math.radians(0.5)
    assert e @ match.information @ e < 25.0
    assert match.sigma_m < 0.01


def along(walls: tuple[tuple[float, float, float], ...], seed: int) -> PairMatch:
    """Two scans of a corridor, 0.3 m apart."""
    return match_pair(
        seen(walls, Pose2(0.0, 0.0, 0.1), 2 * seed),
        seen(walls, Pose2(0.3, 0.1, 0.0), 2 * seed + 1),
        Pose2(0.2, 0.1, -0.1),
        NOISE,
    )


@pytest.mark.parametrize("width", [1.0, 2.5])
def test_a_corridor_is_flagged(width: float) -> None:
    walls = ((0.0, 1.0, width), (0.0, -1.0, width))
    matches = [along(walls, seed) for seed in range(40)]
    assert np.mean([match.sigma_m > 0.05 for match in matches]) > 0.85
    for match in matches:  # what the noise of normals says is taken off, and no more than there is
        assert np.linalg.eigvalsh(match.information)[0] > -1e-6


def test_a_corridor_with_an_end_is_not_flagged() -> None:
    matches = [along((*CORRIDOR, (1.0, 0.0, 5.0)), seed) for seed in range(40)]
    truth = Pose2(0.0, 0.0, 0.1).inverse() @ Pose2(0.3, 0.1, 0.0)
    errors = np.array([error(match.T_target_source, truth) for match in matches])
    squared = [e @ match.information @ e for e, match in zip(errors, matches, strict=True)]
    assert max(match.sigma_m for match in matches) < 0.05
    assert np.abs(errors[:, :2]).max() < 0.1
    assert 0.4 < np.mean(squared) / 3.0 < 1.6


def test_too_few_returns_match_nothing() -> None:
    nothing = Returns.unlinked(np.empty((0, 6)))
    guess = Pose2(1.0, 2.0, 0.5)
    match = match_pair(nothing, seen(ROOM, Pose2(0.0, 0.0, 0.0), 1), guess, NOISE)
    assert not match.converged
    assert match.T_target_source == guess
    assert match.sigma_m == math.inf


def test_the_heading_may_be_far_off() -> None:
    here, there = Pose2(0.0, 0.0, 0.0), Pose2(0.1, 0.1, 0.6)
    match = match_pair(
        seen(ROOM, here, 3),
        seen(ROOM, there, 4),
        Pose2(0.0, 0.0, 0.0),
        NOISE,
        reach_rad=math.radians(45.0),
    )
    assert abs(error(match.T_target_source, there)[2]) < math.radians(0.5)
