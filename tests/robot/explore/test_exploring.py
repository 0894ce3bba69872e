"""Exploration in closed loop: everything is seen, nothing is touched, and it ends by itself."""

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maps.grid import OccupancyGrid

MakeTeam = Callable[..., Any]


@pytest.mark.parametrize("door_m", [0.5, 0.8])
def test_a_narrow_door_is_passed(
    team: MakeTeam, two_rooms: Callable[[float], OccupancyGrid], door_m: float
) -> None:
    walk = team(two_rooms(door_m), [(1.5, 1.2, 0.0)], max_sim_s=90.0).run()
    assert walk.ended_by_itself
    assert walk.collisions == 0
    assert walk.known_share() >= 0.99


def test_a_narrow_door_is_passed_with_the_noise_of_the_paper(
    team: MakeTeam, two_rooms: Callable[[float], OccupancyGrid]
) -> None:
    walk = team(two_rooms(0.8), [(1.5, 1.2, 0.0)], noise="paper", max_sim_s=90.0).run()
    assert walk.ended_by_itself
    assert walk.collisions == 0
    assert walk.known_share(margin=6) >= 0.97


def test_a_robot_that_starts_against_a_wall_gets_away(
    team: MakeTeam, two_rooms: Callable[[float], OccupancyGrid]
) -> None:
    walk = team(two_rooms(0.9), [(0.31, 0.32, math.pi)], max_sim_s=90.0).run()
    assert walk.ended_by_itself
    assert walk.collisions == 0
    assert walk.known_share() >= 0.99


SWAP = """
import numpy as np
from protocol.pose import Pose2
from robot.explore.planner import NO_PATH, path_to, survey, travel_field
from robot.explore.policy import Plan

GOALS = {"r1": Pose2(10.5, 2.0, 0.0), "r2": Pose2(1.5, 2.0, 0.0)}

class Swap:
    def plan(self, view):
        goal = GOALS[view.name]
        if view.pose.distance_to(goal) < 0.4:
            return Plan(None, NO_PATH, "there", True, 0.0)
        terrain = survey(view.grid, view.body)
        field = travel_field(terrain, view.pose, tuple(mate.pose for mate in view.teammates))
        block = terrain.block_at(goal.x, goal.y)
        path = NO_PATH if field is None or block is None else path_to(terrain, field, *block)
        return Plan(goal if len(path) else None, path, "to the other side", False, 0.0)
"""


def test_two_robots_that_meet_in_a_corridor_get_past_each_other(
    team: MakeTeam, corridor: OccupancyGrid, tmp_path: Path
) -> None:
    """Each has to get to the other's side, and two do not fit beside each other."""
    file = tmp_path / "swap.py"
    file.write_text(SWAP)
    starts = [(2.0, 2.1, 0.0), (10.0, 2.1, math.pi)]
    known = ((1.5, 1.0), (1.5, 3.0), (6.0, 2.1), (10.5, 1.0), (10.5, 3.0))
    walk = team(corridor, starts, policy=f"{file}:Swap", known_from=known, max_sim_s=180.0).run()
    assert walk.collisions == 0
    assert any("giving way" in line for lines in walk.activities.values() for line in lines)
    assert walk.ended_by_itself
    assert walk.poses[-1, 0, 0] > 8.5
    assert walk.poses[-1, 1, 0] < 3.5


def test_a_dead_end_is_left_again(team: MakeTeam) -> None:
    cells = np.full((40, 160), 100, dtype=np.int8)
    cells[12:28, 4:150] = 0
    walk = team(OccupancyGrid(cells, 0.05, 0.0, 0.0), [(4.0, 1.0, 0.0)], max_sim_s=90.0).run()
    assert walk.ended_by_itself
    assert walk.collisions == 0
    assert walk.known_share() >= 0.99


def test_a_team_explores_rooms_and_drives_smoothly(
    team: MakeTeam, two_rooms: Callable[[float], OccupancyGrid]
) -> None:
    walk = team(two_rooms(0.9), [(1.0, 1.0, 0.0), (1.0, 3.0, 0.0)], max_sim_s=90.0).run()
    assert walk.ended_by_itself
    assert walk.collisions == 0
    assert walk.known_share() >= 0.99
    # Within what the body can do: nothing is left for the drive to clip.
    change = np.abs(np.diff(walk.commands, axis=0))
    body = walk.simulation.scenario.body
    stopping = np.all(walk.commands[1:] == 0.0, axis=-1)
    assert np.all(change[..., 0][~stopping] <= body.max_acceleration_mps2 * 0.1 + 0.16)
    assert np.median(change[..., 0]) <= 0.06
    for activities in walk.activities.values():
        assert any("nearest frontier" in line for line in activities)


def test_runs_are_the_same_with_planning_in_another_thread_and_after_a_checkpoint(
    team: MakeTeam, two_rooms: Callable[[float], OccupancyGrid]
) -> None:
    starts = [(1.0, 1.0, 0.0), (1.0, 3.0, 0.0)]
    plain = team(two_rooms(0.9), starts).run()
    with ThreadPoolExecutor(2) as executor:
        threaded = team(two_rooms(0.9), starts, executor=executor).run()
    resumed = team(two_rooms(0.9), starts, checkpoint_at=41).run()
    for other in (threaded, resumed):
        assert np.array_equal(plain.poses, other.poses)
        assert np.array_equal(plain.commands, other.commands)
        assert plain.activities == other.activities
