"""Recovery: being stuck is noticed, every behaviour ends, and one of two robots makes room."""

import math

import numpy as np
import pytest

from protocol.pose import Pose2
from robot.explore.policy import Teammate
from robot.explore.recovery import (
    GIVE_WAY_S,
    MOST_MEETINGS,
    MOST_WAITS,
    STUCK_S,
    Kind,
    Recovery,
    blocking_teammate,
    widest_direction,
)
from robot.explore.retreat import Retreat

HERE = Pose2(0.0, 0.0, 0.0)
NOTHING = np.empty((0, 2))
WAY = np.array([[0.0, 0.0], [-1.0, 0.0]])


def _mate(x: float, goal: Pose2 | None = HERE, name: str = "b", age: int = 0) -> Teammate:
    return Teammate(name, Pose2(x, 0.0, 0.0), goal, age, True)


def test_stuck_is_to_want_and_not_to_move() -> None:
    recovery, span = Recovery("a", 0.1), round(STUCK_S / 0.1)
    assert not any(recovery.is_stuck(tick, HERE, False) for tick in range(100))
    creeping = [recovery.is_stuck(t, Pose2(0.01 * (t - 100), 0, 0), True) for t in range(100, 200)]
    assert not any(creeping)
    standing = [recovery.is_stuck(t, HERE, True) for t in range(200, 200 + 2 * span)]
    assert not any(standing[:span])
    assert standing[-1]


def test_alone_it_backs_up_then_turns_then_gives_up() -> None:
    recovery = Recovery("a", 0.1)
    kinds = [recovery.begin(10 * k, HERE, NOTHING, None).kind for k in range(4)]
    assert kinds == [Kind.BACK_UP, Kind.TURN, Kind.GIVE_UP, Kind.BACK_UP]


def test_every_behaviour_ends() -> None:
    recovery = Recovery("a", 0.1)
    for mate in (None, None, None, _mate(0.6), _mate(0.6)):
        begun = recovery.begin(0, HERE, NOTHING, mate)
        assert begun.until <= round(GIVE_WAY_S / 0.1)
        assert recovery.is_over(begun.until, HERE, False, () if mate is None else (mate,))
        recovery.end()
        assert recovery.manoeuvre is None


@pytest.mark.parametrize(("costs", "first"), [((1.0, 3.0), "a"), ((3.0, 1.0), "b")])
def test_who_has_the_shorter_way_makes_room_and_else_they_take_turns(
    costs: tuple[float, float], first: str
) -> None:
    a, b = Recovery("a", 0.1), Recovery("b", 0.1)
    givers = []
    for attempt in range(3):
        a.begin(100 * attempt, HERE, NOTHING, _mate(0.6, name="b"))
        b.begin(100 * attempt, HERE, NOTHING, _mate(0.6, name="a"))
        gives_a = a.make_room(0, Retreat("b", WAY, costs[0], costs[1]), obliging=False)
        gives_b = b.make_room(0, Retreat("a", WAY, costs[1], costs[0]), obliging=False)
        assert gives_a != gives_b
        givers.append("a" if gives_a else "b")
    assert givers == [first, "b", "a"]


def test_without_a_way_nobody_makes_room() -> None:
    recovery = Recovery("b", 0.1)
    recovery.begin(0, HERE, NOTHING, _mate(0.6, name="a"))
    assert not recovery.make_room(1, Retreat("a", NOTHING, math.inf, math.inf), obliging=True)
    assert recovery.manoeuvre is not None
    assert recovery.manoeuvre.kind is Kind.WAIT


@pytest.mark.parametrize(("goal", "most"), [(HERE, MOST_MEETINGS), (None, MOST_WAITS)])
def test_a_goal_behind_a_teammate_is_given_up_in_the_end(goal: Pose2 | None, most: int) -> None:
    recovery = Recovery("a", 0.1)
    kinds = [recovery.begin(0, HERE, NOTHING, _mate(0.6, goal)).kind for _ in range(most + 1)]
    assert kinds == [Kind.WAIT] * most + [Kind.GIVE_UP]


def test_giving_way_ends_when_the_other_has_passed() -> None:
    recovery = Recovery("b", 0.1)
    recovery.begin(0, HERE, NOTHING, _mate(0.6, name="a"))
    assert recovery.make_room(0, Retreat("a", WAY, 1.0, 9.0), obliging=False)
    coming = [
        recovery.is_over(t, HERE, True, (_mate(2.0 - 0.05 * t, name="a"),)) for t in range(30)
    ]
    assert not any(coming)
    leaving = [
        recovery.is_over(t, HERE, True, (_mate(0.05 * (t - 20), name="a"),)) for t in range(30, 60)
    ]
    assert not any(leaving[:10])
    assert leaving[-1]


def test_only_a_near_teammate_ahead_and_heard_of_lately_is_in_the_way() -> None:
    ahead = np.array([1.0, 0.0])
    for mate, blocks in [
        (_mate(0.8), True),
        (_mate(-0.8), False),
        (_mate(3.0), False),
        (_mate(0.8, age=100), False),
    ]:
        assert (blocking_teammate(HERE, ahead, (mate,)) is mate) is blocks
    assert blocking_teammate(HERE, ahead, (_mate(1.0), _mate(0.7, name="c"))) == _mate(
        0.7, name="c"
    )


def test_the_widest_direction_is_away_from_what_is_near() -> None:
    wall = np.stack([np.full(50, 0.4), np.linspace(-1.0, 1.0, 50)], axis=-1)
    assert abs(abs(widest_direction(wall)) - math.pi) < 0.1
    assert widest_direction(NOTHING) == 0.0
