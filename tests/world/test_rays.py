"""Ray casting: bit for bit what a walk cell by cell gives, and what geometry says."""

import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from maps.grid import OccupancyGrid
from maps.library import load_map
from world.terrain import Terrain


def grid_of(solid: npt.NDArray[np.bool_], resolution: float = 1.0) -> OccupancyGrid:
    return OccupancyGrid(np.where(solid, 100, 0).astype(np.int8), resolution, 0.0, 0.0)


def walk(solid: npt.NDArray[np.bool_], x: float, y: float, angle: float, limit: float) -> float:
    """Amanatides and Woo's walk, one cell at a time, over a grid with a solid rim."""
    dx, dy = math.cos(angle), math.sin(angle)
    column, row = math.floor(x), math.floor(y)
    step_x, step_y = (-1 if d < -1e-12 else 1 for d in (dx, dy))
    inverse_x, inverse_y = (1.0 / d if abs(d) > 1e-12 else math.inf for d in (dx, dy))
    t = 0.0
    while not solid[row, column]:
        next_x = (column + (step_x + 1) // 2 - x) * inverse_x
        next_y = (row + (step_y + 1) // 2 - y) * inverse_y
        if next_x < next_y:
            t, column = next_x, column + step_x
        else:
            t, row = next_y, row + step_y
        if t > limit:
            return math.inf
    return t


def assert_walks_agree(
    terrain: Terrain, rng: np.random.Generator, points: int, beams: int, limit: float
) -> None:
    rows, columns = np.nonzero(terrain.grid.free)
    for i in rng.integers(0, len(rows), points).tolist():
        x, y = columns[i] + rng.random(), rows[i] + rng.random()
        cell = terrain.cell
        at_x, at_y = terrain.grid.origin_x + x * cell, terrain.grid.origin_y + y * cell
        angles = rng.uniform(-4.0, 4.0, beams)
        ranges = terrain.cast(at_x, at_y, angles, limit * cell)
        start = terrain.to_cells(np.array([at_x, at_y]))
        walked = [walk(terrain.solid, start[0], start[1], a, limit) * cell for a in angles]
        assert np.array_equal(ranges, walked)


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    height=st.integers(1, 24),
    width=st.integers(1, 24),
    share=st.sampled_from([0.0, 0.02, 0.1, 0.4]),
)
def test_skipping_cells_changes_not_a_bit(seed: int, height: int, width: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    solid = rng.random((height, width)) < share
    if solid.all():
        return
    assert_walks_agree(Terrain(grid_of(solid)), rng, points=6, beams=20, limit=30.0)


def test_axis_parallel_and_corner_rays_agree_with_the_walk() -> None:
    solid = np.zeros((9, 9), dtype=bool)
    solid[2, 6] = solid[6, 3] = solid[5, 5] = True
    terrain = Terrain(grid_of(solid))
    angles = np.linspace(-math.pi, math.pi, 33)
    for x in (0.0, 0.5, 4.0, 4.5, 7.999):
        for y in (0.0, 1.0, 2.5, 4.0, 8.5):
            if not solid[int(y), int(x)]:
                walked = [walk(terrain.solid, x + 1.0, y + 1.0, a, 99.0) for a in angles]
                assert np.array_equal(terrain.cast(x, y, angles, 99.0), walked)


def test_a_room_has_the_distances_it_has() -> None:
    terrain = Terrain(OccupancyGrid(np.zeros((40, 60), dtype=np.int8), 0.05, -1.0, 2.0))
    angles = np.array([0.0, math.pi / 2, math.pi, -math.pi / 2, math.pi / 4])
    ranges = terrain.cast(0.0, 2.5, angles, 12.0)
    assert ranges == pytest.approx([2.0, 1.5, 1.0, 0.5, 1.5 * math.sqrt(2.0)])


def test_nothing_within_range_is_infinite_and_at_the_range_is_not() -> None:
    terrain = Terrain(OccupancyGrid(np.zeros((4, 300), dtype=np.int8), 0.05, 0.0, 0.0))
    forward = np.zeros(1)
    assert terrain.cast(1.0, 0.1, forward, 12.0)[0] == math.inf
    assert terrain.cast(3.0, 0.1, forward, 12.0)[0] == pytest.approx(12.0)


def test_unknown_and_outside_are_solid() -> None:
    cells = np.array([[0, 0, -1, 0]], dtype=np.int8)
    terrain = Terrain(OccupancyGrid(cells, 1.0, 0.0, 0.0))
    assert terrain.cast(0.5, 0.5, np.array([0.0, math.pi]), 9.0) == pytest.approx([1.5, 0.5])
    assert terrain.cast(2.5, 0.5, np.zeros(1), 9.0)[0] == 0.0
    assert terrain.cast(-50.0, 0.5, np.zeros(1), 9.0)[0] == 0.0


@pytest.mark.parametrize("name", ["office", "loop", "rooms-small"])
def test_the_shipped_maps_agree_with_the_walk(name: str) -> None:
    rng = np.random.default_rng(1)
    assert_walks_agree(Terrain(load_map(name)), rng, points=20, beams=20, limit=240.0)


def test_real_maps_agree_with_the_walk(real_grid: OccupancyGrid) -> None:
    rng = np.random.default_rng(2)
    assert_walks_agree(Terrain(real_grid), rng, points=20, beams=20, limit=120.0)
