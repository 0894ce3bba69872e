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

from protocol.pose import FloatArray, compose, invert
from robot.slam import chain_kernels, consistency_kernels
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
# An edge within is told to leave when the others put it this many times farther off than c². By c²
# alone a true one in a few hundred would go, and what hangs on it with it.
LEAVING = 2.5
# An edge that hardly anybody else supports leaves nothing of Ω⁻¹ − J H⁻¹ Jᵀ, and what little error
# it has is no contradiction: this share of Ω⁻¹ is added.
ALONE = 0.1
# Some graphs claim far less of their edges than these keep. Where the variance that is seen, raised
# by so much for the tails, is less than this share of the claimed one, it is what edges are judged
# by. It is seen in all but the worst, together with so many errors of the claimed size.
TAILS = 5.0
WORTH_IT = 0.7
TRIMMED = 0.99
CLAIMED_ERRORS = 30.0
# So few doubted edges are in the pattern from the beginning.
FEW = 64
MAX_ROUNDS = 60
ROUND_ITERATIONS = 8
# From where the nodes are, when what comes in is foreseen.
WARM_ITERATIONS = 3


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
    spread, iterations = search.spread(), 0
    if spread < WORTH_IT:
        iterations, claimed = search.iterations, np.asarray(information) / spread
        search = _Search(nodes, edge_nodes, measurements, claimed, fixed, doubted, truncation)
    else:
        spread = 1.0
    best = search.state()
    seen = {search.accepted.tobytes()}
    for _ in range(MAX_ROUNDS):
        flips = search.flips()
        if len(flips.edges) == 0:
            break
        search.flip(flips)
        if search.accepted.tobytes() in seen:
            break
        seen.add(search.accepted.tobytes())
        if search.cost < best.cost:
            best = search.state()
    last = minimise(search.problem_of(best.accepted), best.nodes)
    iterations += search.iterations + last.iterations
    chi2 = spread * last.chi2
    return RobustSolution(
        Solution(last.nodes, chi2, chi2, iterations, last.converged), best.accepted
    )


@dataclass(frozen=True, slots=True)
class _State:
    """Where a search stands: which edges (k) are in, the nodes (m×3) with them, and the cost."""

    cost: float
    accepted: BoolArray
    nodes: FloatArray


