"""Planning: distances are exact, costs are least, paths have room for the body."""

import heapq
import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from maps.grid import OccupancyGrid
from protocol.config import BodyConfig
from protocol.pose import FloatArray, Pose2
from robot.explore.frontier_kernels import components
from robot.explore.planner import clearance_at, path_to, replan, resample, survey, travel_field
from robot.explore.planner_kernels import block_clearance, coarsen, travel_costs
from robot.explore.retreat import find_retreat

BODY = BodyConfig()


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 40), st.integers(1, 40), st.integers(0, 10**6), st.floats(0.01, 0.6))
def test_clearance_is_the_exact_distance(rows: int, columns: int, seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    cells = np.where(rng.random((rows, columns)) < share, 100, 0).astype(np.int8)
    cells[rng.random(cells.shape) < 0.05] = -1
    state = np.empty_like(cells)
    coarsen(cells, 1, state)
    clearance, centres = block_clearance(cells, 1, state, 0.05)
    free = np.pad(cells == 0, 1)
    expected = ndimage.distance_transform_edt(free)[1:-1, 1:-1] * 0.05
    np.testing.assert_allclose(clearance, expected, atol=1e-12)
    np.testing.assert_allclose(centres[..., 0] - np.arange(rows)[:, None], 0.5)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([0.18, 0.23]))
def test_travel_costs_are_those_of_a_plain_dijkstra(seed: int, tight: float) -> None:
    rng = np.random.default_rng(seed)
    shape = (17, 23)
    state = np.where(rng.random(shape) < 0.2, 1, 0).astype(np.int8)
    clearance = rng.uniform(0.0, 0.9, shape)
    extra = np.where(rng.random(shape) < 0.1, 7.0, 0.0)
    start = (8, 11)
    cost, parent = travel_costs(
        state, clearance, extra, tight, 0.23, 0.6, 4.0, 0.1, start[0] * shape[1] + start[1]
    )
    expected = _dijkstra(state, clearance, extra, tight, start)
    np.testing.assert_allclose(cost, expected, rtol=1e-12)
    reached = np.isfinite(cost).ravel()
    assert np.all(cost.ravel()[parent[reached & (parent >= 0)]] < np.inf)
    assert np.all(parent[~reached] == -1)


