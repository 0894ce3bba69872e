"""Consistent sets of matches: the true ones together, those of a shifted alignment apart."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from protocol.pose import FloatArray, Pose2, compose, invert
from robot.slam.gaussian import carry
from robot.team.consistency import (
    Matches,
    consistency,
    consistent_sets,
    gathered_covariance,
    worth,
)

TRUE = np.array([4.0, -2.0, 0.7])
SHIFTED = compose(np.array([12.2, 0.0, 0.0]), TRUE)


def matches(seed: int, alignments: list[FloatArray], drift: float = 1e-4) -> Matches:
    """One match for each alignment given, at places that both robots pass on their way."""
    rng = np.random.default_rng(seed)
    n = len(alignments)
    of, to = rng.integers(0, 40, n), rng.integers(0, 40, n)
    poses_a = np.column_stack([rng.uniform(-20, 20, (n, 2)), rng.uniform(-3, 3, n)])
    poses_b = np.column_stack([rng.uniform(-20, 20, (n, 2)), rng.uniform(-3, 3, n)])
    measured = np.array(
        [
            compose(compose(invert(a), T), b)
            for a, T, b in zip(poses_a, alignments, poses_b, strict=True)
        ]
    )
    measured = compose(measured, rng.normal(0.0, [0.02, 0.02, 0.004], (n, 3)))
    covariance = np.broadcast_to(np.diag([0.02**2, 0.02**2, 0.004**2]), (n, 3, 3)).copy()
    chain = np.eye(3) * drift
    return Matches(
        of,
        to,
        poses_a,
        poses_b,
        measured,
        covariance,
        np.array([chain * k for k in of]),
        np.array([chain * k for k in to]),
        np.ones(n),
    )


@given(st.integers(0, 1000))
def test_consistency_is_symmetric_and_keeps_true_matches_together(seed: int) -> None:
    agrees = consistency(matches(seed, [TRUE] * 12))
    assert (agrees == agrees.T).all() and agrees.diagonal().all()
    assert agrees.mean() > 0.95


@given(st.integers(0, 200))
def test_the_larger_set_comes_first_and_its_rival_second(seed: int) -> None:
    kinds = [TRUE] * 8 + [SHIFTED] * 4
    order = np.random.default_rng(seed).permutation(len(kinds))
    found = consistent_sets(matches(seed, [kinds[k] for k in order], drift=1e-6), 3)
    true = {int(np.flatnonzero(order == k)[0]) for k in range(8)}
    assert set(found[0].tolist()) <= true and len(found[0]) >= 7
    rival = set(found[1].tolist())
    assert rival.isdisjoint(true) and len(rival) >= 3


def test_many_false_matches_do_not_agree() -> None:
    rng = np.random.default_rng(5)
    false = [np.append(rng.uniform(-30, 30, 2), rng.uniform(-3, 3)) for _ in range(40)]
    found = consistent_sets(matches(1, [TRUE] * 10 + false, drift=1e-6), 2)
    assert set(range(9)) <= set(found[0].tolist()) | {0}
    assert all(k < 10 for k in found[0])
    assert len(found[1]) <= 3


def test_a_place_counts_once_however_often_it_was_matched() -> None:
    m = matches(0, [TRUE] * 6)
    m.of[:] = [0, 0, 0, 1, 1, 1]
    m.to[:] = range(6)
    assert worth(m, np.arange(6)) == 2.0
    m.to[:] = 7
    assert worth(m, np.arange(6)) == 1.0


def test_gathered_covariance_is_that_of_the_chain_seen_from_its_origin() -> None:
    rng = np.random.default_rng(2)
    relative = rng.normal(0.0, [1.0, 0.3, 0.4], (5, 3))
    steps = np.array([np.diag(rng.uniform(1e-4, 1e-3, 3)) for _ in range(5)])
    gathered = gathered_covariance(relative, steps)
    pose, at_end = Pose2(0.0, 0.0, 0.0), np.zeros((3, 3))
    for k in range(5):
        pose = pose @ Pose2.from_array(relative[k])
        at_end = carry(at_end, Pose2.from_array(relative[k])) + steps[k]
    adjoint = pose.adjoint()
    np.testing.assert_allclose(adjoint @ at_end @ adjoint.T, gathered[-1], atol=1e-12)
