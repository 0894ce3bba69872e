"""What weakens a radio link within its range: walls, or shadowing.

The power budget of a link of length r is that of the log-distance model (Rappaport, "Wireless
Communications", 2nd ed. 2002, eq. 4.69a), with the range d as what it is without obstacles:

    M(r) = 10 γ log10(d / r) − A,    a frame passes if r ≤ d and M ≥ 0

A is 0 for `disc`. For `line-of-sight` it is the loss in the walls on the straight line: dB per
metre of solid ground (what a multi-wall model as of Motley and Keenan, 1988, takes per wall, by
its thickness). For `shadowing` it is log-normal, and a property of the two places: links from near
by are alike, and the way back is as good as the way there.
"""

import numpy as np

from maps.grid import BoolArray
from protocol.pose import FloatArray
from world import channel_kernels
from world.noise import Noise
from world.scenario import GateConfig
from world.terrain import Terrain

WAVES = 32


class Channel:
    """The air of one building under one gate model."""

    def __init__(self, config: GateConfig, terrain: Terrain, noise: Noise) -> None:
        self._config = config
        self._terrain = terrain
        self._waves = np.zeros((0, 5))
        if config.model == "shadowing":
            self._waves = draw_waves(noise, config.shadowing_length_m / terrain.cell)

    def faded(self, poses: FloatArray) -> BoolArray:
        """Between whom the signal is too weak although they are in range (…×n×n, symmetric), at
        poses (…×n×2 or more)."""
        n = poses.shape[-2]
        faded = np.zeros((*poses.shape[:-2], n, n), dtype=bool)
        if self._config.model != "disc":
            terrain = self._terrain
            cells = terrain.to_cells(poses[..., :2]).reshape(-1, n, 2)
            many = faded.reshape(-1, n, n)
            channel_kernels.fade_all(terrain.solid, cells, self._budget(), self._waves, many)
        return faded

    def heard(self, at: tuple[float, float]) -> BoolArray:
        """On which cells of free ground (as the map's) a transmitter at (x, y) in m is heard."""
        terrain, grid = self._terrain, self._terrain.grid
        rows, columns = np.nonzero(grid.free)
        points = grid.to_points(rows, columns)
        near = np.hypot(*(points - np.array(at)).T) <= self._config.range_m
        faded = np.zeros(len(points), dtype=bool)
        if self._config.model != "disc":
            x, y = terrain.to_cells(np.array(at)).tolist()
            cells = terrain.to_cells(points)
            channel_kernels.fade_from(
                terrain.solid, x, y, cells, self._budget(), self._waves, faded
            )
        found = np.zeros(grid.cells.shape, dtype=bool)
        found[rows, columns] = near & ~faded
        return found

    def _budget(self) -> FloatArray:
        """What a link may lose, as the kernels take it: in cells and dB."""
        config, cell = self._config, self._terrain.cell
        walls = config.model == "line-of-sight"
        return np.array(
            [
                config.range_m / cell,
                config.path_loss_exponent,
                config.wall_loss_db_per_m * cell if walls else 0.0,
                0.0 if walls else config.shadowing_sigma_db,
                config.shadowing_length_m / cell,
            ]
        )


def draw_waves(noise: Noise, length: float) -> FloatArray:
    """Waves (K×5: a wave vector for either end, a phase) whose sum over the plane has the
    correlation exp(−δ / length).

    Its spectrum in the plane, ∝ (1 + length² |ω|²)^(−3/2), is the Cauchy distribution: a normal
    vector over a normal number.
    """
    rng = noise.at("*", "shadowing", 0)  # of the team: no robot has this name
    vectors = rng.standard_normal((WAVES, 2, 2)) / np.abs(rng.standard_normal((WAVES, 2, 1)))
    phases = rng.uniform(0.0, 2.0 * np.pi, (WAVES, 1))
    return np.hstack([vectors.reshape(WAVES, 4) / length, phases])
