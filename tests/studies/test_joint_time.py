"""The study of the joint solution's time, in small."""

import numpy as np

from robot.team.joint import solve
from studies.joint_time import team_problem


def test_the_team_of_the_study_is_a_problem_that_can_be_solved() -> None:
    problem = team_problem(3, 30, 1.0, seed=1)
    assert problem.sizes == (30, 30, 30)
    assert sorted(solve(problem)) == sorted(problem.logs)
    assert np.array_equal(problem.nodes, team_problem(3, 30, 1.0, seed=1).nodes)
