"""Pose graph optimisation among false edges: edges are let in as the graph comes to expect them.

What is minimised is Σ min(eᵀΩe, c²) over the doubted edges plus Σ eᵀΩe over the others. Relaxations
of it (graduated non-convexity, Yang et al. 2020) start from all edges at once, and false ones bend
that start. Here it is searched from the other side. First stand the trusted edges and those that
others vote for (`votes`). Then, round by round, the graph says what it expects of every doubted
edge: an innovation e with covariance S = J H⁻¹ Jᵀ + Ω⁻¹. Edges that lower the cost, eᵀS⁻¹e < c²,
are let in: all that are foreseen about as surely as they are measured or are likely by far, else
those that are likely by N(e; 0, S). Where hardly any were voted for the likeliest are guessed: one,
and twice as many each time while χ² grows as foreseen. Edges within are judged as if they were not
there, S = Ω⁻¹ − J H⁻¹ Jᵀ, and leave when the others contradict them. Of few edges the search takes
those turns again after which several were shut out, the likeliest of these first.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import chdtri

from protocol.pose import FloatArray
from robot.slam.admission_search import Search
from robot.slam.normal_equations import BoolArray
from robot.slam.pose_graph import Solution, minimise

# c² is such that of all doubted edges, were they true, so many are expected beyond it by chance.
LOST_BY_CHANCE = 0.001
# Where the variance that is seen is less than this share of the claimed one it counts instead.
WORTH_IT = 0.5


@dataclass(frozen=True, slots=True)
class RobustSolution:
    """`accepted` (k): which edges count. `solution.chi2` is over those."""

    solution: Solution
    accepted: BoolArray


def optimise_admitting(
    nodes: FloatArray,
    edge_nodes: npt.NDArray[np.integer],
    measurements: FloatArray,
    information: FloatArray,
    fixed: BoolArray,
    doubted: BoolArray,
    truncation: float | None = None,
) -> RobustSolution:
    """Minimise as `optimise` does, while deciding which of the `doubted` edges (k) count.

    Nodes are numbered in time. Raises PoseGraphError as `optimise` does, and when the other edges
    do not hold all nodes.
    """
    if truncation is None:
        truncation = float(chdtri(3, LOST_BY_CHANCE / max(int(np.count_nonzero(doubted)), 1)))
    search = Search(nodes, edge_nodes, measurements, information, fixed, doubted, truncation)
    spread, iterations = search.spread(), 0
    if spread < WORTH_IT:
        iterations, claimed = search.iterations, np.asarray(information) / spread
        search = Search(nodes, edge_nodes, measurements, claimed, fixed, doubted, truncation)
    else:
        spread = 1.0
    best = search.again(search.run())
    last = minimise(search.problem_of(best.accepted), best.nodes)
    iterations += search.iterations + last.iterations
    chi2 = spread * last.chi2
    return RobustSolution(
        Solution(last.nodes, chi2, chi2, iterations, last.converged), best.accepted
    )
