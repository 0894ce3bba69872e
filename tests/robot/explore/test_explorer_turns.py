"""What keeps a robot from turning back and forth between goals for ever."""

import numpy as np

from protocol.config import RobotConfig
from protocol.pose import IDENTITY, Pose2
from robot.explore.explorer import Explorer
from robot.explore.policy import Plan, Teammate
from robot.explore.refusals import MOST_RETURNS, NEARER_M, PATIENCE_S, Refusals
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
    assert explorer._refusals.given_up == []
    explorer._take(50, plan_to(one))
    explorer._take(51, plan_to(other))
    assert explorer._refusals.given_up[0] == one


def test_keeping_to_a_goal_is_no_return() -> None:
    explorer = make_explorer()
    for tick in range(100):
        explorer._take(tick, plan_to(Pose2(5.0 + 0.002 * tick, 0.0, 0.0)))
    assert explorer._refusals.given_up == []


def test_where_a_teammate_stands_without_a_goal_needs_no_second_look() -> None:
    explorer = make_explorer()
    place = Pose2(4.0, 1.0, 0.0)
    explorer._note_lookouts((Teammate("r2", place, None, 3, True),))
    explorer._note_lookouts((Teammate("r2", place, None, 9, True),))
    assert explorer._refusals.seen == [place]
    busy = Teammate("r2", Pose2(9.0, 1.0, 0.0), Pose2(12.0, 0.0, 0.0), 3, True)
    explorer._note_lookouts((busy,))
    assert explorer._refusals.seen == [place]


def test_a_goal_that_comes_no_nearer_is_given_up_and_one_that_does_is_not() -> None:
    tick_s, goal = 0.1, Pose2(8.0, 0.0, 0.0)
    patience = round(PATIENCE_S / tick_s)
    circling, driving = Refusals(tick_s), Refusals(tick_s)
    for tick in range(patience + 1):
        assert not circling.is_stalled(tick, goal, 8.0 + 0.4 * (tick % 2))
        assert not driving.is_stalled(tick, goal, 200.0 - 0.01 * tick)
    assert circling.is_stalled(patience + 1, goal, 8.0)
    assert not driving.is_stalled(patience + 1, goal, 190.0 - NEARER_M)
    # Another goal starts anew.
    assert not circling.is_stalled(patience + 2, Pose2(-8.0, 0.0, 0.0), 8.0)


def test_what_was_given_up_gets_one_second_chance() -> None:
    refusals = Refusals(0.1)
    assert not refusals.retry()
    refusals.note_seen(IDENTITY)
    refusals.give_up(Pose2(3.0, 0.0, 0.0))
    assert refusals.places().tolist() == [[0.0, 0.0], [3.0, 0.0]]
    assert refusals.retry()
    assert refusals.places().tolist() == [[0.0, 0.0]]
    refusals.give_up(Pose2(3.0, 0.0, 0.0))
    assert not refusals.retry()
    assert len(refusals.places()) == 2


def test_a_spot_that_blocks_the_way_is_remembered_until_the_second_chance() -> None:
    refusals = Refusals(0.1)
    refusals.give_up(Pose2(3.0, 0.0, 0.0))
    assert refusals.blocked().shape == (0, 2)
    refusals.give_up(Pose2(5.0, 0.0, 0.0), (4.0, 0.5))
    assert refusals.blocked().tolist() == [[4.0, 0.5]]
    assert refusals.retry()
    assert refusals.blocked().shape == (0, 2)
