"""What keeps a robot from turning back and forth between goals for ever."""

import numpy as np

from protocol.config import RobotConfig
from protocol.pose import IDENTITY, Pose2
from robot.explore.explorer import MOST_RETURNS, Explorer
from robot.explore.policy import Plan, Teammate
from robot.jobs import Jobs


def make_explorer() -> Explorer:
    explorer = Explorer(RobotConfig(name="r1", team=("r1", "r2")), Jobs())
    explorer._planned_from = IDENTITY
    return explorer


def plan_to(goal: Pose2) -> Plan:
    return Plan(goal, np.array([[0.0, 0.0], [goal.x, goal.y]]), "test", False, 1.0)


def test_a_goal_that_is_left_again_and_again_is_given_up() -> None:
    explorer = make_explorer()
    one, other = Pose2(20.0, 0.0, 0.0), Pose2(-20.0, 0.0, 0.0)
    for tick in range(2 * MOST_RETURNS + 2):
        explorer._take(tick, plan_to(one if tick % 2 == 0 else other))
    assert explorer._given_up == []
    explorer._take(50, plan_to(one))
    explorer._take(51, plan_to(other))
    assert explorer._given_up[0] == one


def test_keeping_to_a_goal_is_no_return() -> None:
    explorer = make_explorer()
    for tick in range(100):
        explorer._take(tick, plan_to(Pose2(5.0 + 0.002 * tick, 0.0, 0.0)))
    assert explorer._given_up == []


def test_where_a_teammate_stands_without_a_goal_needs_no_second_look() -> None:
    explorer = make_explorer()
    place = Pose2(4.0, 1.0, 0.0)
    explorer._note_lookouts((Teammate("r2", place, None, 3, True),))
    explorer._note_lookouts((Teammate("r2", place, None, 9, True),))
    assert explorer._visited == [place]
    busy = Teammate("r2", Pose2(9.0, 1.0, 0.0), Pose2(12.0, 0.0, 0.0), 3, True)
    explorer._note_lookouts((busy,))
    assert explorer._visited == [place]
