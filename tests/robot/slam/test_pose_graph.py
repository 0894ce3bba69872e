"""The pose graph optimiser against scipy, analytic Jacobians and its own laws."""

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from protocol.pose import FloatArray, Pose2, compose, invert, wrap_angles
from robot.slam.normal_equations import NormalEquations
from robot.slam.pose_graph import (
    PoseGraphError,
    marginal_covariance,
    optimise,
    squared_errors,
)


def random_graph(
    seed: int, count: int = 12, extra: int = 10, noise: float = 0.05
) -> tuple[Any, ...]:
    """A drifting chain with loop edges: initial nodes, edges, measurements, information, truth."""
    rng = np.random.default_rng(seed)
    truth = np.cumsum(rng.uniform(-1, 1, (count, 3)) * [2.0, 2.0, 0.8], axis=0)
    truth[:, 2] = wrap_angles(truth[:, 2])
    pairs = [(i, i + 1) for i in range(count - 1)]
    pairs += [tuple(sorted(rng.choice(count, 2, replace=False))) for _ in range(extra)]
    edges = np.array([(a, b) if rng.random() < 0.7 else (b, a) for a, b in pairs])
    Z = compose(invert(truth[edges[:, 0]]), truth[edges[:, 1]])
    Z = Z + rng.standard_normal(Z.shape) * noise
    information = np.empty((len(edges), 3, 3))
    for k in range(len(edges)):
        A = rng.standard_normal((3, 3))
        information[k] = A @ A.T + 3.0 * np.eye(3)
    nodes = truth + rng.standard_normal(truth.shape) * 0.1
    nodes[0] = truth[0]
    return nodes, edges, Z, information, truth


def fix_first(nodes: FloatArray) -> npt.NDArray[np.bool_]:
    fixed = np.zeros(len(nodes), dtype=bool)
    fixed[0] = True
    return fixed


def residuals(nodes: FloatArray, edges: Any, Z: FloatArray, information: FloatArray) -> FloatArray:
    out = []
    for (i, j), z, W in zip(edges, Z, information, strict=True):
        e = compose(invert(z), compose(invert(nodes[i]), nodes[j]))
        out.append(np.linalg.cholesky(W).T @ e)
    return np.concatenate(out)


@pytest.mark.parametrize("seed", range(4))
def test_it_finds_the_minimum_that_scipy_finds(seed: int) -> None:
    nodes, edges, Z, information, _ = random_graph(seed)
    solution = optimise(nodes, edges, Z, information, fix_first(nodes))

    def cost(x: FloatArray) -> FloatArray:
        return residuals(np.vstack([nodes[:1], x.reshape(-1, 3)]), edges, Z, information)

    reference = least_squares(cost, nodes[1:].ravel(), xtol=1e-12, ftol=1e-12, gtol=1e-12)
    assert solution.converged
    assert solution.chi2 == pytest.approx(2.0 * reference.cost, rel=1e-6)
    off = compose(invert(np.vstack([nodes[:1], reference.x.reshape(-1, 3)])), solution.nodes)
    assert np.abs(off).max() < 1e-4


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_exact_measurements_are_met_exactly(seed: int) -> None:
    nodes, edges, Z, information, truth = random_graph(seed, noise=0.0)
    solution = optimise(nodes, edges, Z, information, fix_first(nodes))
    assert solution.chi2 < 1e-8
    assert np.abs(compose(invert(truth), solution.nodes)).max() < 1e-4


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_the_gradient_is_the_numeric_one(seed: int) -> None:
    """−g is half the derivative of the cost along each node's own axes."""
    nodes, edges, Z, information, _ = random_graph(seed, count=6, extra=4)
    robust = np.arange(len(edges)) % 3 == 0
    problem = NormalEquations(nodes, edges, Z, information, fix_first(nodes), robust, 9.0)
    problem.linearise(problem.nodes)
    gradient = problem.gradient.ravel().copy()
    h = 1e-6
    for place in range(problem.size):
        step = np.zeros(problem.size)
        step[place] = h
        up = problem.linearise(problem.retract(problem.nodes, step.reshape(-1, 3)))
        down = problem.linearise(problem.retract(problem.nodes, -step.reshape(-1, 3)))
        assert -gradient[place] == pytest.approx((up - down) / (4.0 * h), rel=1e-4, abs=1e-4)


def test_the_map_frame_does_not_matter() -> None:
    nodes, edges, Z, information, _ = random_graph(7)
    moved = compose(np.array([30.0, -20.0, 2.0]), nodes)
    a = optimise(nodes, edges, Z, information, fix_first(nodes))
    b = optimise(moved, edges, Z, information, fix_first(nodes))
    assert a.chi2 == pytest.approx(b.chi2, rel=1e-6)
    assert (
        np.abs(compose(invert(moved[0]), b.nodes) - compose(invert(nodes[0]), a.nodes)).max() < 1e-5
    )


