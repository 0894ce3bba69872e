"""The occupancy map: exactly reversible, independent of order, and right about walls."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from maps.grid import OccupancyGrid
from maps.library import load_map
from protocol.config import LidarConfig
from protocol.pose import FloatArray, Pose2
from protocol.state import dump_state, load_state
from robot.mapping.occupancy import CHUNK, MappingError, OccupancyMap
from robot.perception.scan import LaserScan, beam_angles
from world.terrain import Terrain

LIDAR = LidarConfig()
ANGLES = beam_angles(LIDAR)


def _scan(seed: int) -> FloatArray:
    """Ranges of all kinds: hits near and far, nothing met, invalid."""
    rng = np.random.default_rng(seed)
    ranges = rng.uniform(0.1, 12.0, LIDAR.beams)
    ranges[rng.random(LIDAR.beams) < 0.1] = np.inf
    ranges[rng.random(LIDAR.beams) < 0.1] = np.nan
    return ranges


def _pose(seed: int) -> Pose2:
    rng = np.random.default_rng(1000 + seed)
    return Pose2.from_array(rng.uniform([-15.0, -15.0, -math.pi], [15.0, 15.0, math.pi]).tolist())


def _laser(ranges: FloatArray, angles: FloatArray = ANGLES, max_range: float = 12.0) -> LaserScan:
    return LaserScan(ranges, angles, max_range)


def _put(mapped: OccupancyMap, seed: int, pose: Pose2 | None = None) -> None:
    mapped.add(_pose(seed) if pose is None else pose, _laser(_scan(seed)))


def _same(a: OccupancyGrid, b: OccupancyGrid) -> bool:
    return (
        np.array_equal(a.cells, b.cells)
        and (a.resolution, a.origin_x, a.origin_y) == (b.resolution, b.origin_x, b.origin_y)
    )  # fmt: skip


@settings(max_examples=20, deadline=None)
@given(st.permutations(range(5)))
def test_the_map_does_not_depend_on_the_order(order: list[int]) -> None:
    straight, shuffled = OccupancyMap(lidar=LIDAR), OccupancyMap(lidar=LIDAR)
    for seed in range(5):
        _put(straight, seed)
    for seed in order:
        _put(shuffled, seed)
    assert _same(straight.grid(), shuffled.grid())


@settings(max_examples=20, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 30)), max_size=12))
def test_moving_and_removing_leave_nothing_behind(moves: list[tuple[int, int]]) -> None:
    moved, fresh = OccupancyMap(lidar=LIDAR), OccupancyMap(lidar=LIDAR)
    poses = {seed: _pose(seed) for seed in range(4)}
    for seed in poses:
        _put(moved, seed)
    for seed, where in moves:
        moved.remove(poses[seed], _laser(_scan(seed)))
        poses[seed] = _pose(where)
        _put(moved, seed, poses[seed])
    moved.remove(poses.pop(3), _laser(_scan(3)))
    for seed, pose in poses.items():
        _put(fresh, seed, pose)
    assert _same(moved.grid(), fresh.grid())
    for seed, pose in poses.items():
        moved.remove(pose, _laser(_scan(seed)))
    assert moved.grid().cells.size == 0
    assert moved.known_area() == 0.0


def test_the_grid_is_cropped_to_chunks() -> None:
    mapped = OccupancyMap(lidar=LIDAR)
    _put(mapped, 0, Pose2(3.0, -40.0, 0.0))
    grid = mapped.grid()
    height, width = grid.cells.shape
    assert height % CHUNK == width % CHUNK == 0
    assert math.remainder(grid.origin_x, CHUNK * 0.05) == pytest.approx(0.0, abs=1e-9)
    for edge in (grid.cells[:CHUNK], grid.cells[-CHUNK:], grid.cells[:, :CHUNK]):
        assert (edge >= 0).any()


def test_the_live_scan_leaves_the_map_as_it_was() -> None:
    mapped = OccupancyMap(lidar=LIDAR)
    _put(mapped, 0)
    before = mapped.grid().cells.copy()
    overlaid = mapped.live(_pose(1), _laser(_scan(1)))
    assert np.array_equal(mapped.grid().cells, before)
    _put(mapped, 1)
    assert _same(overlaid, mapped.grid())


def test_what_beams_say() -> None:
    angles = np.array([0.0, 0.5 * math.pi, math.pi])
    mapped = OccupancyMap(lidar=LidarConfig(noise="none"))
    scan = _laser(np.array([2.0, np.inf, np.nan]), angles, 5.0)
    mapped.add(Pose2(0.0, 0.0, 0.0), scan)
    grid = mapped.grid()
    points = np.array([[2.025, 0.0], [1.0, 0.0], [2.2, 0.0], [0.0, 4.9], [0.0, 5.2], [-1.0, 0.0]])
    rows, columns = grid.to_cells(points)
    assert grid.cells[rows, columns].tolist() == [100, 0, -1, 0, -1, -1]


def test_a_stray_hit_is_erased_and_a_wall_is_not() -> None:
    angles = np.zeros(1)
    mapped = OccupancyMap(lidar=LidarConfig(noise="none"))
    for r in [2.0] + [4.0] * 9 + [6.0] * 3:
        mapped.add(Pose2(0.0, 0.0, 0.0), _laser(np.array([r]), angles, 8.0))
    rows, columns = mapped.grid().to_cells(np.array([[2.025, 0.0], [4.025, 0.0]]))
    stray, wall = mapped.grid().cells[rows, columns]
    assert stray < 50 <= wall


def test_a_corridor_seen_at_a_grazing_angle_keeps_its_walls() -> None:
    """Down a corridor far walls are met by few beams and brushed by many."""
    cells = np.zeros((44, 400), dtype=np.int8)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = 100, 100, 100, 100
    truth = OccupancyGrid(cells, 0.05, 0.0, 0.0)
    terrain, mapped = Terrain(truth), OccupancyMap(lidar=LIDAR)
    rng = np.random.default_rng(5)
    for k in range(60):
        # The map's cells do not lie as the true ones do: nor would they after SLAM.
        pose = Pose2(1.0 + 0.02 * k, 1.1, 0.0)
        ranges = _noisy(terrain, pose, rng)
        mapped.add(Pose2(pose.x + 0.021, pose.y + 0.013, 0.013), _laser(ranges))
    grid = mapped.grid()
    xs = np.arange(0.5, 9.0, 0.05)
    T_map_world = Pose2(0.021, 0.013, 0.013) @ Pose2(0.0, 0.0, 0.0)
    missing = 0
    for x in xs:
        side = T_map_world.apply(np.array([[x, 0.1 + d] for d in (-0.1, -0.05, 0.0, 0.05)]))
        missing += not (grid.cells[grid.to_cells(side)] >= 50).any()
    assert missing <= 0.03 * len(xs)


def _noisy(terrain: Terrain, pose: Pose2, rng: np.random.Generator) -> FloatArray:
    angles = ANGLES + rng.normal(0.0, LIDAR.sigma_angle_rad, LIDAR.beams)
    ranges = terrain.cast(pose.x, pose.y, pose.theta + angles, LIDAR.max_range_m)
    sigma = 0.01 + 0.005 * np.where(np.isfinite(ranges), ranges, 0.0)
    return np.asarray(ranges + rng.normal(0.0, 1.0, LIDAR.beams) * sigma, dtype=np.float64)


def test_walls_of_a_building_are_found_where_they_are() -> None:
    """Recall and precision with one cell of tolerance, from perfect poses."""
    truth = load_map("rooms-small")
    terrain, mapped = Terrain(truth), OccupancyMap(lidar=LIDAR)
    rng = np.random.default_rng(7)
    rows, columns = np.nonzero(terrain.room_for(0.3))
    for index in rng.choice(len(rows), 150):
        x, y = truth.to_points(rows[index : index + 1], columns[index : index + 1])[0]
        pose = Pose2(float(x), float(y), float(rng.uniform(-math.pi, math.pi)))
        mapped.add(pose, _laser(_noisy(terrain, pose, rng)))
    grid = mapped.grid()
    inside = np.pad(truth.free, 1)[1:-1, 1:-1]
    near_free = np.zeros_like(inside)
    near_free[1:-1, 1:-1] = (
        inside[:-2, 1:-1] | inside[2:, 1:-1] | inside[1:-1, :-2] | inside[1:-1, 2:]
    )
    walls = truth.to_points(*np.nonzero(truth.occupied & near_free))
    seen = grid.to_points(*np.nonzero(grid.occupied))
    assert _share_near(walls, grid, grid.occupied) >= 0.97
    assert _share_near(seen, truth, truth.occupied) >= 0.97


def _share_near(points: FloatArray, grid: OccupancyGrid, mask: np.ndarray) -> float:
    """Share of points that lie in, or next to, a cell of the mask."""
    rows, columns = grid.to_cells(points)
    padded = np.pad(mask, 2)
    near = np.zeros(len(points), dtype=bool)
    for dr in (-1, 0, 1):
        for dc in (-1, 0, 1):
            r = np.clip(rows + dr + 2, 0, padded.shape[0] - 1)
            c = np.clip(columns + dc + 2, 0, padded.shape[1] - 1)
            near |= padded[r, c]
    return float(near.mean())


def test_noise_as_in_the_paper_leaves_a_usable_map() -> None:
    lidar = LidarConfig(noise="paper")
    cells = np.zeros((120, 120), dtype=np.int8)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = 100, 100, 100, 100
    terrain = Terrain(OccupancyGrid(cells, 0.05, 0.0, 0.0))
    mapped, rng = OccupancyMap(lidar=lidar), np.random.default_rng(3)
    for _ in range(80):
        pose = Pose2(float(rng.uniform(1.0, 5.0)), float(rng.uniform(1.0, 5.0)), 0.0)
        angles = ANGLES + rng.normal(0.0, lidar.sigma_angle_rad, lidar.beams)
        ranges = terrain.cast(pose.x, pose.y, angles, 12.0)
        ranges += rng.normal(0.0, 1.0, lidar.beams) * np.sqrt(0.01 * ranges)
        mapped.add(pose, _laser(ranges))
    grid = mapped.grid()
    centre = grid.to_cells(np.array([[x, y] for x in (1.0, 3.0, 5.0) for y in (1.0, 3.0, 5.0)]))
    assert (grid.cells[centre] < 50).all()
    for x in np.arange(0.5, 5.5, 0.1):
        across = grid.to_cells(np.array([[x, y] for y in np.arange(-0.4, 0.5, 0.05)]))
        assert (grid.cells[across] >= 50).any()


@pytest.mark.parametrize(
    ("pose", "ranges", "angles", "max_range", "word"),
    [
        (Pose2(math.nan, 0.0, 0.0), np.ones(3), np.zeros(3), 5.0, "finite"),
        (Pose2(0.0, 0.0, 0.0), np.ones(3), np.zeros(4), 5.0, "one length"),
        (Pose2(0.0, 0.0, 0.0), np.ones((3, 1)), np.zeros((3, 1)), 5.0, "one length"),
        (Pose2(0.0, 0.0, 0.0), np.ones(3), np.zeros(3), math.inf, "maximum range"),
    ],
)
def test_what_cannot_be_mapped_is_refused(
    pose: Pose2, ranges: FloatArray, angles: FloatArray, max_range: float, word: str
) -> None:
    mapped = OccupancyMap()
    with pytest.raises(MappingError, match=word):
        mapped.add(pose, _laser(ranges, angles, max_range))
    assert mapped.grid().cells.size == 0


def test_a_pose_far_away_does_not_fill_the_memory() -> None:
    mapped = OccupancyMap()
    _put(mapped, 0, Pose2(0.0, 0.0, 0.0))
    with pytest.raises(MappingError, match="check its pose"):
        _put(mapped, 1, Pose2(1e7, 1e7, 0.0))
    mapped.remove(Pose2(0.0, 0.0, 0.0), _laser(_scan(0)))
    assert mapped.grid().cells.size == 0


@pytest.mark.parametrize("value", [-5.0, 0.0, -np.inf, 1e30])
def test_hostile_ranges_do_no_harm(value: float) -> None:
    mapped = OccupancyMap()
    ranges = np.full(LIDAR.beams, value)
    mapped.add(Pose2(0.0, 0.0, 0.0), _laser(ranges))
    assert not mapped.grid().occupied.any()


def test_a_checkpoint_carries_on() -> None:
    mapped = OccupancyMap(lidar=LIDAR)
    for seed in range(3):
        _put(mapped, seed)
    restored = load_state(dump_state(mapped), OccupancyMap)
    for each in (mapped, restored):
        _put(each, 9)
        each.remove(_pose(0), _laser(_scan(0)))
    assert _same(mapped.grid(), restored.grid())
