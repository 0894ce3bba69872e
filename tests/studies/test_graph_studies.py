"""The studies of matcher and covariances, in small."""

import numpy as np
import pytest

from robot.perception.returns import Returns
from studies.consistency import summarise
from studies.matching import bound, by_earshot, measure


def test_honest_errors_give_a_nees_of_one() -> None:
    rng = np.random.default_rng(0)
    runs = [np.column_stack([rng.chisquare(3, 40), *np.ones((4, 40))]) for _ in range(30)]
    figures = summarise(runs)
    assert figures["nees_per_dof"] == pytest.approx(1.0, abs=0.1)
    assert figures["within_95_gate"] == pytest.approx(0.95, abs=0.02)
    low, high = figures["nees_95"]
    assert low < figures["nees_per_dof"] < high


def test_pairs_of_scans_are_matched_near_their_bound() -> None:
    figures = measure("office", 60, 3, {"earshot": by_earshot})
    assert figures["earshot_success"] == 1.0
    assert 0.8 < figures["earshot_rmse_by_bound_m"] < 1.6
    assert 0.8 < figures["earshot_rmse_by_bound_rad"] < 1.6
    assert 0.5 < figures["earshot_nees_per_dof"] < 2.0


def test_a_wall_ahead_says_nothing_of_the_side() -> None:
    y = np.linspace(-1.0, 1.0, 21)
    values = np.zeros((21, 6))
    values[:, 0], values[:, 1], values[:, 2], values[:, 4] = 2.0, y, -1.0, 1.0
    information = bound(Returns.unlinked(values))
    assert information[0, 0] > 1e4
    assert information[1, 1] == 0.0
    assert information[2, 2] > 0.0
