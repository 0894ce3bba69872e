"""Rivals: other alignments of two logs that leave it open which of them is right."""

from dataclasses import dataclass

from protocol.pose import Pose2, wrap_angle
from robot.team.demands import CLEAN, FEW
from robot.team.hypothesis import Hypothesis
from robot.team.log_map import Overlap

# Another alignment that comes this near to the best in worth leaves it open which is right, unless
# so many more rays cross walls by it than by the best; one of less worth does if the maps agree by
# it as they would have to by few places, and over as much wall, or half of what they share by the
# best: maps that hardly touch contradict nothing. Over less wall they must agree as clean ones do:
# two equal halves share all by the wrong alignment, and the middle by the right one, where robots
# looked through the same doors from both sides: 78 % of the returns lay on walls.
RIVAL_WORTH = 0.6
RIVAL_CROSSING, RIVAL_FACTOR, MAX_RIVAL_CROSSING = 0.01, 2.5, 0.08
RIVAL_HITS, RIVAL_WALLS = 0.88, 0.5
# Shares hide a room: two alignments of repeating rooms agree on all but the one at the end, and
# what both explain speaks for neither. What counts is the wall that must be gone by one and not by
# the other, however much else there is: by the right ones of 45 pairs in rows of rooms 1 m at most.
# What people, doors and drift make seem gone is gone by the best too, if that shares as much.
REFUTED_M, REFUTED_FACTOR = 2.5, 3.0
# By an alignment that others outrank no more may be gone than by right ones.
CLEAN_M = 1.0
# Sets of matches that err by a little more than they should disagree, and yet lay the maps in the
# same way: what comes to lie this near, once both are where they lie best, is no other alignment.
SAME_M, SAME_RAD = 0.3, 0.05


def may_be_rival(other: Hypothesis, best: Hypothesis) -> bool:
    """Whether a hypothesis is worth enough to be held against the best, whatever the maps say."""
    return _is_near(other, best) or other.worth >= FEW.worth


def cleanest(laid: list["Laid"]) -> "Laid | None":
    """The alignment by which the least wall is gone, if that is as little as by right ones."""
    least = min(laid, key=lambda one: one.overlap.gone_m, default=None)
    return least if least is not None and least.overlap.gone_m <= CLEAN_M else None


def _is_near(other: Hypothesis, best: Hypothesis) -> bool:
    return other.worth >= RIVAL_WORTH * best.worth


@dataclass(frozen=True, slots=True)
class Laid:
    """How the whole maps of two logs lie by a hypothesis; `T_a_b` from the first anchor of a to the
    middle one of b."""

    hypothesis: Hypothesis
    overlap: Overlap
    T_a_b: Pose2

    @property
    def is_clean(self) -> bool:
        """Whether the maps disagree in nothing, by places that are worth something."""
        return CLEAN.are_met_by(self.hypothesis, 0.0) and CLEAN.suit(self.overlap)

    def rivals(self, best: "Laid") -> bool:
        """Whether this leaves it open if the best is right: it comes near in worth, or the maps
        agree to the last bit by this too; and no walls speak against it alone."""
        if self.same_as(best) or self.is_refuted(best):
            return False
        ours, least = self.overlap, best.overlap.crossing
        if _is_near(self.hypothesis, best.hypothesis):
            worse = max(least + RIVAL_CROSSING, RIVAL_FACTOR * least)
            return ours.crossing <= min(worse, MAX_RIVAL_CROSSING)
        if self._agrees(CLEAN.walls_m, CLEAN.hits, CLEAN.crossing):
            return True
        shared_m = min(FEW.walls_m, RIVAL_WALLS * best.overlap.walls_m)
        return self._agrees(shared_m, RIVAL_HITS, FEW.crossing)

    def _agrees(self, walls_m: float, hits: float, crossing: float) -> bool:
        ours = self.overlap
        return ours.walls_m >= walls_m and ours.hits >= hits and ours.crossing <= crossing

    def is_refuted(self, best: "Laid") -> bool:
        """Whether far more wall must be gone by this than by the best, which shares as much."""
        gone_m = REFUTED_M + REFUTED_FACTOR * best.overlap.gone_m
        shares = best.overlap.walls_m >= RIVAL_WALLS * self.overlap.walls_m
        return shares and self.overlap.gone_m >= gone_m

    def same_as(self, other: "Laid") -> bool:
        """Whether two hypotheses come to the same."""
        turn = abs(wrap_angle(self.T_a_b.theta - other.T_a_b.theta))
        return self.T_a_b.distance_to(other.T_a_b) <= SAME_M and turn <= SAME_RAD
