"""Frontiers and policies: where to go, what to leave to others, and policies of one's own."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from maps.grid import OccupancyGrid
from protocol.config import BodyConfig
from protocol.pose import FloatArray, Pose2
from robot.explore.frontier import find_frontiers
from robot.explore.planner import clearance_at, survey, travel_field
from robot.explore.policies import PolicyError, make_policy
from robot.explore.policy import Teammate, View

BODY = BodyConfig()
NONE_REFUSED = np.empty((0, 2))


def _half_known() -> OccupancyGrid:
    """A corridor along x, 2 m wide, known from 3 to 12 m: frontiers at both ends."""
    cells = np.full((60, 300), -1, dtype=np.int8)
    cells[8:52, 60:240] = 100
    cells[10:50, 60:240] = 0
    return OccupancyGrid(cells, 0.05, 0.0, 0.0)


def _view(
    grid: OccupancyGrid,
    pose: Pose2,
    teammates: tuple[Teammate, ...] = (),
    refused: FloatArray = NONE_REFUSED,
    name: str = "r2",
    goal: Pose2 | None = None,
) -> View:
    return View(name, 5, grid, pose, BODY, teammates, refused, goal)


def test_frontiers_are_where_known_ends_and_viewpoints_where_the_body_fits() -> None:
    grid = _half_known()
    terrain = survey(grid, BODY)
    field = travel_field(terrain, Pose2(5.0, 1.5, 0.0))
    assert field is not None
    found = find_frontiers(terrain, field, NONE_REFUSED)
    assert [round(frontier.x) for frontier in found] == [3, 12]
    for frontier in found:
        assert 1.5 <= frontier.length_m <= 2.1
        viewpoint = np.array([terrain.point_of(frontier.row, frontier.column)])
        assert clearance_at(terrain, viewpoint)[0] >= terrain.needed
        assert abs(viewpoint[0, 0] - frontier.x) < 0.7
    assert found[0].travel_m < found[1].travel_m


def test_the_nearest_frontier_is_chosen_and_refused_ones_are_not() -> None:
    policy = make_policy("frontier")
    grid = _half_known()
    near = policy.plan(_view(grid, Pose2(5.0, 1.5, 0.0)))
    assert near.goal is not None
    assert near.goal.x < 4.0
    assert np.hypot(*(near.path[-1] - [near.goal.x, near.goal.y])) < 0.05
    # Refusing every viewpoint of an end leaves the other one.
    left_end = np.array([[3.3, y] for y in np.arange(0.5, 2.6, 0.3)])
    far = policy.plan(_view(grid, Pose2(5.0, 1.5, 0.0), refused=left_end))
    assert far.goal is not None
    assert far.goal.x > 11.0
    both = np.concatenate([left_end, left_end + np.array([8.4, 0.0])])
    nothing = policy.plan(_view(grid, Pose2(5.0, 1.5, 0.0), refused=both))
    assert nothing.goal is None
    assert nothing.exhausted
    assert nothing.frontier_m == 0.0
    assert nothing.path.shape == (0, 2)


def test_what_a_scan_from_there_left_unknown_is_no_frontier() -> None:
    policy, grid, here = make_policy("frontier"), _half_known(), Pose2(5.0, 1.5, 0.0)
    goal = policy.plan(_view(grid, here)).goal
    assert goal is not None
    assert goal.x < 4.0
    ys = np.arange(0.5, 2.6, 0.1)
    looked = np.array([[x, y] for x in np.arange(3.0, 3.8, 0.1) for y in ys])
    beyond_the_map = np.array([[-50.0, 1.5], [500.0, 1.5]])
    view = replace(_view(grid, here), lookouts=np.concatenate([looked, beyond_the_map]))
    goal = policy.plan(view).goal
    assert goal is not None
    assert goal.x > 11.0
    one_scan = replace(view, lookouts=looked[:1])
    goal = policy.plan(one_scan).goal
    assert goal is not None
    assert goal.x < 4.0


def test_a_frontier_is_left_to_the_teammate_who_is_nearer_to_it() -> None:
    policy, grid, here = make_policy("frontier"), _half_known(), Pose2(5.0, 1.5, 0.0)
    goal = Pose2(3.3, 1.5, 0.0)
    nearer = Teammate("r1", Pose2(4.2, 1.5, 0.0), goal, 1, True)
    farther = Teammate("r1", Pose2(7.0, 1.5, 0.0), goal, 1, True)
    out_of_range = Teammate("r1", Pose2(4.2, 1.5, 0.0), goal, 1, False)
    left = policy.plan(_view(grid, here, (nearer,)))
    assert left.goal is not None
    assert left.goal.x > 11.0
    assert "teammate" in left.reason
    for mate in (farther, out_of_range):
        taken = policy.plan(_view(grid, here, (mate,)))
        assert taken.goal is not None
        assert taken.goal.x < 4.0


def test_what_little_is_left_is_waited_for_when_it_is_a_teammates() -> None:
    policy, grid, here = make_policy("frontier"), _half_known(), Pose2(6.0, 1.5, 0.0)
    right_end = np.array([[11.7, y] for y in np.arange(0.5, 2.6, 0.3)])
    mate = Teammate("r1", Pose2(4.5, 1.5, 0.0), Pose2(3.3, 1.5, 0.0), 1, True)
    plan = policy.plan(_view(grid, here, (mate,), right_end))
    assert plan.goal is None
    assert not plan.exhausted
    assert plan.frontier_m > 1.0


def test_of_two_that_are_equally_near_exactly_one_goes() -> None:
    policy, grid = make_policy("frontier"), _half_known()
    goal, place = Pose2(3.3, 1.5, 0.0), Pose2(5.0, 1.5, 0.0)
    xs = []
    for me, other in (("r1", "r2"), ("r2", "r1")):
        plan = policy.plan(_view(grid, place, (Teammate(other, place, goal, 1, True),), name=me))
        assert plan.goal is not None
        xs.append(plan.goal.x)
    assert xs[0] < 4.0 < xs[1]


def test_a_frontier_where_a_teammate_stands_is_not_visited() -> None:
    policy, grid = make_policy("frontier"), _half_known()
    standing = [
        Teammate("r1", Pose2(3.3, 1.5, 0.0), None, 1, True),
        Teammate("r3", Pose2(11.7, 1.5, 0.0), None, 1, True),
    ]
    plan = policy.plan(_view(grid, Pose2(7.0, 1.5, 0.0), tuple(standing)))
    assert plan.goal is None
    assert plan.exhausted
    at_work = Teammate("r1", Pose2(3.3, 1.5, 0.0), Pose2(3.2, 1.5, 0.0), 1, True)
    plan = policy.plan(_view(grid, Pose2(7.0, 1.5, 0.0), (at_work, standing[1])))
    assert plan.goal is None
    assert not plan.exhausted


def test_a_goal_is_kept_unless_another_is_clearly_nearer() -> None:
    policy, grid, here = make_policy("frontier"), _half_known(), Pose2(7.3, 1.5, 0.0)
    kept = policy.plan(_view(grid, here, goal=Pose2(11.7, 1.5, 0.0)))
    assert kept.goal is not None
    assert kept.goal.x > 11.0


def test_what_cannot_hide_a_robot_is_no_frontier() -> None:
    cells = np.full((120, 120), 100, dtype=np.int8)
    cells[2:-2, 2:-2] = 0
    cells[60:66, 60:66] = -1  # 0.3 m: less than a robot
    grid = OccupancyGrid(cells, 0.05, 0.0, 0.0)
    plan = make_policy("frontier").plan(_view(grid, Pose2(1.0, 1.0, 0.0)))
    assert plan.exhausted
    cells[50:66, 50:66] = -1
    plan = make_policy("frontier").plan(_view(grid, Pose2(1.0, 1.0, 0.0)))
    assert plan.goal is not None


def test_a_frontier_that_cannot_be_reached_is_none(
    two_rooms: Callable[[float], OccupancyGrid],
) -> None:
    grid = two_rooms(0.3)
    grid.cells[:, 120:] = -1
    plan = make_policy("frontier").plan(_view(grid, Pose2(1.0, 1.0, 0.0)))
    assert plan.exhausted


@pytest.mark.parametrize("policy", ["frontier", "patrol"])
def test_a_robot_leaves_by_the_gap_it_came_in_by(
    policy: str, two_rooms: Callable[[float], OccupancyGrid]
) -> None:
    """On the map of now the door is a little too narrow; beyond it is more to see."""
    grid = two_rooms(0.4)
    grid.cells[:, 120:] = -1
    view = _view(grid, Pose2(1.0, 1.0, 0.0))
    trapped = replace(view, home=Pose2(5.0, 2.0, 0.0))
    goal = make_policy(policy).plan(trapped).goal
    assert goal is not None
    assert goal.x > 5.0
    # One that is not shut in does not try, even where a teammate has been: such gaps are many.
    beyond = np.array([[5.0, 2.0]])
    plan = make_policy(policy).plan(replace(view, home=Pose2(2.0, 2.0, 0.0), lookouts=beyond))
    assert plan.goal is None or plan.goal.x < 3.4


def test_without_a_map_it_waits() -> None:
    empty = OccupancyGrid(np.zeros((0, 0), dtype=np.int8), 0.05, 0.0, 0.0)
    plan = make_policy("frontier").plan(_view(empty, Pose2(0.0, 0.0, 0.0)))
    assert plan.goal is None
    assert not plan.exhausted


GOOD = """
from dataclasses import dataclass
from robot.explore.policy import Plan

