"""The judge of a pair of logs: is there one alignment that all evidence speaks for, and no other?

The matches between two logs are sorted into consistent sets (`hypotheses`); each is solved, and the
whole maps are laid over each other as it says. A pair is

    unknown         no match between the logs
    tentative       something speaks for an alignment, but not enough, or as much for another
    aligned         enough distinct places, whole maps agree, nothing else comes near
    contradictory   enough distinct places, but the maps do not agree, or other pairs say otherwise
"""

from dataclasses import dataclass, replace
from enum import Enum

from protocol.pose import FloatArray, Pose2
from robot.team.demands import CLEAR, FEW, MANY, demands_on
from robot.team.evidence import Kind
from robot.team.hypothesis import MIN_SIGHTINGS, Hypothesis, LoneLogs, hypotheses
from robot.team.joint import JointGraph, LinkName
from robot.team.journal import LogName
from robot.team.log_map import LogMap, LogScans, Overlap, choose_scans, closest, draw_log, lay_over
from robot.team.rivals import Laid, cleanest, may_be_rival

MAX_SIGHTED_CROSSING = 0.10
KNOWN = "their starts are known"


class State(Enum):
    """How two logs stand to each other."""

    UNKNOWN = "unknown"
    TENTATIVE = "tentative"
    ALIGNED = "aligned"
    CONTRADICTORY = "contradictory"


@dataclass(frozen=True, slots=True)
class PairView:
    """How logs `a` and `b` stand, and why. Without a match all but the names is empty.

    `T_a_b` between first anchors, by the matches `links` of this pair alone; `overlap` of the whole
    maps; `rival`: the worth of the next alignment by that of the best.
    """

    a: LogName
    b: LogName
    state: State
    reason: str
    T_a_b: Pose2 | None = None
    links: tuple[LinkName, ...] = ()
    worth: float = 0.0
    places: int = 0
    sightings: int = 0
    rival: float = 0.0
    overlap: Overlap | None = None


