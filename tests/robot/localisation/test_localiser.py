"""Localisation in a known map: as exact as mapping, from anywhere, and again when it was lost."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from maps.library import load_map
from protocol.config import BodyConfig
from protocol.pose import Pose2
from robot.jobs import Jobs
from robot.localisation.known_map import KnownMap
from robot.localisation.localiser import Localiser
from robot.slam.engine import Keyframe
from robot.slam.graph import GraphSlam
from robot.slam.saved_map import SavedMap
from world.terrain import Terrain


@pytest.fixture(scope="module")
def way(drive_in: Callable[..., Any]) -> Any:
    grid = load_map("rooms-small")
    free = grid.to_points(*np.nonzero(grid.free))
    middle = free[np.argmin(np.hypot(*(free - free.mean(axis=0)).T))]
    return drive_in(grid, Pose2(float(middle[0]), float(middle[1]), 0.4), 300)


@pytest.fixture(scope="module")
def known(way: Any) -> KnownMap:
    """What a robot mapped on its way, saved and loaded."""
    engine = GraphSlam(way.lidar, BodyConfig(), Pose2.from_array(way.truth[0]), Jobs())
    for tick, (motion, scan) in enumerate(zip(way.motions, way.scans, strict=True)):
        engine.step(tick, motion, scan)
    saved = SavedMap.decode(SavedMap.of(engine).encode())
    return KnownMap.of_submaps(saved.submaps, saved.graph.nodes)


def follow(localiser: Localiser, way: Any, first: int = 0) -> Localiser:
    for tick in range(first, len(way.scans)):
        localiser.step(tick, way.motions[tick], way.scans[tick])
    return localiser


def test_a_robot_is_followed_in_a_saved_map(known: KnownMap, way: Any) -> None:
    localiser = follow(Localiser(known, way.lidar, Pose2.from_array(way.truth[0])), way)
    errors = np.hypot(*(localiser.trajectory() - way.truth)[:, :2].T)
    assert localiser.losses == 0
    assert np.sqrt(np.mean(errors**2)) < 0.03
    assert localiser.mapped() == ()
    assert len(localiser.graph().nodes) == 1
    kept = [entry for entry in localiser.take_entries() if isinstance(entry, Keyframe)]
    assert len(kept) > 10


def test_from_an_unknown_start_the_way_is_told_to_its_beginning(known: KnownMap, way: Any) -> None:
    localiser = Localiser(known, way.lidar, None)
    follow(localiser, way, first=100)
    assert localiser.settled
    errors = np.hypot(*(localiser.trajectory() - way.truth[100:])[:, :2].T)
    assert len(errors) == 200
    assert errors.max() < 0.15


def test_a_robot_that_was_carried_away_is_found_again(
    way: Any, drive_in: Callable[..., Any]
) -> None:
    grid = load_map("rooms-small")
    rows, columns = np.nonzero(Terrain(grid).room_for(0.5))
    roomy = grid.to_points(rows, columns)
    far = roomy[np.argmax(np.hypot(*(roomy - way.truth[20, :2]).T))]
    elsewhere = drive_in(grid, Pose2(float(far[0]), float(far[1]), 1.0), 200)
    localiser = Localiser(KnownMap.of_grid(grid), way.lidar, Pose2.from_array(way.truth[0]))
    for tick in range(20):
        localiser.step(tick, way.motions[tick], way.scans[tick])
    follow(localiser, elsewhere)
    assert localiser.losses >= 1
    assert localiser.settled
    assert np.hypot(*(localiser.trajectory()[-1] - elsewhere.truth[-1])[:2]) < 0.1
