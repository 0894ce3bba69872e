"""Starts that need no start, and optimisation among false edges."""

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol.pose import FloatArray, compose, invert
from robot.slam import chordal
from robot.slam.admission import optimise_admitting
from robot.slam.normal_equations import NormalEquations
from robot.slam.pose_graph import PoseGraphError, optimise


def ring(
    count: int, seed: int, noise: float
) -> tuple[FloatArray, npt.NDArray[np.int64], FloatArray, FloatArray]:
    """Three laps on a circle: true nodes, edges (consecutive, and one lap apart), measurements,
    information."""
    rng = np.random.default_rng(seed)
    angle = np.linspace(0.0, 6.0 * np.pi, count, endpoint=False)
    heading = (angle + 0.5 * np.pi + np.pi) % (2 * np.pi) - np.pi
    nodes = np.column_stack([5.0 * np.cos(angle), 5.0 * np.sin(angle), heading])
    nodes = compose(invert(nodes[0]), nodes)
    lap = count // 3
    steps = [(i, i + 1) for i in range(count - 1)]
    closures = [(i, i + lap) for i in range(0, count - lap, 2)]
    edges = np.array(steps + closures)
    measured = compose(invert(nodes[edges[:, 0]]), nodes[edges[:, 1]])
    measured = measured + noise * rng.standard_normal(measured.shape)
    information = np.tile(np.eye(3) / max(noise, 1e-2) ** 2, (len(edges), 1, 1))
    return nodes, edges, measured, information


def chordal_start(
    nodes: FloatArray,
    edges: npt.NDArray[np.int64],
    measured: FloatArray,
    information: FloatArray,
    fixed: npt.NDArray[np.bool_],
) -> FloatArray:
    return chordal.chordal_start(
        NormalEquations(nodes, edges, measured, information, fixed, None, 1.0)
    )


def first_fixed(count: int) -> npt.NDArray[np.bool_]:
    return np.asarray(np.arange(count) == 0)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 1000))
def test_exact_measurements_give_the_exact_graph_from_nothing(seed: int) -> None:
    nodes, edges, measured, information = ring(30, seed, 0.0)
    start = np.random.default_rng(seed).uniform(-3, 3, nodes.shape)
    start[0] = nodes[0]
    found = chordal_start(start, edges, measured, information, first_fixed(30))
    np.testing.assert_allclose(found[:, :2], nodes[:, :2], atol=1e-5)
    np.testing.assert_allclose(np.cos(found[:, 2] - nodes[:, 2]), 1.0, atol=1e-9)


def test_it_leads_where_the_true_nodes_lead() -> None:
    nodes, edges, measured, information = ring(60, 3, 0.05)
    fixed = first_fixed(60)
    found = chordal_start(np.zeros_like(nodes), edges, measured, information, fixed)
    by_truth = optimise(nodes, edges, measured, information, fixed)
    by_start = optimise(found, edges, measured, information, fixed)
    assert by_start.converged
    assert by_start.chi2 == pytest.approx(by_truth.chi2, rel=1e-5)


@pytest.mark.parametrize("seed", range(3))
def test_a_valley_that_turns_is_followed_to_its_end(seed: int) -> None:
    """Sure of places, unsure of headings: what a step turns it must also move, along an arc."""
    nodes, edges, measured, information = ring(90, seed, 0.01)
    measured[:, 2] += 0.2 * np.random.default_rng(2).standard_normal(len(edges))
    information[:] = np.diag([1e4, 1e4, 25.0])
    fixed = first_fixed(90)
    start = chordal_start(nodes, edges, measured, information, fixed)
    by_start = optimise(start, edges, measured, information, fixed)
    by_truth = optimise(nodes, edges, measured, information, fixed)
    assert by_start.converged
    assert by_truth.converged
    assert by_start.chi2 == pytest.approx(by_truth.chi2, rel=1e-4)


def test_a_chain_is_at_its_optimum() -> None:
    nodes, edges, measured, information = ring(30, 1, 0.02)
    steps = slice(0, 29)
    start = [nodes[0]]
    for step in measured[steps]:
        start.append(compose(start[-1], step))
    found = optimise(
        np.array(start), edges[steps], measured[steps], information[steps], first_fixed(30)
    )
    assert found.converged
    assert found.iterations == 1
    assert found.chi2 < 1e-20


def test_fixed_nodes_stay_and_nothing_to_do_is_done() -> None:
    nodes, edges, measured, information = ring(12, 0, 0.02)
    fixed = np.zeros(12, dtype=bool)
    fixed[[0, 7]] = True
    found = chordal_start(nodes, edges, measured, information, fixed)
    np.testing.assert_array_equal(found[fixed], nodes[fixed])
    same = chordal_start(nodes, edges, measured, information, np.ones(12, dtype=bool))
    np.testing.assert_array_equal(same, nodes)