def test_components_are_solved_side_by_side() -> None:
    nodes, edges, Z, information, _ = random_graph(1)
    fixed = fix_first(nodes)
    alone = optimise(nodes, edges, Z, information, fixed)
    both = optimise(
        np.vstack([nodes, nodes]),
        np.vstack([edges, edges + len(nodes)]),
        np.vstack([Z, Z]),
        np.concatenate([information, information]),
        np.concatenate([fixed, fixed]),
    )
    assert np.allclose(both.nodes[: len(nodes)], alone.nodes, atol=1e-6)
    assert np.allclose(both.nodes[len(nodes) :], alone.nodes, atol=1e-6)


def test_a_component_without_a_fixed_node_is_refused() -> None:
    nodes, edges, Z, information, _ = random_graph(1)
    two = np.vstack([nodes, nodes])
    with pytest.raises(PoseGraphError, match="node 12 is tied to no fixed node"):
        optimise(
            two,
            np.vstack([edges, edges + len(nodes)]),
            np.vstack([Z, Z]),
            np.concatenate([information, information]),
            fix_first(two),
        )


@pytest.mark.parametrize(
    ("edges", "message"),
    [([[0, 9]], "outside"), ([[-1, 0]], "outside"), ([[1, 1]], "itself"), ([[0, 1, 2]], "k×2")],
)
def test_edges_that_make_no_sense_are_refused(edges: Any, message: str) -> None:
    nodes = np.zeros((3, 3))
    with pytest.raises(PoseGraphError, match=message):
        optimise(nodes, np.array(edges), np.zeros((1, 3)), np.eye(3)[None], np.ones(3, dtype=bool))


def test_a_wrong_closure_is_outvoted() -> None:
    nodes, edges, Z, information, truth = random_graph(4, noise=0.01)
    information = 400.0 * information
    edges = np.vstack([edges, [[0, len(nodes) - 1]]])
    Z = np.vstack([Z, [[25.0, -13.0, 2.0]]])
    information = np.concatenate([information, 3.0 * np.eye(3)[None]])
    robust = np.zeros(len(edges), dtype=bool)
    robust[-1] = True
    solution = optimise(nodes, edges, Z, information, fix_first(nodes), robust)
    assert np.hypot(*(solution.nodes - truth)[:, :2].T).max() < 0.1
    assert squared_errors(solution.nodes, edges, Z, information)[-1] > 100.0


def test_nothing_to_do_is_done() -> None:
    nodes = np.array([[1.0, 2.0, 0.5]])
    empty = np.empty((0, 2), dtype=int)
    solution = optimise(nodes, empty, np.empty((0, 3)), np.empty((0, 3, 3)), np.array([True]))
    assert solution.converged
    assert np.array_equal(solution.nodes, nodes)


def test_read_only_arrays_are_welcome_and_left_alone() -> None:
    nodes, edges, Z, information, _ = random_graph(2)
    for array in (nodes, edges, Z, information):
        array.setflags(write=False)
    before = nodes.copy()
    optimise(nodes, edges, Z, information, fix_first(nodes))
    assert np.array_equal(nodes, before)


def test_the_marginal_covariance_is_the_inverse_of_the_whole() -> None:
    nodes, edges, Z, information, _ = random_graph(5)
    fixed = fix_first(nodes)
    solved = optimise(nodes, edges, Z, information, fixed).nodes
    problem = NormalEquations(solved, edges, Z, information, fixed, None, 9.0)

    def whitened(x: FloatArray) -> FloatArray:
        return residuals(problem.retract(solved, x.reshape(-1, 3)), edges, Z, information)

    h = 1e-6
    columns = [
        (whitened(h * unit) - whitened(-h * unit)) / (2.0 * h) for unit in np.eye(problem.size)
    ]
    J = np.stack(columns, axis=-1)
    inverse = np.linalg.inv(J.T @ J)
    got = marginal_covariance(solved, edges, Z, information, fixed, 4)
    at = 3 * problem.blocks[4] + np.arange(3)
    assert np.allclose(got, inverse[np.ix_(at, at)], rtol=1e-4, atol=1e-6)
    assert not marginal_covariance(solved, edges, Z, information, fixed, 0).any()


def test_a_chain_adds_its_covariances_up() -> None:
    """Two edges in a row: the second's error and the first's, carried to the second node."""
    Z = np.array([[1.0, 0.5, 0.3], [2.0, 0.0, -0.4]])
    nodes = np.zeros((3, 3))
    nodes[1] = Z[0]
    nodes[2] = compose(Z[0], Z[1])
    C = [np.diag([0.01, 0.02, 0.001]), np.diag([0.02, 0.01, 0.003])]
    information = np.linalg.inv(np.array(C))
    backward = Pose2.from_array(Z[1]).inverse().adjoint()
    got = marginal_covariance(
        nodes, np.array([[0, 1], [1, 2]]), Z, information, fix_first(nodes), 2
    )
    assert np.allclose(got, backward @ C[0] @ backward.T + C[1], rtol=1e-6)
