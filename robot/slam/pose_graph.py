"""Sparse pose graph optimisation on SE(2).

Nodes are poses, edges are measured relative poses with information matrices. The sum of eᵀΩe with
e = measurement⁻¹ ∘ node_i⁻¹ ∘ node_j (as x, y, θ: g2o's and GTSAM's form) is minimised by
Gauss-Newton (Grisetti, Kümmerle, Stachniss, Burgard, "A tutorial on graph-based SLAM", 2010), in a
sparse pattern that is built once. Where a step does not help, its headings are kept and the
positions solved for: they are linear then, and what a long lever makes of a turn no longer counts
against it (variable projection; Golub and Pereyra 1973). Where that does not help either, the next
step is damped after Levenberg and Marquardt.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from protocol.pose import FloatArray
from robot.slam import edge_kernels
from robot.slam.normal_equations import NormalEquations, PoseGraphError, floats, integers

MAX_ITERATIONS = 100
# A step that lowers the cost by less than this share of it, or moves less than this, is the last.
COST_TOLERANCE = 1e-7
STEP_TOLERANCE = 1e-7
# The first damping that is tried when a plain Gauss-Newton step makes things worse.
FIRST_DAMPING = 1e-4
MAX_DAMPING = 1e8
# c² of the Cauchy kernel: an edge this far off (eᵀΩe) counts half.
CAUCHY_SQUARED = 9.0

__all__ = [
    "PoseGraphError",
    "Solution",
    "marginal_covariance",
    "minimise",
    "optimise",
    "squared_errors",
]


@dataclass(frozen=True, slots=True)
class Solution:
    """Optimised nodes (m×3). `chi2` is Σ eᵀΩe without robust kernel, `cost` with it."""

    nodes: FloatArray
    chi2: float
    cost: float
    iterations: int
    converged: bool


def optimise(
    nodes: FloatArray,
    edge_nodes: npt.NDArray[np.integer],
    measurements: FloatArray,
    information: FloatArray,
    fixed: npt.NDArray[np.bool_],
    robust: npt.NDArray[np.bool_] | None = None,
    max_iterations: int = MAX_ITERATIONS,
    cauchy_squared: float = CAUCHY_SQUARED,
) -> Solution:
    """Minimise over the free nodes, from where they are.

    `nodes` m×3, `edge_nodes` k×2, `measurements` k×3 (`T_i_j`), `information` k×3×3, `fixed` m,
    `robust` k: which edges count by Cauchy's kernel. Several components may be solved at once; each
    needs a fixed node. Raises PoseGraphError when one has none, or when the arrays do not fit.
    """
    problem = NormalEquations(
        nodes, edge_nodes, measurements, information, fixed, robust, cauchy_squared
    )
    return minimise(problem, problem.nodes, max_iterations)


def minimise(
    problem: NormalEquations, nodes: FloatArray, max_iterations: int = MAX_ITERATIONS
) -> Solution:
    """Minimise a problem whose pattern stands, from `nodes` (m×3)."""
    if problem.size == 0 or len(problem.edge_nodes) == 0:
        chi2 = problem.chi2(nodes)
        return Solution(nodes, chi2, chi2, 0, True)
    current, cost = nodes, problem.linearise(nodes)
    damping, iterations, converged = 0.0, 0, False
    while iterations < max_iterations and damping < MAX_DAMPING:
        iterations += 1
        step = problem.solve(damping)
        if step is None:
            candidate, new_cost, still = current, np.inf, False
        else:
            candidate = problem.retract(current, step)
            new_cost, still = problem.linearise(candidate), np.abs(step).max() < STEP_TOLERANCE
            if new_cost > cost and not problem.is_robust:
                candidate = problem.place(candidate)
                new_cost = problem.linearise(candidate)
        if not new_cost <= cost * (1.0 + 1e-12):
            converged = bool(still) and damping == 0.0
            if converged:  # what is left to gain is lost in rounding
                break
            damping = max(FIRST_DAMPING, damping * 10.0)
            problem.linearise(current)
            continue
        converged = bool(still) or cost - new_cost <= COST_TOLERANCE * cost
        current, cost = candidate, new_cost
        if converged and damping <= FIRST_DAMPING:
            break
        damping = 0.0 if damping <= FIRST_DAMPING else damping * 0.1
    return Solution(current, problem.chi2(current), cost, iterations, converged)


def marginal_covariance(
    nodes: FloatArray,
    edge_nodes: npt.NDArray[np.integer],
    measurements: FloatArray,
    information: FloatArray,
    fixed: npt.NDArray[np.bool_],
    node: int,
    robust: npt.NDArray[np.bool_] | None = None,
) -> FloatArray:
    """Covariance (3×3, tangent space at the node) of one node against the fixed ones."""
    problem = NormalEquations(
        nodes, edge_nodes, measurements, information, fixed, robust, CAUCHY_SQUARED
    )
    problem.linearise(problem.nodes)
    problem.factorise()
    return problem.covariance(node)


def squared_errors(
    nodes: FloatArray,
    edge_nodes: npt.NDArray[np.integer],
    measurements: FloatArray,
    information: FloatArray,
) -> FloatArray:
    """eᵀΩe (k) of every edge: how far each is from what the nodes say, in squared σ."""
    out = np.empty(len(edge_nodes))
    edge_kernels.squared_errors(
        floats(nodes), integers(edge_nodes), floats(measurements), floats(information), out
    )
    return out
