"""Sightings: which teammates a robot sees, and where."""

import math
from collections.abc import Sequence

import numpy as np

from maps.grid import BoolArray
from protocol.config import SightingConfig
from protocol.messages import Sighting
from protocol.pose import FloatArray, wrap_angle
from world import ray_kernels
from world.noise import Noise
from world.terrain import Terrain


class Sighters:
    """The sensors of all robots that tell teammates from walls, and from each other."""

    def __init__(self, config: SightingConfig, names: Sequence[str], radius_m: float) -> None:
        self._config = config
        self._names = tuple(names)
        self._radius_m = radius_m

    def visible(self, terrain: Terrain, poses: FloatArray) -> BoolArray:
        """Who sees whom (n×n): within range, no wall and no third robot between the centres."""
        seen = np.zeros((len(poses), len(poses)), dtype=bool)
        ray_kernels.sights(
            terrain.squares,
            terrain.to_cells(poses),
            self._radius_m / terrain.cell,
            self._config.max_range_m / terrain.cell,
            seen,
        )
        return seen

    def sight(
        self, terrain: Terrain, poses: FloatArray, tick: int, noise: Noise
    ) -> list[tuple[Sighting, ...]]:
        """What each robot sees from poses (n×3), teammates in the order of the scenario."""
        seen: list[list[int]] = [[] for _ in self._names]
        for i, k in np.argwhere(self.visible(terrain, poses)).tolist():
            seen[i].append(k)
        positions = poses.tolist()
        return [
            self._of(i, others, positions, tick, noise) if others else ()
            for i, others in enumerate(seen)
        ]

    def _of(
        self, i: int, others: list[int], poses: list[list[float]], tick: int, noise: Noise
    ) -> tuple[Sighting, ...]:
        # Drawn for teammates that are not seen too, up to the last that is: whom a robot sees
        # must not decide the noise of another sighting.
        rng = noise.at(self._names[i], "sightings", tick)
        draws = rng.standard_normal((others[-1] + 1, 2))[others].tolist()
        x, y, heading = poses[i]
        sigma_range, sigma_bearing = self._config.sigma_range_m, self._config.sigma_bearing_rad
        sightings = []
        for k, (draw_range, draw_bearing) in zip(others, draws, strict=True):
            dx, dy = poses[k][0] - x, poses[k][1] - y
            range_m = math.hypot(dx, dy) + sigma_range * draw_range
            bearing = math.atan2(dy, dx) - heading + sigma_bearing * draw_bearing
            sightings.append(
                Sighting(
                    robot=self._names[k],
                    range_m=max(range_m, 0.0),
                    bearing_rad=wrap_angle(bearing),
                )
            )
        return tuple(sightings)
