"""Range finders: eq. 14 of the paper, other robots in the scan, and what the ends mean."""

import math

import numpy as np
import pytest

from maps.grid import OccupancyGrid
from protocol.config import LidarConfig
from protocol.pose import FloatArray
from world.lidar import SPREAD, Lidars
from world.noise import Noise
from world.terrain import Terrain

# 40 × 40 m: nothing but the outer walls.
FIELD = Terrain(OccupancyGrid(np.zeros((400, 400), dtype=np.int8), 0.1, -20.0, -20.0))
ROBOTS = 200


def scans(config: LidarConfig, poses: FloatArray, tick: int = 0, seed: int = 0) -> FloatArray:
    names = [f"r{i}" for i in range(len(poses))]
    ranges = Lidars(config, names, 0.2).scan(FIELD, poses, tick, Noise(seed))
    assert ranges.dtype == np.dtype("<f4")
    assert not ranges.flags.writeable
    return ranges.astype(np.float64)


def one_by_one(config: LidarConfig, pose: FloatArray) -> FloatArray:
    """Many scans from one pose, each with a noise of its own and nobody in the way."""
    return np.concatenate([scans(config, pose[None, :], tick) for tick in range(ROBOTS)])


@pytest.mark.parametrize("level", ["modern", "paper", "none"])
@pytest.mark.parametrize("range_m", [0.0, 0.3, 4.0, 12.0])
def test_the_levels_are_those_of_the_configuration(level: str, range_m: float) -> None:
    config = LidarConfig.model_validate({"noise": level})
    a, b, c = SPREAD[level]
    assert a + b * range_m + math.sqrt(c * range_m) == pytest.approx(config.sigma_range_m(range_m))


def test_without_noise_the_scan_is_the_geometry() -> None:
    config = LidarConfig(noise="none", beams=4, max_range_m=30.0)
    ranges = scans(config, np.array([[10.0, 0.0, 0.0]]))
    assert ranges[0] == pytest.approx([30.0, 20.0, 10.0, 20.0])


def test_beams_count_from_the_heading_to_the_left() -> None:
    config = LidarConfig(noise="none", beams=4, max_range_m=30.0)
    ranges = scans(config, np.array([[10.0, 0.0, math.pi / 2]]))
    assert ranges[0] == pytest.approx([20.0, 10.0, 20.0, 30.0])


@pytest.mark.parametrize("level", ["modern", "paper"])
def test_ranges_spread_as_told(level: str) -> None:
    # Beams square to a wall: an angle off by δ lengthens them by 1 / cos δ, here next to nothing.
    config = LidarConfig.model_validate(
        {"noise": level, "beams": 41, "field_of_view_rad": 0.04, "angle_min_rad": -0.02}
    )
    errors = one_by_one(config, np.array([12.0, 0.0, 0.0])) - 8.0
    sigma = config.sigma_range_m(8.0)
    lengthened = 8.0 * 0.5 * (config.sigma_angle_rad**2 + 0.02**2 / 3.0)
    assert abs(errors.mean() - lengthened) < 5.0 * sigma / math.sqrt(errors.size)
    assert errors.std() == pytest.approx(sigma, rel=0.05)


def test_beams_really_point_off_their_nominal_angle() -> None:
    # Along a wall at grazing angle the range is distance / sin(angle): its slope shows σ_θ.
    config = LidarConfig(
        noise="paper", beams=3, field_of_view_rad=0.2, angle_min_rad=0.5, max_range_m=60.0
    )
    ranges = one_by_one(config, np.array([-19.0, 10.0, 0.0]))[:, 1]
    true = 10.0 / math.sin(0.6)
    slope = true / math.tan(0.6)
    expected = math.hypot(config.sigma_range_m(true), slope * config.sigma_angle_rad)
    assert ranges.std() == pytest.approx(expected, rel=4.0 / math.sqrt(2.0 * ROBOTS))


def test_other_robots_are_in_the_scan() -> None:
    config = LidarConfig(noise="none", beams=4)
    ranges = scans(config, np.array([[0.0, 0.0, 0.0], [3.0, 0.1, 0.0]]))
    assert ranges[0, 2] == pytest.approx(3.0 - math.sqrt(0.2**2 - 0.1**2))
    assert np.isinf(ranges[0, [0, 1, 3]]).all()
    assert ranges[1, 0] == pytest.approx(3.0 - math.sqrt(0.2**2 - 0.1**2))


def test_a_robot_hides_what_is_behind_it_and_not_what_is_before() -> None:
    config = LidarConfig(noise="none", beams=4, max_range_m=30.0)
    poses = np.array([[19.0, 0.0, 0.0], [10.0, 0.0, 0.0], [5.0, 0.0, 0.0]])
    ranges = scans(config, poses)
    assert ranges[0, 2] == pytest.approx(1.0)
    assert ranges[0, 0] == pytest.approx(8.8)


def test_beyond_range_is_infinite_and_below_it_zero() -> None:
    config = LidarConfig(noise="none", beams=4, min_range_m=0.5, max_range_m=12.0)
    ranges = scans(config, np.array([[19.7, 0.0, 0.0]]))
    assert ranges[0].tolist() == [math.inf, math.inf, 0.0, math.inf]


def test_nothing_noisy_leaves_the_range() -> None:
    config = LidarConfig(noise="paper", beams=257, max_range_m=8.0)
    ranges = one_by_one(config, np.array([12.5, 0.0, 0.0]))
    finite = ranges[np.isfinite(ranges)]
    assert finite.min() >= config.min_range_m
    assert finite.max() <= config.max_range_m
    assert not np.isnan(ranges).any()


def test_scans_come_when_they_are_due() -> None:
    lidars = Lidars(LidarConfig(every_ticks=3), ["r1"], 0.2)
    assert [lidars.due(tick) for tick in range(7)] == [True, False, False] * 2 + [True]


def test_a_robot_far_off_changes_nobody_s_noise() -> None:
    config = LidarConfig()
    poses = np.array([[15.0, 15.0, 0.3], [-15.0, -15.0, 0.0]])
    both = Lidars(config, ["a", "b"], 0.2).scan(FIELD, poses, 5, Noise(9))
    alone = Lidars(config, ["a"], 0.2).scan(FIELD, poses[:1], 5, Noise(9))
    assert np.array_equal(both[0], alone[0])
