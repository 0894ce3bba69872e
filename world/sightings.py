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
        seen = self.visible(terrain, poses)
        return [
            self._of(i, np.flatnonzero(row).tolist(), poses, tick, noise) if row.any() else ()
            for i, row in enumerate(seen)
        ]

    def _of(
        self, i: int, others: list[int], poses: FloatArray, tick: int, noise: Noise
    ) -> tuple[Sighting, ...]:
        # Drawn for all teammates: whom it sees must not decide the noise of another sighting.
        draws = noise.at(self._names[i], "sightings", tick).standard_normal((len(poses), 2))
        x, y, heading = poses[i].tolist()
        sightings = []
        for k in others:
            dx, dy = float(poses[k, 0]) - x, float(poses[k, 1]) - y
            range_m = math.hypot(dx, dy) + self._config.sigma_range_m * float(draws[k, 0])
            bearing = math.atan2(dy, dx) - heading
            sightings.append(
                Sighting.model_construct(
                    robot=self._names[k],
                    range_m=max(range_m, 0.0),
                    bearing_rad=wrap_angle(
                        bearing + self._config.sigma_bearing_rad * float(draws[k, 1])
                    ),
                )
            )
        return tuple(sightings)
