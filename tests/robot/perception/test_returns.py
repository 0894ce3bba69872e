"""What a scan's returns say of the walls they lie on: plain ones, and ragged ones."""

import numpy as np

from protocol.config import LidarConfig
from protocol.pose import FloatArray
from robot.perception.returns import Returns, describe_returns, noise_model
from robot.perception.scan import LaserScan

LIDAR = LidarConfig()
WALL_M = 3.0
STEP_M, WIDTH_M = 0.2, 0.4
ANGLES = np.radians(np.linspace(50.0, 130.0, 81))


def returns_of(ranges: FloatArray, seed: int) -> tuple[Returns, FloatArray]:
    """Those of ranges (n) with noise, whose σ (n) is given too."""
    sigma = 0.01 + 0.005 * ranges
    noisy = ranges + sigma * np.random.default_rng(seed).standard_normal(len(ranges))
    scan = LaserScan(noisy, ANGLES, LIDAR.max_range_m)
    return describe_returns(scan, noise_model(LIDAR), LIDAR.max_range_m), sigma


def test_noise_does_not_break_a_plain_wall() -> None:
    linked, off = [], []
    for seed in range(40):
        returns, sigma = returns_of(WALL_M / np.sin(ANGLES), seed)
        linked.append(returns.links[:-1].mean())
        off.append((returns.values[:, 1] - WALL_M) / (sigma * np.sin(ANGLES)))
    assert np.mean(linked) > 0.95
    assert np.sqrt(np.mean(np.square(off))) < 0.6  # the line through neighbours averages it out


def test_a_ragged_wall_is_neither_bridged_nor_smoothed() -> None:
    """Every second stretch of the wall stands back by a step."""
    along = WALL_M / np.tan(ANGLES)
    back = np.floor(along / WIDTH_M) % 2.0 == 1.0
    depth = WALL_M + STEP_M * back
    beside = np.pad(back, 1, mode="edge")
    edge = back & ~(beside[:-2] & beside[2:])  # of what the part in front hides
    over_steps, between, off, shadows, others = [], [], [], [], []
    for seed in range(40):
        returns, _ = returns_of(depth / np.sin(ANGLES), seed)
        steps = back[1:] != back[:-1]
        over_steps.append(returns.links[:-1][steps].mean())
        between.append(returns.links[:-1][~steps].mean())
        off.append(np.median(returns.values[:, 1] - depth))
        weights = returns.values[:, 4]
        shadows.append((weights[edge] == 0.0).mean())
        others.append((weights[~edge] == 0.0).mean())
    assert np.mean(over_steps) < 0.1
    assert np.mean(between) > 0.7
    assert abs(np.mean(off)) < 0.003
    assert np.mean(shadows) > 0.9  # where they lie moves with the robot
    assert np.mean(others) < 0.03


def test_where_nobody_knows_the_noise_all_returns_weigh_something() -> None:
    depth = WALL_M + STEP_M * (np.floor(WALL_M / np.tan(ANGLES) / WIDTH_M) % 2.0 == 1.0)
    scan = LaserScan(depth / np.sin(ANGLES), ANGLES, LIDAR.max_range_m)
    unknown = noise_model(LidarConfig(noise="none"))
    assert describe_returns(scan, unknown, LIDAR.max_range_m).values[:, 4].min() > 0.5
