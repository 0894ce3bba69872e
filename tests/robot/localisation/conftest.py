"""A drive through a shipped map, with the noise of the simulation."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from maps.grid import OccupancyGrid
from protocol.config import BodyConfig, LidarConfig
from protocol.pose import FloatArray, Pose2
from robot.perception.odometry import Motion, WheelOdometry
from robot.perception.scan import LaserScan, perceive
from world.drive import Drives
from world.lidar import Lidars
from world.noise import Noise
from world.terrain import Terrain

TICK_S = 0.1


@dataclass(frozen=True)
class Way:
    """True poses (n×3), and what the robot noticed at each."""

    lidar: LidarConfig
    truth: FloatArray
    motions: list[Motion]
    scans: list[LaserScan]


def drive(grid: OccupancyGrid, start: Pose2, ticks: int, seed: int = 0) -> Way:
    """Straight on, and round where something is near."""
    terrain, body, lidar, noise = Terrain(grid), BodyConfig(), LidarConfig(), Noise(seed)
    drives = Drives(terrain, body, ("r1",), start.to_array()[None])
    lidars, odometry = Lidars(lidar, ("r1",), body.radius_m), WheelOdometry(body)
    way = Way(lidar, np.empty((ticks, 3)), [], [])
    turn = 0.0
    for tick in range(ticks):
        (ranges,) = lidars.scan(terrain, drives.poses, tick, noise)
        way.truth[tick] = drives.poses[0]
        way.motions.append(odometry.step(tuple(drives.encoders[0].tolist())))
        way.scans.append(perceive(ranges, lidar))
        scan = way.scans[-1]
        ahead = np.nanmin(scan.ranges[np.abs(scan.angles) < 0.5])
        turn = 1.0 if ahead < (1.2 if turn else 0.7) else 0.0
        drives.step(np.array([[0.0 if turn else 0.5, turn]]), tick, TICK_S, noise)
    return way


@pytest.fixture(scope="session")
def drive_in() -> Callable[..., Way]:
    return drive
