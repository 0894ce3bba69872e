"""Pose graph optimisation among false edges: graduated non-convexity with truncated squares.

Yang, Antonante, Tzoumas, Carlone, "Graduated non-convexity for robust spatial perception: from
non-minimal solvers to global outlier rejection", 2020, eq. 14. Edges that may be false get a
weight between 0 and 1; the surrogate cost starts convex, so that no edge is judged before all have
been heard, and becomes Σ min(eᵀΩe, c²).
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from protocol.pose import FloatArray
from robot.slam import kernels
from robot.slam.normal_equations import PoseGraphError, integers
from robot.slam.pose_graph import Solution, optimise, squared_errors

# c²: χ² with three degrees of freedom stays below it with a probability of 99.9 %.
TRUNCATION = 16.27
GROWTH = 1.4
MAX_ROUNDS = 100
STEPS_A_ROUND = 3
# An edge is wholly in or out when all weights are this close to 1 or 0.
DECIDED = 1e-3


@dataclass(frozen=True, slots=True)
class RobustSolution:
    """`weights` (k): 1 for every edge that counts, 0 for those found false. `solution.chi2` is over
    the edges that count."""

    solution: Solution
    weights: FloatArray


def optimise_graduated(
    nodes: FloatArray,
    edge_nodes: npt.NDArray[np.integer],
    measurements: FloatArray,
    information: FloatArray,
    fixed: npt.NDArray[np.bool_],
    doubted: npt.NDArray[np.bool_],
    truncation: float = TRUNCATION,
) -> RobustSolution:
    """Minimise as `optimise` does, while deciding which of the `doubted` edges (k) count.

    Raises PoseGraphError as `optimise` does, and when the other edges do not hold all nodes.
    """
    doubted = np.asarray(doubted, dtype=bool)
    _check_held(len(nodes), np.asarray(edge_nodes)[~doubted], np.asarray(fixed, dtype=bool))
    weights = np.ones(len(doubted))
    iterations = 0

    def solve(start: FloatArray, steps: int) -> Solution:
        nonlocal iterations
        # Refused edges are left out altogether: long false ones would fill the factors.
        kept = weights > 0.0
        scaled = information[kept] * weights[kept][:, None, None]
        solution = optimise(
            start, edge_nodes[kept], measurements[kept], scaled, fixed, max_iterations=steps
        )
        iterations += solution.iterations
        return solution

    current = np.array(nodes, dtype=np.float64)
    errors = squared_errors(current, edge_nodes, measurements, information)[doubted]
    worst = float(errors.max(initial=0.0))
    mu = truncation / max(2.0 * worst - truncation, 1e-12)
    for _ in range(MAX_ROUNDS):
        if worst <= truncation:
            break
        weights[doubted] = _weights(errors, mu, truncation)
        current = solve(current, STEPS_A_ROUND).nodes
        errors = squared_errors(current, edge_nodes, measurements, information)[doubted]
        undecided = np.minimum(weights[doubted], 1.0 - weights[doubted])
        if mu >= 1.0 and undecided.max(initial=0.0) < DECIDED:
            break
        mu *= GROWTH
    weights[doubted] = (errors <= truncation).astype(np.float64)
    last = solve(current, 50)
    return RobustSolution(
        Solution(last.nodes, last.chi2, last.cost, iterations, last.converged), weights
    )


def _check_held(
    count: int, sure_edges: npt.NDArray[np.integer], fixed: npt.NDArray[np.bool_]
) -> None:
    labels = kernels.label_components(count, integers(sure_edges).reshape(-1, 2))
    loose = np.flatnonzero(~np.isin(labels, labels[fixed]))
    if len(loose):
        raise PoseGraphError(
            f"only doubted edges tie node {loose[0]} to a fixed one; were they refused it would "
            "stand nowhere: trust one of them"
        )


def _weights(errors: FloatArray, mu: float, truncation: float) -> FloatArray:
    """The weights (k) that belong to squared errors at one stage of the surrogate."""
    surely_in, surely_out = mu / (mu + 1.0) * truncation, (mu + 1.0) / mu * truncation
    between = np.sqrt(truncation * mu * (mu + 1.0) / np.maximum(errors, 1e-12)) - mu
    out = np.where(errors <= surely_in, 1.0, np.where(errors >= surely_out, 0.0, between))
    return np.asarray(np.clip(out, 0.0, 1.0), dtype=np.float64)
