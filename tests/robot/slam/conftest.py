"""A small building with a loop corridor, driven round with noisy wheels and a noisy scanner."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from protocol.config import BodyConfig, LidarConfig
from protocol.pose import FloatArray, Pose2
from robot.perception.odometry import Motion, WheelOdometry
from robot.perception.scan import LaserScan, perceive

# Outer walls, the block in the middle, and stubs that make every corridor look different.
WALLS = np.array(
    [
        (0, 0, 12, 0), (12, 0, 12, 9), (12, 9, 0, 9), (0, 9, 0, 0),
        (2.2, 2.2, 9.8, 2.2), (9.8, 2.2, 9.8, 6.8), (9.8, 6.8, 2.2, 6.8), (2.2, 6.8, 2.2, 2.2),
        (4, 0, 4, 0.5), (7, 0, 7.4, 0.4), (12, 4, 11.6, 4.3), (8, 9, 8, 8.6), (3, 9, 3.5, 8.5),
        (0, 5, 0.4, 5), (6, 2.2, 6, 1.9), (9.8, 5.5, 10.1, 5.5),
    ],
    dtype=np.float64,
)  # fmt: skip
CORNERS = [(1.1, 1.1), (10.9, 1.1), (10.9, 7.9), (1.1, 7.9)]
START = Pose2(1.1, 1.1, 0.0)


@dataclass(frozen=True)
class Drive:
    """A recorded drive: true poses (n×3), motions and scans, one of each per tick."""

    lidar: LidarConfig
    body: BodyConfig
    truth: FloatArray
    motions: list[Motion]
    scans: list[LaserScan]


def cast(pose: Pose2, angles: FloatArray) -> FloatArray:
    """Ranges (n, m) to the nearest wall."""
    start, along = WALLS[:, :2] - np.array([pose.x, pose.y]), WALLS[:, 2:] - WALLS[:, :2]
    direction = np.stack([np.cos(pose.theta + angles), np.sin(pose.theta + angles)], axis=-1)
    cross = direction[:, None, 0] * along[:, 1] - direction[:, None, 1] * along[:, 0]
    ahead = (start[:, 0] * along[:, 1] - start[:, 1] * along[:, 0]) / cross
    beside = (start[:, 0] * direction[:, None, 1] - start[:, 1] * direction[:, None, 0]) / cross
    hit = (ahead > 0.0) & (beside >= 0.0) & (beside <= 1.0)
    return np.asarray(np.where(hit, ahead, np.inf).min(axis=1), dtype=np.float64)


def drive(laps: float, seed: int, noise: str = "modern", every: int = 1) -> Drive:
    """Round the loop at 0.6 m/s and 10 Hz; wheels err by 3 % of each increment."""
    rng = np.random.default_rng(seed)
    lidar, body = LidarConfig.model_validate({"noise": noise}), BodyConfig()
    odometry, wheels, pose = WheelOdometry(body), np.zeros(2), START
    truth: list[FloatArray] = []
    motions: list[Motion] = []
    scans: list[LaserScan] = []
    goal, done = 1, 0.0
    nominal = lidar.angle_min_rad + np.arange(lidar.beams) * lidar.increment_rad
    while done < laps * 33.2:
        counts = tuple(int(c) for c in np.floor(wheels / body.metres_per_count))
        if len(truth) % every == 0:
            angles = nominal + rng.standard_normal(lidar.beams) * lidar.sigma_angle_rad
            ranges = cast(pose, angles)
            ranges += rng.standard_normal(lidar.beams) * np.array(
                [lidar.sigma_range_m(r) for r in ranges]
            )
            truth.append(pose.to_array())
            motions.append(odometry.step(counts))
            scans.append(perceive(ranges.astype(np.float32), lidar))
        else:
            truth.append(pose.to_array())
        x, y = CORNERS[goal % 4]
        away = np.hypot(x - pose.x, y - pose.y)
        if away < 0.4:
            goal += 1
        bearing = (np.arctan2(y - pose.y, x - pose.x) - pose.theta + np.pi) % (2 * np.pi) - np.pi
        turn = float(np.clip(2.0 * bearing, -1.5, 1.5)) * 0.1
        forward = 0.06 * max(0.0, float(np.cos(bearing))) ** 2
        done += forward
        pose = pose @ Pose2.exp(np.array([forward, 0.0, turn]))
        increments = forward + turn * np.array([-0.5, 0.5]) * body.wheel_base_m
        wheels += increments * (1.0 + body.encoder_noise * rng.standard_normal(2))
    return Drive(lidar, body, np.array(truth[::every]), motions, scans)


@pytest.fixture(scope="session")
def drive_laps() -> Callable[..., Drive]:
    """`drive`, for tests that go round more often."""
    return drive


@pytest.fixture(scope="session")
def lap() -> Drive:
    """A bit more than one lap, so that the loop closes."""
    return drive(1.25, seed=3, every=2)
