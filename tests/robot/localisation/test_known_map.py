"""Known maps: walls and free ground are where the grid, or the submaps, have them."""

import math

import numpy as np
import pytest

from maps.grid import OccupancyGrid
from maps.library import load_map
from protocol.config import LidarConfig
from protocol.pose import Pose2
from robot.localisation.known_map import KnownMap, KnownMapError
from robot.perception.field import RESOLUTION_M, CorrelationField
from robot.perception.matching import match_returns
from robot.perception.returns import describe_returns, noise_model
from robot.perception.scan import LaserScan, beam_angles
from robot.slam.packed_submap import PackedSubmap
from robot.slam.submap import Submap
from world.terrain import Terrain

LIDAR = LidarConfig()


def box(resolution: float) -> OccupancyGrid:
    """A room of 4 × 3 m whose walls are 0.2 m thick, in unknown ground."""
    cells = np.full((round(5.0 / resolution), round(6.0 / resolution)), -1, dtype=np.int8)
    one, wall = round(1.0 / resolution), round(0.2 / resolution)
    cells[one - wall : -one + wall, one - wall : -one + wall] = 100
    cells[one:-one, one:-one] = 0
    return OccupancyGrid(cells, resolution, -3.0, -2.5)


@pytest.mark.parametrize("resolution", [0.05, 0.1])
def test_the_ridge_runs_along_the_surface(resolution: float) -> None:
    field = KnownMap.of_grid(box(resolution)).field
    row = round((0.0 - field.origin[1]) / RESOLUTION_M)
    x = field.origin[0] + RESOLUTION_M * np.arange(field.nodes.shape[1])
    heights = field.nodes[row].astype(float)
    for surface in (-2.0, 2.0):
        near = np.abs(x - surface) < 0.1
        middle = float((x[near] * heights[near]).sum() / heights[near].sum())
        assert middle == pytest.approx(surface, abs=1e-3)
    # Behind the wall nobody has been, and in the room it is free.
    assert heights[np.abs(x) > 2.15].max() == 0
    assert field.free[round(2.5 / 0.1), round(3.0 / 0.1)] == 1
    assert field.free[round(2.5 / 0.1), round(0.5 / 0.1)] == 0


def test_unknown_ground_is_a_wall_only_where_the_world_has_it_so() -> None:
    grid = box(0.05)
    cells = np.where(grid.cells == 100, -1, grid.cells)
    cells[20:24, 20:60] = 100  # one piece of wall that is known
    unknown = OccupancyGrid(cells, 0.05, -3.0, -2.5)
    told = KnownMap.of_grid(unknown, unknown_is_solid=True)
    assert (told.field.nodes > 200).sum() > 2 * (KnownMap.of_grid(unknown).field.nodes > 200).sum()


def test_a_scan_matches_where_it_was_taken() -> None:
    grid = load_map("rooms-small")
    known, terrain = KnownMap.of_grid(grid), Terrain(grid)
    rows, columns = np.nonzero(terrain.room_for(0.4))
    rng, errors = np.random.default_rng(1), []
    for index in rng.choice(len(rows), 10):
        x, y = grid.to_points(rows[index : index + 1], columns[index : index + 1])[0]
        pose = Pose2(float(x), float(y), float(rng.uniform(-math.pi, math.pi)))
        ranges = terrain.cast(pose.x, pose.y, pose.theta + beam_angles(LIDAR), LIDAR.max_range_m)
        returns = describe_returns(
            LaserScan(ranges, beam_angles(LIDAR), LIDAR.max_range_m), noise_model(LIDAR), 12.0
        )
        guess = pose @ Pose2(0.03, -0.03, 0.01)
        found = match_returns(known.field, returns, guess).T_field_base
        errors.append(found.distance_to(pose))
        assert known.field.overlay(pose, returns).hits > 0.98
    assert np.median(errors) < 0.01
    assert max(errors) < 0.02


def test_submaps_are_drawn_where_their_anchors_lie() -> None:
    submap = Submap.start(0, 8.0)
    angles = beam_angles(LIDAR)
    c, s = np.cos(angles), np.sin(angles)
    with np.errstate(divide="ignore"):
        ranges = np.minimum(np.where(c > 0, 2.0, -2.0) / c, np.where(s > 0, 1.5, -1.5) / s)
    scan = LaserScan(ranges, angles, LIDAR.max_range_m)
    returns = describe_returns(scan, noise_model(LIDAR), 12.0)
    submap.insert(Pose2(0.0, 0.0, 0.0), returns)
    submap.finish()
    for anchor in (Pose2(0.0, 0.0, 0.0), Pose2(30.0, -4.0, 0.7)):
        anchors = np.array([anchor.to_array()])
        known = KnownMap.of_submaps([PackedSubmap.of(submap)], anchors)
        found = match_returns(known.field, returns, anchor @ Pose2(0.05, 0.05, 0.02))
        assert found.T_field_base.distance_to(anchor) < 2e-3
        overlay = known.field.overlay(anchor, returns)
        assert overlay.overlap > 0.99
        assert overlay.hits > 0.99
        assert overlay.crossing == 0.0


def test_a_map_in_which_nothing_can_be_found_is_refused() -> None:
    with pytest.raises(KnownMapError, match="no submaps"):
        KnownMap.of_submaps([], np.zeros((0, 3)))
    for value in (-1, 0, 100):
        cells = np.full((40, 40), value, dtype=np.int8)
        with pytest.raises(KnownMapError, match="no walls"):
            KnownMap.of_grid(OccupancyGrid(cells, 0.05, 0.0, 0.0))
    with pytest.raises(KnownMapError, match="too large"):
        KnownMap.of_grid(OccupancyGrid(np.zeros((3000, 3000), dtype=np.int8), 1.0, 0.0, 0.0))
    empty = CorrelationField(np.zeros((8, 8), np.uint8), np.zeros((2, 2), np.uint8), np.zeros(2))
    with pytest.raises(KnownMapError, match="no walls"):
        KnownMap.of_field(empty)
