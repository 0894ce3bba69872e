"""Patrolling: frontiers first, then the places that were left alone longest, without an end."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from maps.grid import OccupancyGrid
from protocol.config import BodyConfig
from protocol.pose import FloatArray, Pose2
from robot.explore.footprints import SQUARE_M, Footprints, square_of
from robot.explore.policies import make_policy
from robot.explore.policy import Teammate, View

BODY = BodyConfig()
TICK = 1000


def _hall(known_m: float = 24.0) -> OccupancyGrid:
    """A hall of 24 m × 3 m, known up to `known_m` along x, with walls all round."""
    cells = np.full((70, 490), 100, dtype=np.int8)
    cells[5:65, 5:485] = 0
    cells[:, 5 + round(known_m / 0.05) :] = 100 if known_m >= 24.0 else -1
    return OccupancyGrid(cells, 0.05, -0.25, -0.25)


def _visited(until_x: float, tick: int = TICK) -> FloatArray:
    """Squares along the hall that were visited at `tick` up to an x, and at tick 500 beyond."""
    footprints = Footprints()
    for x in np.arange(0.5 * SQUARE_M, 24.0, SQUARE_M).tolist():
        footprints.mark(tick if x < until_x else 500, Pose2(x, 1.5, 0.0))
    return footprints.visits()


def _view(
    visits: FloatArray,
    x: float = 3.0,
    teammates: tuple[Teammate, ...] = (),
    goal: Pose2 | None = None,
    grid: OccupancyGrid | None = None,
) -> View:
    here, nowhere = Pose2(x, 1.5, 0.0), np.empty((0, 2))
    return View("r2", TICK, grid or _hall(), here, BODY, teammates, nowhere, goal, visits=visits)


def test_frontiers_come_first() -> None:
    plan = make_policy("patrol").plan(_view(_visited(12.0), grid=_hall(10.0)))
    assert plan.goal is not None
    assert plan.explores
    assert 9.0 < plan.goal.x < 10.0


def test_the_place_that_was_left_alone_longest_is_next_and_nothing_is_ever_exhausted() -> None:
    plan = make_policy("patrol").plan(_view(_visited(18.0)))
    assert plan.goal is not None
    assert plan.goal.x == pytest.approx(19.5, abs=0.1)  # the nearest of those
    assert not plan.explores
    assert not plan.exhausted
    assert np.hypot(*(plan.path[-1] - [plan.goal.x, plan.goal.y])) < 0.05
    everywhere = make_policy("patrol").plan(_view(_visited(24.0)))
    assert everywhere.goal is not None
    assert not everywhere.exhausted


def test_the_team_spreads_out() -> None:
    visits = _visited(0.0)
    mate = Teammate("r1", Pose2(16.0, 1.5, 0.0), Pose2(7.5, 1.5, 0.0), 1, True)
    plan = make_policy("patrol").plan(_view(visits, x=6.5, teammates=(mate,)))
    assert plan.goal is not None
    assert square_of(plan.goal.x, 1.5) != square_of(7.5, 1.5)  # where the other is heading
    assert plan.goal.x < 11.3  # where this one is nearer


def test_a_place_is_kept_until_it_is_reached() -> None:
    for x, kept in ((6.0, False), (16.0, True)):  # much nearer ones are as old, or not much
        plan = make_policy("patrol").plan(_view(_visited(0.0), x=x, goal=Pose2(19.5, 1.5, 0.0)))
        assert plan.goal is not None
        assert (square_of(plan.goal.x, 1.5) == square_of(19.5, 1.5)) == kept


def test_without_a_map_it_waits() -> None:
    empty = OccupancyGrid(np.zeros((0, 0), dtype=np.int8), 0.05, 0.0, 0.0)
    plan = make_policy("patrol").plan(_view(np.empty((0, 3)), grid=empty))
    assert plan.goal is None
    assert not plan.exhausted


def test_footprints_take_no_more_room_than_the_building() -> None:
    footprints = Footprints()
    for tick in range(5000):
        footprints.mark(tick, Pose2(0.01 * (tick % 1200), -0.5, 0.0))
    visits = footprints.visits()
    assert len(visits) == 12.0 / SQUARE_M
    assert visits[:, 1].tolist() == [-0.5 * SQUARE_M] * len(visits)
    assert visits[:, 2].max() == 4999


def test_a_team_that_patrols_goes_everywhere_again_and_never_ends(
    team: Callable[..., Any], two_rooms: Callable[[float], OccupancyGrid]
) -> None:
    walk = team(
        two_rooms(1.0), [(1.0, 1.0, 0.0), (2.0, 3.0, 0.0)], policy="patrol", max_sim_s=150.0
    ).run()
    assert not walk.ended_by_itself
    assert walk.collisions == 0
    assert walk.known_share() > 0.99
    for later in (walk.poses[750:1125], walk.poses[1125:]):
        squares = {square_of(x, y) for x, y in later[:, :, :2].reshape(-1, 2).tolist()}
        everywhere = {square_of(x, y) for x, y in walk.poses[:, :, :2].reshape(-1, 2).tolist()}
        assert len(squares) >= 0.7 * len(everywhere)
