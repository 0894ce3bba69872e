"""Global localisation: all places are found, the right one is settled on, twins are not."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from maps.grid import OccupancyGrid
from maps.library import load_map
from protocol.pose import FloatArray, Pose2, wrap_angle
from protocol.state import dump_state, load_state
from robot.localisation.everywhere import SEARCH_POINTS, find_everywhere
from robot.localisation.hypotheses import GlobalLocaliser
from robot.localisation.known_map import KnownMap
from robot.perception.field import SIGMA_M
from robot.perception.returns import Returns, describe_returns, noise_model


@pytest.fixture(scope="module")
def rooms() -> OccupancyGrid:
    return load_map("rooms-small")


@pytest.fixture(scope="module")
def known(rooms: OccupancyGrid) -> KnownMap:
    return KnownMap.of_grid(rooms)


@pytest.fixture(scope="module")
def way(rooms: OccupancyGrid, drive_in: Callable[..., Any]) -> Any:
    free = rooms.to_points(*np.nonzero(rooms.free))
    middle = free[np.argmin(np.hypot(*(free - free.mean(axis=0)).T))]
    return drive_in(rooms, Pose2(float(middle[0]), float(middle[1]), 0.4), 150)


def is_at(pose: Pose2, truth: FloatArray) -> bool:
    true = Pose2.from_array(truth)
    turned = abs(wrap_angle(pose.theta - true.theta))
    return pose.distance_to(true) < 0.2 and turned < math.radians(4.0)


def coarse_score(known: KnownMap, few: Returns, pose: Pose2) -> float:
    """What the search ought to give a pose, from the field's maxima over cells of 10 cm."""
    maxima, origin = known.pyramid.levels[0], known.field.origin
    cells = np.floor(np.floor((pose.apply(few.points) - origin) / 0.025 + 0.5) / 4).astype(int)
    inside = (cells >= 0).all(axis=1) & (cells < maxima.shape[::-1]).all(axis=1)
    sigma2 = few.values[:, 5] ** 2
    full = 255.0 * (SIGMA_M / np.sqrt(SIGMA_M**2 + 2.0 * sigma2)).sum()
    return float(maxima[cells[inside, 1], cells[inside, 0]].sum() / full)


def test_the_search_finds_the_best_place_of_all(known: KnownMap, way: Any) -> None:
    rng = np.random.default_rng(0)
    for k in (0, 70, 149):
        returns = describe_returns(way.scans[k], noise_model(way.lidar), 12.0)
        places = find_everywhere(known, returns, 0.3, 0.7, 100)
        assert places.complete
        scores = [place.score for place in places.peaks]
        assert scores == sorted(scores, reverse=True)
        assert is_at(places.peaks[0].pose, way.truth[k])
        few = returns.thinned(SEARCH_POINTS)
        for place in places.peaks[:5]:
            assert place.score == pytest.approx(coarse_score(known, few, place.pose), abs=0.05)
        # No pose that chance finds on open ground beats it; cells may differ by their rounding.
        rows, columns = np.nonzero(known.open_cells[0])
        for at in rng.choice(len(rows), 300):
            x, y = known.field.origin + 0.1 * np.array([columns[at], rows[at]]) + 0.0375
            pose = Pose2(float(x), float(y), float(rng.uniform(-math.pi, math.pi)))
            assert coarse_score(known, few, pose) <= places.peaks[0].score + 0.05


def test_the_place_is_known_after_a_short_way(known: KnownMap, way: Any) -> None:
    for first in (0, 50):
        localiser = GlobalLocaliser(known, way.lidar)
        for k in range(first, first + 90):
            localiser.step(way.motions[k], way.scans[k])
            if localiser.settled is not None:
                break
        assert localiser.settled is not None
        assert is_at(localiser.settled.pose, way.truth[k])


def test_a_checkpoint_carries_on(known: KnownMap, way: Any) -> None:
    localiser = GlobalLocaliser(known, way.lidar)
    for k in range(12):
        localiser.step(way.motions[k], way.scans[k])
    copy = load_state(dump_state(localiser), GlobalLocaliser)
    for k in range(12, 40):
        for one in (localiser, copy):
            one.step(way.motions[k], way.scans[k])
    assert dump_state(copy.hypotheses) == dump_state(localiser.hypotheses)


def test_twins_stay_undecided(drive_in: Callable[..., Any]) -> None:
    """A bare room looks the same from the other end."""
    cells = np.full((140, 200), 100, dtype=np.int8)
    cells[10:-10, 10:-10] = 0
    grid = OccupancyGrid(cells, 0.05, 0.0, 0.0)
    way = drive_in(grid, Pose2(3.0, 2.5, 0.7), 150)
    localiser = GlobalLocaliser(KnownMap.of_grid(grid), way.lidar)
    for motion, scan in zip(way.motions, way.scans, strict=True):
        localiser.step(motion, scan)
        assert localiser.settled is None
    poses = [hypothesis.pose for hypothesis in localiser.hypotheses]
    assert len(poses) == 2
    assert any(is_at(pose, way.truth[-1]) for pose in poses)


def test_elsewhere_than_in_the_map_nothing_is_settled(
    known: KnownMap, drive_in: Callable[..., Any]
) -> None:
    cells = np.zeros((300, 300), dtype=np.int8)
    rng = np.random.default_rng(3)
    for row, column in rng.integers(0, 290, (60, 2)):
        cells[row : row + 8, column : column + 8] = 100
    cells[140:160, 140:160] = 0
    grid = OccupancyGrid(cells, 0.05, 0.0, 0.0)
    way = drive_in(grid, Pose2(7.5, 7.5, 0.0), 120)
    localiser = GlobalLocaliser(known, way.lidar)
    for motion, scan in zip(way.motions, way.scans, strict=True):
        localiser.step(motion, scan)
        assert localiser.settled is None
