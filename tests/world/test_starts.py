"""Where robots start, and where they can get to from there."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from maps.grid import OccupancyGrid
from maps.library import load_map
from protocol.config import PoseModel
from protocol.pose import FloatArray, Pose2
from world.noise import Noise
from world.scenario import RobotSpec, Scenario
from world.simulation import Simulation
from world.starts import APART_M, COMFORT_M, StartError, draw_starts, place_robots
from world.terrain import Terrain

RADIUS_M = 0.2
NOBODY: FloatArray = np.zeros((0, 2))


def two_rooms(door_m: float) -> Terrain:
    """3 × 3 m and 5 × 3 m beside each other, a door between them; 0.1 m cells."""
    cells = np.zeros((30, 82), dtype=np.int8)
    cells[:, 30:32] = 100
    cells[10 : 10 + round(door_m * 10), 30:32] = 0
    return Terrain(OccupancyGrid(cells, 0.1, 0.0, 0.0))


def gap(terrain: Terrain, x: float, y: float) -> float:
    """The distance to the nearest solid cell (m)."""
    rows, columns = np.nonzero(terrain.solid)
    at_x, at_y = terrain.to_cells(np.array([x, y]))
    gap_x = np.maximum(np.maximum(columns - at_x, at_x - columns - 1.0), 0.0)
    gap_y = np.maximum(np.maximum(rows - at_y, at_y - rows - 1.0), 0.0)
    return float(np.hypot(gap_x, gap_y).min()) * terrain.cell


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), radius=st.floats(0.01, 3.0), share=st.floats(0.0, 0.2))
def test_room_for_a_disc_is_exact(seed: int, radius: float, share: float) -> None:
    rng = np.random.default_rng(seed)
    cells = np.where(rng.random((12, 14)) < share, 100, 0).astype(np.int8)
    terrain = Terrain(OccupancyGrid(cells, 0.5, -1.0, 1.0))
    fits = terrain.room_for(radius)
    for row, column in np.ndindex(cells.shape):
        x, y = -1.0 + 0.5 * (column + 0.5), 1.0 + 0.5 * (row + 0.5)
        clearance = gap(terrain, x, y)
        if abs(clearance - radius) > 1e-9:
            assert fits[row, column] == (clearance > radius)
            assert terrain.disc_overlaps(x, y, radius) == (clearance < radius)


def test_a_door_wider_than_the_robot_lets_it_pass_and_a_narrower_does_not() -> None:
    start = np.array([[1.0, 1.5, 0.0]])
    assert two_rooms(0.5).reachable(RADIUS_M, start)[15, 70]
    assert not two_rooms(0.3).reachable(RADIUS_M, start)[15, 70]


def test_a_start_off_the_centre_of_its_cell_counts() -> None:
    terrain = two_rooms(0.3)
    reach = terrain.reachable(RADIUS_M, np.array([[RADIUS_M + 1e-6, 1.5, 0.0]]))
    assert reach[15, 10]
    assert not reach[15, 70]


def test_starts_are_in_the_largest_area_in_comfort_and_apart() -> None:
    terrain = two_rooms(0.3)
    for seed in range(10):
        starts = draw_starts(terrain, np.random.default_rng(seed), 4, RADIUS_M, NOBODY)
        assert starts.shape == (4, 3)
        assert (starts[:, 0] > 3.2).all()
        for i, (x, y, _) in enumerate(starts):
            assert gap(terrain, x, y) >= RADIUS_M + COMFORT_M - 1e-9
            assert all(math.hypot(*(other - starts[i])[:2]) >= APART_M for other in starts[:i])


def test_starts_are_spread_evenly() -> None:
    terrain = Terrain(OccupancyGrid(np.zeros((100, 100), dtype=np.int8), 0.1, 0.0, 0.0))
    rng = np.random.default_rng(5)
    starts = np.concatenate([draw_starts(terrain, rng, 1, RADIUS_M, NOBODY) for _ in range(400)])
    assert starts[:, :2].mean(axis=0) == pytest.approx([5.0, 5.0], abs=0.6)
    spread = 9.3 / math.sqrt(12.0)
    assert starts[:, :2].std(axis=0) == pytest.approx([spread, spread], rel=0.1)
    assert np.abs(np.exp(1j * starts[:, 2]).mean()) < 0.2


def test_where_it_is_tight_starts_are_closer() -> None:
    cells = np.zeros((5, 24), dtype=np.int8)
    terrain = Terrain(OccupancyGrid(cells, 0.1, 0.0, 0.0))
    starts = draw_starts(terrain, np.random.default_rng(0), 3, RADIUS_M, NOBODY)
    gaps = [math.hypot(*(a - b)[:2]) for i, a in enumerate(starts) for b in starts[:i]]
    assert min(gaps) > 2.0 * RADIUS_M


def test_no_room_is_said() -> None:
    terrain = Terrain(OccupancyGrid(np.zeros((3, 3), dtype=np.int8), 0.1, 0.0, 0.0))
    with pytest.raises(StartError, match="no room for a robot"):
        draw_starts(terrain, np.random.default_rng(0), 1, RADIUS_M, NOBODY)
    terrain = Terrain(OccupancyGrid(np.zeros((6, 6), dtype=np.int8), 0.1, 0.0, 0.0))
    with pytest.raises(StartError, match="no room for 2 robots"):
        draw_starts(terrain, np.random.default_rng(0), 2, RADIUS_M, NOBODY)


def placed(*starts: tuple[float, float] | None, seed: int = 0) -> FloatArray:
    robots = tuple(
        RobotSpec(
            name=f"r{i}", start=PoseModel(x_m=at[0], y_m=at[1], theta_rad=0.5) if at else None
        )
        for i, at in enumerate(starts)
    )
    return place_robots(Scenario(robots=robots, seed=seed), two_rooms(0.9), Noise(seed))


def test_given_starts_are_kept_and_others_drawn_around_them() -> None:
    for seed in range(5):
        poses = placed(None, (6.0, 1.5), None, seed=seed)
        assert poses[1].tolist() == [6.0, 1.5, 0.5]
        for i in (0, 2):
            assert math.hypot(*(poses[i] - poses[1])[:2]) >= APART_M


def test_impossible_starts_are_refused_by_name() -> None:
    with pytest.raises(StartError, match=r"r1 cannot start at \(3\.1, 0\.5\): a wall"):
        placed((1.0, 1.0), (3.1, 0.5))
    with pytest.raises(StartError, match=r"r1 cannot start .*: r0 stands there"):
        placed((1.0, 1.0), (1.3, 1.0))
    with pytest.raises(StartError, match="r0 cannot start"):
        placed((-5.0, 1.0))


@pytest.mark.parametrize("name", ["office", "loop", "rooms-small"])
def test_shipped_maps_have_room_for_a_team(name: str) -> None:
    terrain = Terrain(load_map(name))
    starts = draw_starts(terrain, np.random.default_rng(1), 5, RADIUS_M, NOBODY)
    reach = terrain.reachable(RADIUS_M, starts)
    free = terrain.grid.free.sum()
    assert reach.sum() > 0.6 * free


def test_real_maps_have_room_for_a_team(real_grid: OccupancyGrid) -> None:
    terrain = Terrain(real_grid)
    starts = draw_starts(terrain, np.random.default_rng(1), 3, RADIUS_M, NOBODY)
    reach = terrain.reachable(RADIUS_M, starts)
    assert reach.sum() * real_grid.resolution**2 > 100.0
    for x, y, _ in starts:
        assert not terrain.disc_overlaps(x, y, RADIUS_M + COMFORT_M - 1e-9)


def test_robots_that_start_at_the_same_place_stand_beside_each_other() -> None:
    robots = tuple(RobotSpec(name=f"r{n + 1}") for n in range(4))
    scenario = Scenario(map="office", robots=robots, starts="same", seed=5)
    simulation = Simulation(scenario)
    starts = simulation.starts
    apart = np.hypot(*(starts[:, None, :2] - starts[None, :, :2]).transpose(2, 0, 1))
    assert apart.max() < 2.0
    assert apart[~np.eye(4, dtype=bool)].min() >= 2.0 * scenario.body.radius_m
    assert np.ptp(starts[:, 2]) == 0.0
    told = [simulation.robot_config(name).start for name in simulation.names]
    assert told[0] is not None
    assert np.allclose(told[0].to_pose().to_array(), 0.0)
    T_world_first = Pose2.from_array(starts[0])
    for start, true in zip(told, starts, strict=True):
        assert start is not None
        assert np.allclose((T_world_first @ start.to_pose()).to_array(), true)
