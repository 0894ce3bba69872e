"""A world of straight walls for scans whose truth is known."""

import numpy as np
import pytest

from protocol.config import LidarConfig
from protocol.pose import FloatArray, Pose2
from robot.perception.scan import LaserScan, beam_angles


class WallWorld:
    """Walls (n×4: x0, y0, x1, y1, m) and a range finder that sees them."""

    def __init__(self, walls: list[tuple[float, float, float, float]]) -> None:
        self._start = np.array(walls)[:, :2]
        self._along = np.array(walls)[:, 2:] - self._start

    def scan(
        self, pose: Pose2, lidar: LidarConfig, rng: np.random.Generator | None = None
    ) -> LaserScan:
        """The scan from a pose; with a generator, by the noise of the range finder."""
        nominal = beam_angles(lidar)
        angles = nominal.copy()
        if rng is not None:
            angles += rng.standard_normal(len(angles)) * lidar.sigma_angle_rad
        ranges = self._cast(pose, angles)
        if rng is not None:
            sigma = np.array([lidar.sigma_range_m(r) if np.isfinite(r) else 0.0 for r in ranges])
            ranges = ranges + rng.standard_normal(len(ranges)) * sigma
        ranges[ranges > lidar.max_range_m] = np.inf
        return LaserScan(ranges, nominal, lidar.max_range_m)

    def _cast(self, pose: Pose2, angles: FloatArray) -> FloatArray:
        direction = np.stack([np.cos(pose.theta + angles), np.sin(pose.theta + angles)], axis=-1)
        to_start = self._start - np.array([pose.x, pose.y])
        cross = (
            direction[:, None, 0] * self._along[:, 1] - direction[:, None, 1] * self._along[:, 0]
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            ahead = (
                to_start[:, 0] * self._along[:, 1] - to_start[:, 1] * self._along[:, 0]
            ) / cross
            beside = (
                to_start[:, 0] * direction[:, None, 1] - to_start[:, 1] * direction[:, None, 0]
            ) / cross
        hit = (ahead > 0.0) & (beside >= 0.0) & (beside <= 1.0)
        return np.asarray(np.where(hit, ahead, np.inf).min(axis=1), dtype=np.float64)


ROOM = [
    (0.0, 0.0, 8.0, 0.0),
    (8.0, 0.0, 8.0, 5.0),
    (8.0, 5.0, 0.0, 5.0),
    (0.0, 5.0, 0.0, 0.0),
    (3.0, 0.0, 3.0, 1.5),
    (5.0, 5.0, 5.0, 3.8),
    (6.0, 1.0, 6.6, 1.4),
]


@pytest.fixture(scope="session")
def room() -> WallWorld:
    """A room of 8 × 5 m with two short walls and a slanted one."""
    return WallWorld(ROOM)


@pytest.fixture(scope="session")
def corridor() -> WallWorld:
    """Two long parallel walls, 2 m apart, whose ends nobody sees."""
    return WallWorld([(-50.0, -1.0, 50.0, -1.0), (-50.0, 1.0, 50.0, 1.0)])


@pytest.fixture(scope="session")
def square() -> WallWorld:
    """An empty room of 4 × 4 m round the origin."""
    return WallWorld(
        [
            (-2.0, -2.0, 2.0, -2.0),
            (2.0, -2.0, 2.0, 2.0),
            (2.0, 2.0, -2.0, 2.0),
            (-2.0, 2.0, -2.0, -2.0),
        ]
    )
