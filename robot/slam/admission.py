"""Pose graph optimisation among false edges: edges are let in as the graph comes to expect them.

What is minimised is Σ min(eᵀΩe, c²) over the doubted edges plus Σ eᵀΩe over the others. Relaxations
of it (graduated non-convexity, Yang et al. 2020) start from all edges at once, and false ones bend
that start. Here it is searched from the other side. First stand the trusted edges and those that
others vote for (`votes`). Then, round by round, the graph says what it expects of every doubted
edge: an innovation e with covariance S = J H⁻¹ Jᵀ + Ω⁻¹. Edges that lower the cost, eᵀS⁻¹e < c²,
are let in: all that are foreseen about as surely as they are measured or are likely by far, else
those (where hardly any were voted for: the one) most likely by N(e; 0, S). Edges within are judged
as if they were not there, S = Ω⁻¹ − J H⁻¹ Jᵀ, and leave when the others contradict them.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from protocol.pose import FloatArray
from robot.slam import consistency_kernels, kernels
from robot.slam.chordal import chordal_start
from robot.slam.normal_equations import IntArray, NormalEquations, PoseGraphError, floats, integers
from robot.slam.pose_graph import Solution, minimise, squared_errors
from robot.slam.votes import room_of, vote

BoolArray = npt.NDArray[np.bool_]

# c²: χ² with three degrees of freedom stays below it with a probability of 99.9 %.
TRUNCATION = 16.27
# Log odds from which votes let an edge in at once: a thousand to one.
ELECTED = math.log(1000.0)
LIKELY = math.log(30.0)
LOG_2PI = math.log(2.0 * math.pi)
# An edge is foreseen about as surely as it is measured while S is up to this many times Ω⁻¹ in
# volume (m² rad).
CLEAR_RATIO = 4.5
# So few edges stay in the pattern while they are doubted: long false ones would fill the factor.
FEW = 64
# An edge within is told to leave when the others put it this many times farther off than c². By c²
# alone a true one in a few hundred would go, and what hangs on it with it.
LEAVING = 2.5
# An edge that hardly anybody else supports leaves nothing of Ω⁻¹ − J H⁻¹ Jᵀ, and what little error
# it has is no contradiction: this share of Ω⁻¹ is added.
ALONE = 0.1
MAX_ROUNDS = 60
ROUND_ITERATIONS = 8


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
    truncation: float = TRUNCATION,
) -> RobustSolution:
    """Minimise as `optimise` does, while deciding which of the `doubted` edges (k) count.

    Nodes are numbered in time. Raises PoseGraphError as `optimise` does, and when the other edges
    do not hold all nodes.
    """
    search = _Search(nodes, edge_nodes, measurements, information, fixed, doubted, truncation)
    best = search.state()
    seen = {search.accepted.tobytes()}
    for _ in range(MAX_ROUNDS):
        flips = search.flips()
        if len(flips) == 0:
            break
        search.flip(flips)
        if search.accepted.tobytes() in seen:
            break
        seen.add(search.accepted.tobytes())
        if search.cost < best[0]:
            best = search.state()
    _, accepted, reached = best
    problem = search.problem_of(accepted)
    last = minimise(problem, reached)
    iterations = search.iterations + last.iterations
    return RobustSolution(
        Solution(last.nodes, last.chi2, last.cost, iterations, last.converged), accepted
    )


class _Search:
    """Which edges are in, and the solution with them."""

    def __init__(
        self,
        nodes: FloatArray,
        edge_nodes: npt.NDArray[np.integer],
        measurements: FloatArray,
        information: FloatArray,
        fixed: BoolArray,
        doubted: BoolArray,
        truncation: float,
    ) -> None:
        self._edges = integers(edge_nodes)
        self._measured, self._information = floats(measurements), floats(information)
        self._fixed = np.asarray(fixed, dtype=bool)
        self._doubted: IntArray = np.flatnonzero(doubted)
        self._truncation = truncation
        _check_held(len(nodes), self._edges[~np.asarray(doubted, dtype=bool)], self._fixed)
        covariances = floats(np.linalg.inv(self._information))
        self._covariances = covariances[self._doubted]
        self._volumes = np.sqrt(np.linalg.det(self._covariances))
        self._log_room = math.log(room_of(self._measured[self._doubted])) - 1.5 * LOG_2PI
        odds = vote(
            nodes, self._edges, self._measured, covariances, np.asarray(doubted), truncation
        )
        self._odds = odds[self._doubted]
        # Where most are spoken for, one that nobody speaks for and hardly foreseen is false.
        self._alone = 2 * int((self._odds > ELECTED).sum()) < len(self._odds)
        self.accepted: BoolArray = ~np.asarray(doubted, dtype=bool) | (odds > ELECTED)
        self.iterations = 0
        self.nodes = floats(nodes)
        self.cost = math.inf
        self._whole: NormalEquations | None = None
        self._problem = self.problem_of(self.accepted)
        self._resolve()

    def state(self) -> tuple[float, BoolArray, FloatArray]:
        return self.cost, self.accepted.copy(), self.nodes

    def flips(self) -> IntArray:
        """The doubted edges that should change sides next; none when all are content."""
        inside: BoolArray = self.accepted[self._doubted]
        distances, volumes = self._foreseen(inside)
        into = ~inside & (distances < self._truncation)
        evidence = self._odds - 0.5 * distances - np.log(np.maximum(volumes, 1e-300))
        evidence += self._log_room
        clear = into & ((volumes <= CLEAR_RATIO * self._volumes) | (evidence > ELECTED))
        if clear.any():
            return self._which(clear)
        against = distances - 2.0 * np.maximum(self._odds, 0.0)
        out = inside & (against > LEAVING * self._truncation)
        if out.any():
            return self._which(out & (against >= 0.5 * against[out].max()))
        likely = into & ((evidence > LIKELY) | self._alone)
        if likely.any() and self._alone:
            likely &= evidence >= evidence[likely].max()
        return self._which(likely)

    def _which(self, chosen: BoolArray) -> IntArray:
        return np.asarray(self._doubted[chosen], dtype=np.int64)

    def flip(self, edges: IntArray) -> None:
        self.accepted[edges] = ~self.accepted[edges]
        self._resolve()

    def problem_of(self, accepted: BoolArray) -> NormalEquations:
        """The graph of the accepted edges alone."""
        return NormalEquations(
            self.nodes,
            self._edges[accepted],
            self._measured[accepted],
            self._information[accepted],
            self._fixed,
            None,
            1.0,
        )

    def _resolve(self) -> None:
        """Solve with the edges that are in, from where the nodes are or from a chordal start."""
        self._take_problem()
        # The chordal start first: where a false edge bent the nodes, they may not find back.
        solution = minimise(self._problem, chordal_start(self._problem), ROUND_ITERATIONS)
        self.iterations += solution.iterations
        if self._problem.chi2(self.nodes) < solution.chi2:
            solution = minimise(self._problem, self.nodes, ROUND_ITERATIONS)
            self.iterations += solution.iterations
        self.nodes = solution.nodes
        refused = int((~self.accepted).sum())
        self.cost = solution.chi2 + self._truncation * refused

    def _take_problem(self) -> None:
        """Set the weights of the pattern of all edges while few are refused, else make one."""
        if int((~self.accepted).sum()) > FEW:
            self._problem = self.problem_of(self.accepted)
            return
        if self._whole is None:
            self._whole = self.problem_of(np.ones(len(self.accepted), dtype=bool))
        self._problem = self._whole
        self._problem.weights[:] = self.accepted

    def _foreseen(self, inside: BoolArray) -> tuple[FloatArray, FloatArray]:
        """eᵀS⁻¹e and √det S of every doubted edge, from what the others say of it."""
        self._problem.linearise(self.nodes)
        self._problem.factorise()
        ends, measured = self._edges[self._doubted], self._measured[self._doubted]
        near = squared_errors(self.nodes, ends, measured, self._information[self._doubted])
        # An edge that fits so well could not be told to leave (see ALONE).
        wanted = ~inside | (near > ALONE * self._truncation)
        errors, spreads = self._problem.innovations(self.nodes, ends, measured, wanted)
        sign = np.where(inside, -1.0, 1.0)[:, None, None]
        covariances = (1.0 + ALONE * inside[:, None, None]) * self._covariances + sign * spreads
        volumes, distances = np.empty(len(errors)), np.empty(len(errors))
        consistency_kernels.volume_and_distance(covariances, errors, volumes, distances)
        return distances, volumes


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
