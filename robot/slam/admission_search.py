"""The search behind `robot.slam.admission`: which doubted edges are in, and the graph with them."""

import itertools
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from protocol.pose import FloatArray, compose, invert
from robot.slam import chain_kernels, consistency_kernels
from robot.slam.chordal import chordal_start
from robot.slam.normal_equations import (
    BoolArray,
    IntArray,
    NormalEquations,
    PoseGraphError,
    floats,
    integers,
)
from robot.slam.pose_graph import Solution, minimise, squared_errors
from robot.slam.votes import room_of, vote

# Log odds from which votes let an edge in at once: a thousand to one.
ELECTED = math.log(1000.0)
LIKELY = math.log(30.0)
LOG_2PI = math.log(2.0 * math.pi)
# An edge is foreseen about as surely as it is measured while S is up to this many times Ω⁻¹ in
# volume (m² rad).
CLEAR_RATIO = 4.5
# An edge that hardly anybody else supports leaves nothing of Ω⁻¹ − J H⁻¹ Jᵀ, and what little error
# it has is no contradiction: this share of Ω⁻¹ is added. Less where nobody voted for it either.
ALONE = 0.1
ALONE_UNELECTED = 1e-3
# Some graphs claim far less of their edges than these keep: the variance that is seen, raised by so
# much for the tails, in all but the worst, together with so many errors of the claimed size.
TAILS = 2.5
TRIMMED = 0.99
CLAIMED_ERRORS = 30.0
# So few doubted edges are in the pattern from the beginning, and turns are looked at again.
FEW = 64
# How many turns, those that shut out most, and this many edges at least.
TURNS_AGAIN = 2
SHUT_OUT = 2
MAX_ROUNDS = 60
ROUND_ITERATIONS = 8
# From where the nodes are, when what comes in is foreseen.
WARM_ITERATIONS = 3


@dataclass(frozen=True, slots=True)
class State:
    """Where a search stands: which edges (k) are in, the nodes (m×3) with them, and the cost."""

    cost: float
    chi2: float
    accepted: BoolArray
    nodes: FloatArray


@dataclass(frozen=True, slots=True)
class Flips:
    """Edges that should change sides, and by how much χ² is foreseen to grow, −∞ where they leave;
    `others` (k): edges that may come in now or later. A guess has the log odds of all edges (k)."""

    edges: IntArray
    growth: float
    others: BoolArray
    guess: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class Turn:
    """A guess that was followed: the state before it, edges (k) that might have come in instead,
    and their log odds."""

    before: State
    rivals: BoolArray
    odds: FloatArray