def _dijkstra(
    state: npt.NDArray[np.int8],
    clearance: FloatArray,
    extra: FloatArray,
    tight: float,
    start: tuple[int, int],
) -> FloatArray:
    cost = np.full(state.shape, np.inf)
    cost[start] = 0.0
    queue = [(0.0, start)]
    while queue:
        here_cost, (row, column) = heapq.heappop(queue)
        if here_cost > cost[row, column]:
            continue
        for dr, dc in ((a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if a or b):
            i, j = row + dr, column + dc
            if not (0 <= i < state.shape[0] and 0 <= j < state.shape[1]):
                continue
            closed = clearance[i, j] < 0.23
            squeezed = clearance[row, column] < 0.23 or clearance[i, j] >= tight
            if closed and (not squeezed or state[i, j] != 0):
                continue
            lack = max(0.0, 1.0 - clearance[i, j] / 0.6)
            price = 10.0 if closed else 1.0 + 4.0 * lack**2 + extra[i, j]
            total = here_cost + 0.1 * math.hypot(dr, dc) * price
            if total < cost[i, j]:
                cost[i, j] = total
                heapq.heappush(queue, (total, (i, j)))
    return cost


@pytest.mark.parametrize("diagonal", [False, True])
def test_components_are_those_of_scipy(diagonal: bool) -> None:
    mask = np.random.default_rng(4).random((40, 50)) < 0.5
    labels, sizes = components(mask, diagonal)
    expected, count = ndimage.label(mask, np.ones((3, 3)) if diagonal else None)
    assert len(sizes) == count
    assert np.array_equal(np.bincount(labels[mask], minlength=count), sizes)
    pairs = set(zip(labels[mask].tolist(), expected[mask].tolist(), strict=True))
    assert len(pairs) == count


@pytest.mark.parametrize("door_m", [0.5, 0.6, 0.8, 1.0])
@pytest.mark.parametrize("shift", [0, 1])
def test_a_path_leads_through_the_middle_of_a_door(
    two_rooms: Callable[[float], OccupancyGrid], door_m: float, shift: int
) -> None:
    grid = two_rooms(door_m)
    # Blocks must not decide whether a door is passable: move it by a cell against them.
    grid = OccupancyGrid(np.roll(grid.cells, shift, axis=0), 0.05, 0.0, shift * -0.05)
    path = replan(grid, BODY, Pose2(1.0, 1.0, 0.0), Pose2(6.0, 3.0, 0.0))
    assert np.hypot(*(path[0] - [1.0, 1.0])) < 0.11
    assert np.hypot(*(path[-1] - [6.0, 3.0])) < 0.11
    terrain = survey(grid, BODY)
    assert clearance_at(terrain, path).min() >= terrain.needed
    in_door = path[np.abs(path[:, 0] - 3.45) < 0.1]
    assert np.all(np.abs(in_door[:, 1] - 2.0) <= 0.1)
    assert np.hypot(*np.diff(path, axis=0).T).max() <= 0.11


def test_no_path_leads_through_a_gap_that_is_too_narrow(
    two_rooms: Callable[[float], OccupancyGrid],
) -> None:
    path = replan(two_rooms(0.35), BODY, Pose2(1.0, 1.0, 0.0), Pose2(6.0, 3.0, 0.0))
    assert path.shape == (0, 2)


def test_unknown_is_not_crossed() -> None:
    cells = np.zeros((60, 120), dtype=np.int8)
    cells[:, 50:60] = -1
    grid = OccupancyGrid(cells, 0.05, 0.0, 0.0)
    assert len(replan(grid, BODY, Pose2(1.0, 1.5, 0.0), Pose2(5.0, 1.5, 0.0))) == 0
    slivers = cells.copy()
    slivers[:, 50:60] = 0
    slivers[:, 50:60:4] = -1  # as between the beams of a far scan
    grid = OccupancyGrid(slivers, 0.05, 0.0, 0.0)
    assert len(replan(grid, BODY, Pose2(1.0, 1.5, 0.0), Pose2(5.0, 1.5, 0.0))) > 0


def test_a_robot_too_near_to_a_wall_gets_away_but_nobody_drives_there(
    two_rooms: Callable[[float], OccupancyGrid],
) -> None:
    grid = two_rooms(0.9)
    at_wall, inside = Pose2(0.2, 0.2, 0.0), Pose2(1.5, 1.5, 0.0)
    away = replan(grid, BODY, at_wall, inside)
    assert len(away) > 2
    assert np.hypot(*(away[-1] - [1.5, 1.5])) < 0.11
    assert len(replan(grid, BODY, inside, at_wall)) == 0


def test_a_teammate_in_the_way_is_gone_round_but_does_not_close_the_way(
    two_rooms: Callable[[float], OccupancyGrid],
) -> None:
    grid = two_rooms(0.9)
    start, goal, mate = Pose2(0.6, 2.0, 0.0), Pose2(2.8, 2.0, 0.0), Pose2(1.7, 2.0, 0.0)
    around = replan(grid, BODY, start, goal, (mate,))
    assert np.hypot(*(around - [mate.x, mate.y]).T).min() >= 0.4
    in_door = Pose2(3.45, 2.0, 0.0)
    assert len(replan(grid, BODY, start, Pose2(6.0, 2.0, 0.0), (in_door,))) > 0


def test_nothing_goes_through_a_blocked_spot_but_what_stands_in_it(
    two_rooms: Callable[[float], OccupancyGrid],
) -> None:
    terrain = survey(two_rooms(0.6), BODY)
    here, there = Pose2(1.5, 1.5, 0.0), Pose2(4.5, 1.5, 0.0)
    row, column = terrain.block_at(there.x, there.y) or (0, 0)
    field = travel_field(terrain, here)
    assert field is not None
    path = path_to(terrain, field, row, column)
    door = path[np.argmin(clearance_at(terrain, path))]
    closed = travel_field(terrain, here, blocked=door[None])
    assert closed is not None
    assert not math.isfinite(closed.cost[row, column])
    within = travel_field(terrain, Pose2(float(door[0]), float(door[1]), 0.0), blocked=door[None])
    assert within is not None
    assert math.isfinite(within.cost[row, column])


def test_past_a_teammate_no_corner_is_cut_through_a_wall(
    two_rooms: Callable[[float], OccupancyGrid],
) -> None:
    """Where the only way has no room, the rest of the path must keep its own."""
    grid = two_rooms(0.9)
    in_door, goal = Pose2(3.45, 2.0, 0.0), Pose2(6.0, 0.6, 0.0)
    path = replan(grid, BODY, Pose2(1.0, 0.6, 0.0), goal, (in_door,))
    terrain = survey(grid, BODY)
    assert clearance_at(terrain, resample(path, 0.02)).min() >= terrain.needed


@pytest.mark.parametrize("pose", [Pose2(-5.0, 0.0, 0.0), Pose2(1e9, 1e9, 0.0)])
def test_off_the_map_there_is_no_path(
    two_rooms: Callable[[float], OccupancyGrid], pose: Pose2
) -> None:
    grid = two_rooms(0.9)
    assert len(replan(grid, BODY, pose, Pose2(1.0, 1.0, 0.0))) == 0
    assert len(replan(grid, BODY, Pose2(1.0, 1.0, 0.0), pose)) == 0
    empty = OccupancyGrid(np.zeros((0, 0), dtype=np.int8), 0.05, 0.0, 0.0)
    assert len(replan(empty, BODY, Pose2(0.0, 0.0, 0.0), Pose2(1.0, 1.0, 0.0))) == 0


def test_a_read_only_map_will_do(two_rooms: Callable[[float], OccupancyGrid]) -> None:
    grid = two_rooms(0.9)
    grid.cells.setflags(write=False)
    terrain = survey(grid, BODY)
    field = travel_field(terrain, Pose2(1.0, 1.0, 0.0))
    assert field is not None
    assert len(path_to(terrain, field, 10, 20)) > 0


@given(st.lists(st.tuples(st.floats(-5, 5), st.floats(-5, 5)), min_size=2, max_size=6))
def test_resampling_keeps_the_ends_and_the_step(points: list[tuple[float, float]]) -> None:
    line = np.array(points)
    fine = resample(line, 0.1)
    np.testing.assert_allclose(fine[[0, -1]], line[[0, -1]], atol=1e-9)
    assert np.hypot(*np.diff(fine, axis=0).T).max(initial=0.0) <= 0.1 + 1e-9


def test_the_robot_nearer_to_the_room_makes_room(corridor: OccupancyGrid) -> None:
    """In a corridor, one near its end and one in its middle, each on the way to the other side."""
    left, right = Pose2(3.5, 2.1, 0.0), Pose2(4.5, 2.1, math.pi)
    to_left, to_right = Pose2(1.5, 2.0, 0.0), Pose2(10.5, 2.0, 0.0)
    mine = find_retreat(corridor, BODY, left, to_right, "b", right, to_left)
    theirs = find_retreat(corridor, BODY, right, to_left, "a", left, to_right)
    assert mine.cost < mine.mate_cost
    assert mine.cost == pytest.approx(theirs.mate_cost)
    assert theirs.cost == pytest.approx(mine.mate_cost)
    # The way leads back into the left room and off the other's path.
    assert mine.way[:, 0].max() <= 3.6
    assert np.hypot(*(mine.way[-1] - [right.x, right.y])) > 1.0


def test_in_a_dead_end_there_is_no_retreat() -> None:
    cells = np.full((30, 120), 100, dtype=np.int8)
    cells[8:24, 4:116] = 0
    grid = OccupancyGrid(cells, 0.05, 0.0, 0.0)
    inner, outer = Pose2(5.0, 0.8, math.pi), Pose2(4.2, 0.8, 0.0)
    retreat = find_retreat(
        grid, BODY, inner, Pose2(1.0, 0.8, 0.0), "b", outer, Pose2(5.5, 0.8, 0.0)
    )
    assert math.isinf(retreat.cost)
    assert retreat.way.shape == (0, 2)
