"""The sparse factorisation against numpy's dense one."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol.pose import FloatArray
from robot.slam.block_cholesky import BlockCholesky


def random_matrix(seed: int, count: int, extra: int) -> tuple[BlockCholesky, FloatArray]:
    """A factorised positive definite matrix of blocks with a random pattern, and itself dense."""
    rng = np.random.default_rng(seed)
    pairs = np.array(
        [(i, i + 1) for i in range(count - 1)]
        + [tuple(rng.choice(count, 2, replace=False)) for _ in range(extra)],
        dtype=np.int64,
    ).reshape(-1, 2)
    cholesky = BlockCholesky(count, pairs)
    diagonal = np.zeros((count, 9))
    lower = np.zeros((cholesky.lower_count, 9))
    dense = np.zeros((3 * count, 3 * count))
    for (i, j), slot in zip(cholesky.order[pairs], cholesky.slots, strict=True):
        J = rng.standard_normal((3, 6))
        product = J.T @ J + 0.1 * np.eye(6)
        at = np.concatenate([3 * max(i, j) + np.arange(3), 3 * min(i, j) + np.arange(3)])
        dense[np.ix_(at, at)] += product
        diagonal[max(i, j)] += product[:3, :3].ravel()
        diagonal[min(i, j)] += product[3:, 3:].ravel()
        lower[slot] += product[:3, 3:].ravel()
    assert cholesky.factorise(diagonal, lower)
    return cholesky, dense


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), count=st.integers(2, 30), extra=st.integers(0, 40))
def test_it_solves_what_numpy_solves(seed: int, count: int, extra: int) -> None:
    cholesky, dense = random_matrix(seed, count, extra)
    right = np.random.default_rng(seed).standard_normal((count, 3))
    found = cholesky.solve(right)
    np.testing.assert_allclose(found.ravel(), np.linalg.solve(dense, right.ravel()), atol=1e-6)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), first=st.integers(-1, 19), second=st.integers(0, 19))
def test_spread_is_what_the_dense_inverse_says(seed: int, first: int, second: int) -> None:
    cholesky, dense = random_matrix(seed, 20, 15)
    rng = np.random.default_rng(seed)
    J, K = rng.standard_normal((2, 3, 3))
    whole = np.zeros((3, 60))
    if first >= 0:
        whole[:, 3 * first : 3 * first + 3] += J
    whole[:, 3 * second : 3 * second + 3] += K
    expected = whole @ np.linalg.inv(dense) @ whole.T
    for _ in range(2):  # the second time on the work space that the first one left
        np.testing.assert_allclose(
            cholesky.spread(first, J, second, K), expected, rtol=1e-6, atol=1e-6
        )


def test_a_matrix_that_is_not_positive_definite_is_told() -> None:
    cholesky = BlockCholesky(2, np.array([[0, 1]]))
    diagonal = np.tile(np.eye(3).ravel(), (2, 1))
    assert not cholesky.factorise(diagonal, 2.0 * np.eye(3).reshape(1, 9))
    assert cholesky.factorise(diagonal, 2.0 * np.eye(3).reshape(1, 9), damping=1.5)
    assert cholesky.factorise(diagonal, 0.5 * np.eye(3).reshape(1, 9))
    np.testing.assert_allclose(cholesky.solve(np.ones((2, 3))), 1.0 / 1.5, rtol=1e-6)


@pytest.mark.parametrize("count", [0, 1, 5])
def test_blocks_without_pairs_stand_alone(count: int) -> None:
    cholesky = BlockCholesky(count, np.empty((0, 2), dtype=np.int64))
    assert cholesky.factorise(np.tile(4.0 * np.eye(3).ravel(), (count, 1)), np.empty((0, 9)))
    np.testing.assert_allclose(cholesky.solve(np.ones((count, 3))), 0.25, rtol=1e-6)
