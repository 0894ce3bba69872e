"""Scans from random free poses of a building, with the noise of a range finder and without."""

import math

import numpy as np

from maps.library import load_map
from protocol.config import BodyConfig, LidarConfig
from protocol.pose import Pose2
from robot.perception.scan import LaserScan, beam_angles
from world.lidar import Lidars
from world.noise import Noise
from world.terrain import Terrain

LIDAR = LidarConfig()
EXACT = LidarConfig(noise="none")


class Views:
    """A building that can be looked at; all that is random follows from the seed."""

    def __init__(self, name: str, seed: int) -> None:
        self._terrain = Terrain(load_map(name))
        self._rng = np.random.default_rng(seed)
        self._noisy = Lidars(LIDAR, ("r1",), BodyConfig().radius_m)
        self._exact = Lidars(EXACT, ("r1",), BodyConfig().radius_m)
        self._noise = Noise(seed)
        self._tick = 0

    def offset(self, half_m: float, half_rad: float) -> Pose2:
        """A move of up to `half_m` in any direction, with a turn of up to ± `half_rad`."""
        distance = half_m * math.sqrt(self._rng.random())
        angle = self._rng.uniform(-math.pi, math.pi)
        turn = self._rng.uniform(-half_rad, half_rad)
        return Pose2(distance * math.cos(angle), distance * math.sin(angle), turn)

    def free_pose(self) -> Pose2:
        """A pose at which a robot fits."""
        rows, columns = self._terrain.solid.shape
        while True:
            at = self._rng.random(2) * (columns, rows)
            x, y, _ = self._terrain.to_metres(np.array([[*at, 0.0]]))[0]
            pose = Pose2(float(x), float(y), float(self._rng.uniform(-math.pi, math.pi)))
            if self.is_free(pose):
                return pose

    def is_free(self, pose: Pose2) -> bool:
        return not self._terrain.disc_overlaps(pose.x, pose.y, BodyConfig().radius_m)

    def scan(self, pose: Pose2, noisy: bool = True) -> LaserScan:
        """What is seen from a pose. Noise differs from one look to the next."""
        self._tick += noisy
        lidars = self._noisy if noisy else self._exact
        ranges = lidars.scan(self._terrain, pose.to_array()[None], self._tick, self._noise)[0]
        return LaserScan(ranges.astype(np.float64), beam_angles(LIDAR), LIDAR.max_range_m)
