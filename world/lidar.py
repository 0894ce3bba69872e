"""Range finders: what each robot's scan says, by eq. 14 of the paper."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from protocol.config import LidarConfig
from protocol.pose import FloatArray
from world import neighbour_kernels, ray_kernels
from world.noise import Noise
from world.terrain import Terrain

# σ_r(r) = a + b r + √(c r), as (a, b, c): the two levels of LidarConfig.sigma_range_m, and none.
SPREAD = {"modern": (0.01, 0.005, 0.0), "paper": (0.0, 0.0, 0.01), "none": (0.0, 0.0, 0.0)}


class Lidars:
    """The range finders of all robots."""

    def __init__(self, config: LidarConfig, names: Sequence[str], radius_m: float) -> None:
        self._config = config
        self._names = tuple(names)
        self._radius_m = radius_m
        steps = np.arange(config.beams, dtype=np.float64)
        self._angles: FloatArray = config.angle_min_rad + steps * config.increment_rad

    def due(self, tick: int) -> bool:
        """Whether there is a scan at this tick."""
        return tick % self._config.every_ticks == 0

    def scan(
        self, terrain: Terrain, poses: FloatArray, tick: int, noise: Noise
    ) -> npt.NDArray[np.float32]:
        """Ranges (n×beams, m, read-only) from poses (n×3).

        A beam points a little off its nominal angle and reports under it; its range is noisy.
        Other robots' discs are seen. +inf: nothing within range; 0: nearer than the minimum.
        """
        config = self._config
        draws = noise.stream(self._names, "lidar").normals(tick, 2 * config.beams)
        # Neighbours one after the other: they look at the same part of the map, which is then
        # still at hand.
        order = np.lexsort(np.floor(poses[:, :2].T / config.max_range_m))
        cells = terrain.to_cells(poses)
        reach = (config.max_range_m + self._radius_m) / terrain.cell
        starts, others = neighbour_kernels.neighbours(cells, reach)
        ranges = np.empty((len(poses), config.beams), dtype=np.float32)
        ray_kernels.scan_all(
            terrain.squares,
            cells,
            order,
            starts,
            others,
            self._radius_m / terrain.cell,
            self._angles,
            config.sigma_angle_rad,
            draws.reshape(-1, 2, config.beams),
            config.min_range_m,
            config.max_range_m,
            np.array(SPREAD[config.noise]),
            terrain.cell,
            ranges,
        )
        ranges.setflags(write=False)
        return ranges