@dataclass(frozen=True, slots=True)
class _Flips:
    """Edges that should change sides, and by how much χ² is foreseen to grow; `others` (k): edges
    that may follow."""

    edges: IntArray
    growth: float
    others: BoolArray


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
        few = len(self._doubted) <= FEW
        self._held = np.ones_like(self.accepted) if few else self.accepted.copy()
        self._problem = self._pattern_of(self._held)
        self._bounds = np.empty((len(self._doubted), 3, 3))
        """What S was at last: without an edge less it only shrinks."""
        self._forget_bounds()
        self._chi2 = self._resolve()

    @property
    def cost(self) -> float:
        return self._chi2 + self._truncation * int((~self.accepted).sum())

    def spread(self) -> float:
        """The variance that the edges within show, as a share of what they claim."""
        kept = self.accepted
        squared = np.sort(
            squared_errors(
                self.nodes, self._edges[kept], self._measured[kept], self._information[kept]
            )
        )
        seen = float(squared[: math.ceil(TRIMMED * len(squared))].sum())
        redundancy = max(3 * len(squared) - self._problem.size, 0)
        return TAILS * (seen + CLAIMED_ERRORS) / (redundancy + CLAIMED_ERRORS)

    def state(self) -> _State:
        return _State(self.cost, self.accepted.copy(), self.nodes)

    def flips(self) -> _Flips:
        """The doubted edges that should change sides next; none when all are content."""
        self._problem.linearise(self.nodes)
        self._problem.factorise()
        inside: BoolArray = self.accepted[self._doubted]
        distances, volumes = self._foreseen(~inside & ~self._hopeless(), 1.0, 1.0)
        into = distances < self._truncation
        evidence = self._odds - 0.5 * distances - np.log(volumes) + self._log_room
        clear = into & ((volumes <= CLEAR_RATIO * self._volumes) | (evidence > ELECTED))
        if clear.any():
            return self._flips(clear, distances[clear].sum(), into)
        out = self._contradicted(inside)
        if out.any():
            return self._flips(out, -math.inf, into)
        likely = into & ((evidence > LIKELY) | self._alone)
        if likely.any() and self._alone:
            likely &= evidence >= evidence[likely].max()
        return self._flips(likely, distances[likely].sum(), into)

    def flip(self, flips: _Flips) -> None:
        """Change sides, and solve anew."""
        self.accepted[flips.edges] = ~self.accepted[flips.edges]
        if not self._held[self.accepted].all():
            self._held = self.accepted | flips.others
            self._problem = self._pattern_of(self._held)
        if flips.growth == -math.inf:
            self._forget_bounds()
        self._chi2 = self._resolve(self._chi2 + flips.growth)

    def problem_of(self, accepted: BoolArray) -> NormalEquations:
        """The graph of some edges, all of which have been in at once or another time."""
        if not self._held[accepted].all():
            self._held = accepted
            self._problem = self._pattern_of(accepted)
        self._problem.weights[:] = accepted[self._held]
        return self._problem

    def _pattern_of(self, held: BoolArray) -> NormalEquations:
        return NormalEquations(
            self.nodes,
            self._edges[held],
            self._measured[held],
            self._information[held],
            self._fixed,
            None,
            1.0,
        )

    def _resolve(self, foreseen: float = -math.inf) -> float:
        """Solve with the edges that are in; χ². From where the nodes are, and where that does not
        end near what was foreseen, from a chordal start: a false edge may have bent them so far
        that they do not find back."""
        problem = self.problem_of(self.accepted)
        best: Solution | None = None
        if foreseen > -math.inf:
            best = minimise(problem, self.nodes, WARM_ITERATIONS)
            self.iterations += best.iterations
        if best is None or best.chi2 > foreseen + self._truncation:
            solution = minimise(problem, chordal_start(problem), ROUND_ITERATIONS)
            self.iterations += solution.iterations
            best = solution if best is None or solution.chi2 < best.chi2 else best
            if problem.chi2(self.nodes) < best.chi2:
                best = minimise(problem, self.nodes, ROUND_ITERATIONS)
                self.iterations += best.iterations
        self.nodes = best.nodes
        return best.chi2

    def _flips(self, chosen: BoolArray, growth: float, into: BoolArray) -> _Flips:
        others = np.zeros(len(self.accepted), dtype=np.bool_)
        others[self._doubted[into]] = True
        return _Flips(np.asarray(self._doubted[chosen], dtype=np.int64), growth, others)

    def _contradicted(self, inside: BoolArray) -> BoolArray:
        """Which of the edges within the others speak against most."""
        allowed = LEAVING * self._truncation + 2.0 * np.maximum(self._odds, 0.0)
        ends, measured = self._edges[self._doubted], self._measured[self._doubted]
        near = squared_errors(self.nodes, ends, measured, self._information[self._doubted])
        # S is at least ALONE times Ω⁻¹: an edge that fits better could not be told to leave.
        suspects = inside & (near > ALONE * allowed)
        distances, _ = self._foreseen(suspects, 1.0 + ALONE, -1.0)
        against = np.where(suspects, distances - allowed, -math.inf)
        worst = 0.5 * against.max(initial=0.0)
        return np.asarray((against > 0.0) & (against >= worst), dtype=np.bool_)

    def _forget_bounds(self) -> None:
        self._bounds[:] = 1e9 * np.eye(3)

    def _hopeless(self) -> BoolArray:
        """Which doubted edges are too far off even for what was foreseen before."""
        ends, measured = self._edges[self._doubted], self._measured[self._doubted]
        errors = compose(
            invert(measured), compose(invert(self.nodes[ends[:, 0]]), self.nodes[ends[:, 1]])
        )
        volumes, distances = np.empty(len(errors)), np.empty(len(errors))
        consistency_kernels.volume_and_distance(self._bounds, errors, volumes, distances)
        return np.asarray(distances > self._truncation, dtype=np.bool_)

    def _foreseen(
        self, chosen: BoolArray, own: float, sign: float
    ) -> tuple[FloatArray, FloatArray]:
        """eᵀS⁻¹e and √det S of the chosen among the doubted edges, ∞ and 1 of the others, with
        S = own · Ω⁻¹ + sign · J H⁻¹ Jᵀ."""
        edges = self._doubted[chosen]
        errors, spreads = self._problem.innovations(
            self.nodes, self._edges[edges], self._measured[edges]
        )
        covariances = own * self._covariances[chosen] + sign * spreads
        if sign > 0.0:
            self._bounds[chosen] = covariances
        found_volumes, found_distances = np.empty(len(edges)), np.empty(len(edges))
        consistency_kernels.volume_and_distance(covariances, errors, found_volumes, found_distances)
        distances, volumes = np.full(len(chosen), math.inf), np.ones(len(chosen))
        distances[chosen] = found_distances
        volumes[chosen] = np.maximum(found_volumes, 1e-300)
        return distances, volumes


def _check_held(
    count: int, sure_edges: npt.NDArray[np.integer], fixed: npt.NDArray[np.bool_]
) -> None:
    labels = chain_kernels.label_components(count, integers(sure_edges).reshape(-1, 2))
    loose = np.flatnonzero(~np.isin(labels, labels[fixed]))
    if len(loose):
        raise PoseGraphError(
            f"only doubted edges tie node {loose[0]} to a fixed one; were they refused it would "
            "stand nowhere: trust one of them"
        )