class PairJudge:
    """Judges pairs of one graph; what several pairs need of a log is worked out once."""

    def __init__(self, graph: JointGraph, lone: LoneLogs, noise: FloatArray) -> None:
        self._graph = graph
        self._noise = noise
        self._lone = lone
        self._scans: dict[LogName, LogScans] = {}
        self._laid: dict[tuple[LinkName, ...], Laid] = {}

    def known(self, a: LogName, b: LogName) -> PairView:
        """Two logs that were told where they start."""
        return PairView(a, b, State.ALIGNED, KNOWN)

    def pair(self, a: LogName, b: LogName) -> PairView:
        """How two logs stand, by their own matches."""
        if not self._have_met(a, b):
            return PairView(a, b, State.UNKNOWN, "no match between them")
        found = hypotheses(self._graph, self._lone, a, b)
        if not found:
            return PairView(a, b, State.UNKNOWN, "no match that is worth anything")
        view = self._by_worth(found, a, b)
        if view.sightings >= MIN_SIGHTINGS:
            return view
        seen = self._by_sightings(found, a, b)
        if view.state is not State.ALIGNED:
            return seen or self._outranked(found, a, b) or view
        if seen is None or self._laid[seen.links].same_as(self._laid[view.links]):
            return view  # two glimpses are good to a degree, many places to a tenth of that
        return seen

    def _by_worth(self, found: list[Hypothesis], a: LogName, b: LogName) -> PairView:
        """How two logs stand by the first that aligns them, or else by the one worth most."""
        views = []
        for best in found:
            views.append(self._view(best, [other for other in found if other is not best], a, b))
            if views[-1].state is State.ALIGNED:
                return views[-1]
            # What the maps rule out leaves room for the next; sightings that they rule out do not:
            # something is wrong then that nobody can see from here.
            if views[-1].state is not State.CONTRADICTORY or best.sightings >= MIN_SIGHTINGS:
                break
        return views[0]

    def _by_sightings(self, found: list[Hypothesis], a: LogName, b: LogName) -> PairView | None:
        """How two logs stand by their sightings, if the maps bear these out: who was seen there is
        not to be doubted, however much places are worth that say otherwise."""
        sighted = next((one for one in found if one.sightings >= MIN_SIGHTINGS), None)
        if sighted is None:
            return None
        seen = self._view(sighted, [one for one in found if one is not sighted], a, b)
        return seen if seen.state is State.ALIGNED else None

    def _outranked(self, found: list[Hypothesis], a: LogName, b: LogName) -> PairView | None:
        """How two logs stand by an alignment that others outrank in worth, if walls refute these:
        where rooms repeat more of them may match by a wrong one. It needs places enough itself, or
        maps that disagree in nothing."""
        if any(one.sightings for one in found):
            return None
        laid = [self._lay_over(one, a, b) for one in found if one.worth >= FEW.worth]
        clean = cleanest(
            [one for one in laid if one.is_clean or MANY.are_met_by(one.hypothesis, 0.0)]
        )
        if clean is None:
            return None
        left = [one.hypothesis for one in laid if one is not clean and not one.is_refuted(clean)]
        view = self._view(clean.hypothesis, left, a, b)
        right = view.state is State.ALIGNED and clean.overlap.crossing <= MANY.crossing
        others = [one for one in found if one is not clean.hypothesis]
        return replace(view, rival=_next_worth(clean.hypothesis, others)) if right else None

    def _view(self, best: Hypothesis, others: list[Hypothesis], a: LogName, b: LogName) -> PairView:
        """How two logs stand if `best` is what their matches say."""
        enough = best.sightings >= MIN_SIGHTINGS or best.worth >= FEW.worth
        laid = self._lay_over(best, a, b) if enough else None
        state, reason = self._verdict(best, laid, others, a, b)
        return PairView(
            a,
            b,
            state,
            reason,
            best.transform(a, b),
            best.links,
            best.worth,
            best.places,
            best.sightings,
            _next_worth(best, others),
            laid.overlap if laid else None,
        )

    def _have_met(self, a: LogName, b: LogName) -> bool:
        for holder, other in ((a, b), (b, a)):
            log = self._graph.log(holder)
            if log and any(
                link.log == other and link.evidence.kind is not Kind.NEAR for link in log.links
            ):
                return True
        return False

    def _verdict(
        self,
        best: Hypothesis,
        laid: Laid | None,
        others: list[Hypothesis],
        a: LogName,
        b: LogName,
    ) -> tuple[State, str]:
        if laid is None:
            return State.TENTATIVE, "the matches are worth too little"
        overlap = laid.overlap
        sighted = best.sightings >= MIN_SIGHTINGS
        rival = _next_worth(best, others)
        demands = demands_on(best, rival, overlap)
        many = demands in (CLEAR, MANY)
        # What few places say is too little to hold anything against the maps.
        unlike = State.CONTRADICTORY if many or sighted else State.TENTATIVE
        crossing, mean = demands.crossing, demands.crossing_mean
        if sighted:
            crossing, mean = MAX_SIGHTED_CROSSING, 1.0
        if overlap.crossing > crossing or overlap.crossing_mean > mean:
            return unlike, f"{overlap.crossing:.1%} of the rays cross walls"
        if sighted:
            return State.ALIGNED, f"{best.sightings} sightings agree"
        if overlap.hits < demands.hits:
            return unlike, f"only {overlap.hits:.0%} of the returns lie on walls"
        if overlap.faced < demands.faced:
            return State.TENTATIVE, "walls were seen from different sides"
        if best.ambiguity > demands.ambiguity:
            return State.TENTATIVE, "the places look like others"
        if overlap.walls_m < demands.walls_m:
            return State.TENTATIVE, f"{overlap.walls_m:.0f} m of common walls are too few"
        if any(self._is_rival(other, laid, a, b) for other in others):
            return State.TENTATIVE, "another alignment fits nearly as well"
        return State.ALIGNED, f"{best.places} places agree"

    def _is_rival(self, other: Hypothesis, best: Laid, a: LogName, b: LogName) -> bool:
        """Whether another alignment leaves it open which is right."""
        return may_be_rival(other, best.hypothesis) and self._lay_over(other, a, b).rivals(best)

    def _lay_over(self, hypothesis: Hypothesis, a: LogName, b: LogName) -> Laid:
        """The whole maps as a hypothesis bends them together, and shifted to where they lie best:
        before that, drift looks like walls that are crossed. Each is laid over once."""
        if hypothesis.links not in self._laid:
            self._laid[hypothesis.links] = self._lay_over_now(hypothesis, a, b)
        return self._laid[hypothesis.links]

    def _lay_over_now(self, hypothesis: Hypothesis, a: LogName, b: LogName) -> Laid:
        one, other = (self._draw(hypothesis, name) for name in (a, b))
        shift = closest(one, other)
        ours, theirs = hypothesis.solution[a], hypothesis.solution[b]
        T_frame_b = shift @ Pose2.from_array(theirs[len(theirs) // 2])
        T_a_b = Pose2.from_array(ours[0]).inverse() @ T_frame_b
        return Laid(hypothesis, lay_over(one, other, shift), T_a_b)

    def _draw(self, hypothesis: Hypothesis, name: LogName) -> LogMap:
        log = self._graph.log(name)
        assert log is not None
        if name not in self._scans:
            self._scans[name] = choose_scans(log, self._lone[name].anchors, self._noise)
        return draw_log(log, self._scans[name], hypothesis.solution[name])


def _next_worth(best: Hypothesis, others: list[Hypothesis]) -> float:
    """The worth of the next hypothesis by that of the best."""
    return max((other.worth for other in others), default=0.0) / best.worth