@pytest.mark.parametrize("seed", range(4))
def test_false_edges_are_refused_and_true_ones_kept(seed: int) -> None:
    nodes, edges, measured, information = ring(60, seed, 0.02)
    rng = np.random.default_rng(seed)
    false = np.column_stack([rng.integers(0, 20, 9), rng.integers(25, 60, 9)])
    wrong = np.column_stack([rng.uniform(3, 9, (9, 2)), rng.uniform(-3, 3, 9)])
    all_edges, all_measured = np.vstack([edges, false]), np.vstack([measured, wrong])
    all_information = np.concatenate([information, information[:9]])
    doubted = np.arange(len(all_edges)) >= 59
    start = [nodes[0]]
    for step in measured[:59]:
        start.append(compose(start[-1], step))
    found = optimise_admitting(
        np.array(start), all_edges, all_measured, all_information, first_fixed(60), doubted
    )
    clean = optimise(nodes, edges, measured, information, first_fixed(60))
    assert not found.accepted[-9:].any()
    assert found.accepted[:-9].mean() > 0.98
    assert found.solution.converged
    apart = found.solution.nodes[:, :2] - clean.nodes[:, :2]
    assert np.hypot(*apart.T).max() < 0.02


def test_a_node_that_hangs_on_doubted_edges_alone_is_refused() -> None:
    nodes, edges, measured, information = ring(12, 0, 0.02)
    doubted = np.arange(len(edges)) == 3
    with pytest.raises(PoseGraphError, match="only doubted edges tie node 4"):
        optimise_admitting(
            nodes, edges[:11], measured[:11], information[:11], first_fixed(12), doubted[:11]
        )


@pytest.mark.parametrize("seed", range(3))
def test_isolated_closures_are_found_where_odometry_is_poor(seed: int) -> None:
    """Every fourth closure alone, so that nobody votes: the likeliest come in one by one."""
    nodes, edges, measured, information = ring(90, seed, 0.03)
    kept = np.concatenate([np.arange(89), np.arange(89, len(edges), 15)])
    edges, measured, information = edges[kept], measured[kept], information[kept]
    rng = np.random.default_rng(seed)
    false = np.array([[3, 40], [10, 77], [35, 88]])
    all_edges = np.vstack([edges, false])
    wrong = np.column_stack([rng.uniform(-4, 4, (3, 2)), rng.uniform(-3, 3, 3)])
    all_measured = np.vstack([measured, wrong])
    all_information = np.concatenate([information, information[:3]])
    doubted = np.arange(len(all_edges)) >= 89
    found = optimise_admitting(
        nodes, all_edges, all_measured, all_information, first_fixed(90), doubted
    )
    np.testing.assert_array_equal(found.accepted, np.arange(len(all_edges)) < len(edges))


def test_nothing_doubted_is_plain_least_squares() -> None:
    nodes, edges, measured, information = ring(30, 1, 0.02)
    found = optimise_admitting(
        nodes, edges, measured, information, first_fixed(30), np.zeros(len(edges), dtype=bool)
    )
    plain = optimise(nodes, edges, measured, information, first_fixed(30))
    assert found.accepted.all()
    assert found.solution.chi2 == pytest.approx(plain.chi2, rel=1e-6)


def test_a_false_edge_that_came_in_first_is_found_out() -> None:
    """A long way, hardly any closures, and a false one nearer to what the odometry expects than
    three true ones that are right together."""
    nodes, edges, measured, information = ring(90, 5, 0.05)
    steps, ends = np.arange(89), np.array([[0, 60], [4, 64], [8, 68], [2, 32], [31, 62]])
    true = compose(invert(nodes[ends[:, 0]]), nodes[ends[:, 1]])
    false_ends, false = np.array([[1, 61]]), np.array([[0.3, 1.8, -0.35]])
    found = optimise_admitting(
        nodes,
        np.vstack([edges[steps], ends, false_ends]),
        np.vstack([measured[steps], true, false]),
        np.concatenate([information[steps], np.tile(1e4 * np.eye(3), (6, 1, 1))]),
        first_fixed(90),
        np.arange(95) >= 89,
    )
    np.testing.assert_array_equal(found.accepted[89:], [True] * 5 + [False])


@pytest.mark.parametrize("seed", range(2))
def test_many_lone_closures_come_in_by_and_by(seed: int) -> None:
    """A thousand steps with a closure every tenth: guesses that double need few rounds."""
    nodes, edges, measured, information = ring(600, seed, 0.02)
    kept = np.concatenate([np.arange(599), np.arange(599, len(edges), 10)])
    edges, measured, information = edges[kept], measured[kept], information[kept]
    rng = np.random.default_rng(seed)
    count = len(edges) - 599
    false = np.sort(rng.choice(600, (count // 2, 2)), axis=1) + np.array([0, 1])
    false = np.minimum(false, 599)
    false = false[false[:, 0] < false[:, 1]]
    wrong = np.column_stack([rng.uniform(-8, 8, (len(false), 2)), rng.uniform(-3, 3, len(false))])
    all_edges, all_measured = np.vstack([edges, false]), np.vstack([measured, wrong])
    all_information = np.concatenate([information, information[: len(false)]])
    found = optimise_admitting(
        nodes,
        all_edges,
        all_measured,
        all_information,
        first_fixed(600),
        np.arange(len(all_edges)) >= 599,
    )
    np.testing.assert_array_equal(found.accepted, np.arange(len(all_edges)) < len(edges))