class Search:
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
        self._missed = np.zeros_like(self.accepted)
        """Edges (k) that were told to leave, which made the cost grow."""
        self._turns: list[Turn] = []
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

    def state(self) -> State:
        return State(self.cost, self._chi2, self.accepted.copy(), self.nodes)

    def run(self) -> State:
        """Let edges in, and tell some to leave, until all are content; the best state on the way.

        Guesses grow in number while χ² grows as foreseen. An edge that left and was missed stays.
        """
        best, seen, count = self.state(), {self.accepted.tobytes()}, 1
        for _ in range(MAX_ROUNDS):
            flips = self._flips(count)
            if len(flips.edges) == 0:
                break
            before = self.state()
            self._flip(flips)
            if flips.growth == -math.inf and self.cost > before.cost:
                self._missed[flips.edges] = True
                self._return_to(before)
                continue
            if flips.guess is not None:
                if len(flips.edges) > 1 and self.cost > before.cost:
                    self._return_to(before)
                    count = max(1, count // 4)
                    continue
                as_foreseen = self._chi2 <= before.chi2 + flips.growth + self._truncation
                count = 2 * count if as_foreseen else max(1, count // 4)
                self._turns.append(Turn(before, flips.others & ~self.accepted, flips.guess))
            if self.accepted.tobytes() in seen:
                break
            seen.add(self.accepted.tobytes())
            if self.cost < best.cost:
                best = self.state()
        return best

    def again(self, best: State) -> State:
        """The better one of a state and those that the search ends in where it takes another turn:
        a false edge, once in, shuts true ones out that would have been right together."""
        if len(self._doubted) > FEW:
            return best
        shut_out = [
            turn.rivals & ~later.rivals & ~best.accepted
            for turn, later in itertools.pairwise(self._turns)
        ]
        turns = sorted(zip(shut_out, self._turns, strict=False), key=lambda one: -one[0].sum())
        for rivals, turn in turns[:TURNS_AGAIN]:
            if rivals.sum() < SHUT_OUT:
                break
            self._return_to(turn.before)
            first = int(np.argmax(np.where(rivals, turn.odds, -math.inf)))
            self._flip(Flips(np.array([first]), 0.0, rivals))
            best = min(best, self.run(), key=lambda state: state.cost)
        return best

    def _flips(self, count: int) -> Flips:
        """The doubted edges that should change sides next, up to so many of them on a guess; none
        when all are content."""
        self._problem.linearise(self.nodes)
        self._problem.factorise()
        inside: BoolArray = self.accepted[self._doubted]
        distances, volumes = self._foreseen(~inside & ~self._hopeless(), 1.0, 1.0)
        into = distances < self._truncation
        evidence = self._odds - 0.5 * distances - np.log(volumes) + self._log_room
        clear = into & ((volumes <= CLEAR_RATIO * self._volumes) | (evidence > ELECTED))
        if clear.any():
            return Flips(
                self._doubted[clear], float(distances[clear].sum()), self._spread_out(into)
            )
        out = self._contradicted(inside)
        if out.any():
            return Flips(self._doubted[out], -math.inf, self._spread_out(into))
        guess = None
        if self._alone:
            likely, guess = into, np.full(len(self.accepted), -math.inf)
            guess[self._doubted] = evidence
            if int(into.sum()) > count:
                likely = into & (evidence >= np.sort(evidence[into])[-count])
        else:
            likely = into & (evidence > LIKELY)
        growth = float(distances[likely].sum())
        return Flips(self._doubted[likely], growth, self._spread_out(into), guess)

    def _spread_out(self, chosen: BoolArray) -> BoolArray:
        """Doubted edges that are marked, among all (k)."""
        marked = np.zeros(len(self.accepted), dtype=np.bool_)
        marked[self._doubted] = chosen
        return marked

    def _flip(self, flips: Flips) -> None:
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

    def _return_to(self, state: State) -> None:
        self.accepted, self.nodes, self._chi2 = state.accepted.copy(), state.nodes, state.chi2
        self.problem_of(self.accepted)
        self._forget_bounds()

    def _contradicted(self, inside: BoolArray) -> BoolArray:
        """Which of the edges within the others speak against most."""
        allowed = self._truncation + 2.0 * np.maximum(self._odds, 0.0)
        ends, measured = self._edges[self._doubted], self._measured[self._doubted]
        near = squared_errors(self.nodes, ends, measured, self._information[self._doubted])
        # S is at least so many times Ω⁻¹: an edge that fits better could not be told to leave.
        least = np.where(self._odds > ELECTED, ALONE, ALONE_UNELECTED)
        suspects = inside & ~self._missed[self._doubted] & (near > least * allowed)
        distances, _ = self._foreseen(suspects, 1.0 + least[suspects], -1.0)
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
        self, chosen: BoolArray, own: float | FloatArray, sign: float
    ) -> tuple[FloatArray, FloatArray]:
        """eᵀS⁻¹e and √det S of the chosen among the doubted edges, ∞ and 1 of the others, with
        S = own · Ω⁻¹ + sign · J H⁻¹ Jᵀ."""
        edges = self._doubted[chosen]
        errors, spreads = self._problem.innovations(
            self.nodes, self._edges[edges], self._measured[edges]
        )
        own = np.broadcast_to(own, len(edges))[:, None, None]
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
