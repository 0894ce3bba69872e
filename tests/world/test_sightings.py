"""Sightings: who sees whom, and how well."""

import math

import numpy as np
import pytest

from maps.grid import OccupancyGrid
from protocol.config import SightingConfig
from protocol.messages import Sighting
from protocol.pose import FloatArray
from world.noise import Noise
from world.sightings import Sighters
from world.terrain import Terrain


def room(*walls: tuple[int, int]) -> Terrain:
    """10 × 10 m in cells of 0.5 m, some of them walls (row, column)."""
    cells = np.zeros((20, 20), dtype=np.int8)
    for row, column in walls:
        cells[row, column] = 100
    return Terrain(OccupancyGrid(cells, 0.5, 0.0, 0.0))


def sight(
    terrain: Terrain, poses: FloatArray, tick: int = 0, config: SightingConfig | None = None
) -> list[tuple[Sighting, ...]]:
    names = [f"r{i}" for i in range(len(poses))]
    exact = SightingConfig(sigma_range_m=0.0, sigma_bearing_rad=0.0)
    return Sighters(config or exact, names, 0.2).sight(terrain, poses, tick, Noise(3))


def test_range_and_bearing_are_in_the_robot_s_frame() -> None:
    poses = np.array([[2.0, 2.0, math.pi / 2], [5.0, 6.0, 0.0]])
    (first,), (second,) = sight(room(), poses)
    assert (first.robot, second.robot) == ("r1", "r0")
    assert first.range_m == pytest.approx(5.0)
    assert first.bearing_rad == pytest.approx(math.atan2(4.0, 3.0) - math.pi / 2)
    assert second.bearing_rad == pytest.approx(math.atan2(-4.0, -3.0))
    assert first == Sighting.model_validate(first.model_dump())


def test_a_wall_hides() -> None:
    poses = np.array([[1.0, 5.1, 0.0], [9.0, 5.1, 0.0]])
    assert sight(room((10, 10)), poses) == [(), ()]
    assert [len(seen) for seen in sight(room((11, 10)), poses)] == [1, 1]


def test_a_robot_between_hides() -> None:
    poses = np.array([[1.0, 5.0, 0.0], [9.0, 5.0, 0.0], [4.0, 5.1, 0.0]])
    seen = [[s.robot for s in robot] for robot in sight(room(), poses)]
    assert seen == [["r2"], ["r2"], ["r0", "r1"]]
    poses[2, 1] = 5.3
    seen = [[s.robot for s in robot] for robot in sight(room(), poses)]
    assert seen == [["r1", "r2"], ["r0", "r2"], ["r0", "r1"]]


def test_out_of_range_is_out_of_sight() -> None:
    poses = np.array([[1.0, 5.0, 0.0], [5.0, 5.0, 0.0]])
    near = SightingConfig(max_range_m=3.9)
    assert sight(room(), poses, config=near) == [(), ()]


def test_noise_is_as_told() -> None:
    config = SightingConfig(sigma_range_m=0.05, sigma_bearing_rad=0.02)
    poses = np.array([[2.0, 5.0, 0.0], [8.0, 5.0, 0.0]])
    seen = [sight(room(), poses, tick, config)[0][0] for tick in range(1000)]
    ranges = np.array([s.range_m for s in seen])
    bearings = np.array([s.bearing_rad for s in seen])
    assert ranges.std() == pytest.approx(0.05, rel=0.1)
    assert bearings.std() == pytest.approx(0.02, rel=0.1)
    assert abs(ranges.mean() - 6.0) < 5.0 * 0.05 / math.sqrt(1000.0)
    assert abs(bearings.mean()) < 5.0 * 0.02 / math.sqrt(1000.0)


def test_whom_else_one_sees_does_not_shift_the_noise() -> None:
    config = SightingConfig()
    poses = np.array([[2.0, 5.0, 0.0], [4.0, 8.0, 0.0], [8.0, 5.0, 0.0]])
    _, last = sight(room(), poses, config=config)[0]
    (alone,) = sight(room((14, 7), (14, 8), (15, 7), (16, 8)), poses, config=config)[0]
    assert alone == last


def test_a_crowd_sees_what_each_pair_alone_would_but_for_those_between() -> None:
    rng = np.random.default_rng(2)
    rows, columns = np.divmod(np.arange(60), 8)
    places = 1.2 * np.column_stack([columns, rows]) + rng.uniform(0.3, 1.0, (60, 2))
    poses = np.column_stack([places, np.zeros(60)])
    terrain, near = room((10, 10), (4, 12)), SightingConfig(max_range_m=4.0)
    seen = sight(terrain, poses, config=near)
    for i, k in np.argwhere(~np.eye(60, dtype=bool)).tolist():
        ahead = poses[k, :2] - poses[i, :2]
        distance = float(np.hypot(*ahead))
        along = np.clip((poses[:, :2] - poses[i, :2]) @ ahead / distance, 0.0, distance)
        feet = poses[i, :2] + along[:, None] * ahead / distance
        aside = np.delete(np.hypot(*(poses[:, :2] - feet).T), [i, k])
        pair = sight(terrain, poses[[i, k]], config=near)[0]
        expected = bool(pair) and bool((aside >= 0.2).all())
        assert (f"r{k}" in {s.robot for s in seen[i]}) == expected
