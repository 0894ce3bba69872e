"""Sightings: which teammates a robot sees, and where."""

from collections.abc import Sequence

import numpy as np

from maps.grid import IntArray
from protocol.config import SightingConfig
from protocol.messages import Sighting
from protocol.pose import FloatArray, wrap_angles
from world import neighbour_kernels, ray_kernels
from world.noise import Noise
from world.terrain import Terrain


class Sighters:
    """The sensors of all robots that tell teammates from walls, and from each other."""

    def __init__(self, config: SightingConfig, names: Sequence[str], radius_m: float) -> None:
        self._config = config
        self._names = tuple(names)
        self._radius_m = radius_m

    def visible(self, terrain: Terrain, poses: FloatArray) -> tuple[IntArray, IntArray]:
        """Who sees whom, as numbers of robots (k and k), in their order: within range, no wall
        and no third robot between the centres."""
        cells, radius = terrain.to_cells(poses), self._radius_m / terrain.cell
        limit = self._config.max_range_m / terrain.cell
        starts, others = neighbour_kernels.neighbours(cells, limit + radius)
        seen = np.empty(len(others), dtype=bool)
        ray_kernels.sights(terrain.squares, cells, starts, others, radius, limit, seen)
        lower = np.repeat(np.arange(len(poses)), np.diff(starts))[seen]
        upper = others[seen]
        seers, targets = np.concatenate([[lower, upper], [upper, lower]], axis=1)
        order = np.lexsort((targets, seers))
        return seers[order], targets[order]

    def sight(
        self, terrain: Terrain, poses: FloatArray, tick: int, noise: Noise
    ) -> list[tuple[Sighting, ...]]:
        """What each robot sees from poses (n×3), teammates in the order of the scenario."""
        config = self._config
        seers, seen = self.visible(terrain, poses)
        draws = noise.stream(self._names, "sightings").normals_of(tick, seers, seen, 2)
        dx, dy = (poses[seen, :2] - poses[seers, :2]).T
        ranges = np.maximum(np.hypot(dx, dy) + config.sigma_range_m * draws[:, 0], 0.0)
        bearings = np.arctan2(dy, dx) - poses[seers, 2] + config.sigma_bearing_rad * draws[:, 1]
        found: list[list[Sighting]] = [[] for _ in self._names]
        for i, k, range_m, bearing in zip(
            *map(np.ndarray.tolist, (seers, seen, ranges, wrap_angles(bearings))), strict=True
        ):
            # Made of known good parts; validation would cost more than all the rest.
            found[i].append(
                Sighting.model_construct(robot=self._names[k], range_m=range_m, bearing_rad=bearing)
            )
        return [tuple(sightings) for sightings in found]