@dataclass
class Stay:
    def plan(self, view):
        return Plan(None, view.refused, "staying", True, 0.0)

class Greedy:
    def __init__(self, appetite):
        self.appetite = appetite

class Idle:
    pass
"""


def test_a_policy_of_ones_own_is_a_class_in_a_file(tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text(GOOD)
    plan = make_policy(f"{file}:Stay").plan(_view(_half_known(), Pose2(5.0, 1.5, 0.0)))
    assert plan.reason == "staying"


@pytest.mark.parametrize(
    ("name", "word"),
    [
        ("nearest", "there are frontier"),
        ("{file}", "there are frontier"),
        ("{file}:Missing", "it has"),
        ("{file}:GREETING", "has no class"),
        ("{file}:Greedy", "cannot be made"),
        ("{file}:Idle", r"no method plan\(view\)"),
        ("{folder}/none.py:Stay", "does not exist"),
        ("{broken}:Stay", "does not load"),
    ],
)
def test_what_is_no_policy_is_refused_with_a_reason(tmp_path: Path, name: str, word: str) -> None:
    file, broken = tmp_path / "mine.py", tmp_path / "broken.py"
    file.write_text(GOOD + "\nGREETING = 'hello'\n")
    broken.write_text("import does_not_exist_anywhere\n")
    with pytest.raises(PolicyError, match=word):
        make_policy(name.format(file=file, broken=broken, folder=tmp_path))


def test_with_nothing_left_to_explore_a_robot_goes_to_meet_who_is_out_of_earshot() -> None:
    cells = np.full((60, 300), 100, dtype=np.int8)
    cells[10:50, 60:240] = 0
    alone = _view(OccupancyGrid(cells, 0.05, 0.0, 0.0), Pose2(5.0, 1.5, 0.0))
    policy = make_policy("frontier")
    assert policy.plan(alone).exhausted
    plan = policy.plan(replace(alone, meeting_place=Pose2(10.0, 1.5, 0.0)))
    assert plan.goal == Pose2(10.0, 1.5, 0.0)
    assert not plan.explores
    assert not plan.exhausted
    assert np.hypot(*(plan.path[-1] - [10.0, 1.5])) < 0.3
    beyond_the_wall, off_the_map = Pose2(14.0, 1.5, 0.0), Pose2(90.0, 1.5, 0.0)
    assert policy.plan(replace(alone, meeting_place=beyond_the_wall)).exhausted
    assert policy.plan(replace(alone, meeting_place=off_the_map)).exhausted
    exploring = _view(_half_known(), Pose2(5.0, 1.5, 0.0))
    plan = policy.plan(replace(exploring, meeting_place=Pose2(8.0, 1.5, 0.0)))
    assert plan.explores
