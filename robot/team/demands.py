"""What an alignment takes of matches and of the maps."""

import math
from dataclasses import dataclass

from robot.team.hypothesis import Hypothesis
from robot.team.log_map import Overlap


@dataclass(frozen=True, slots=True)
class Demands:
    """What an alignment takes: distinct places, what they are worth together, how like the next
    best most of them may look, and what the next alignment may be worth by this one; of the whole
    maps the walls seen by both, returns on walls, rays through walls (of the worse way, and of both
    in the mean), the walls gone, and of those seen by both the share seen from the same side: two
    sides of a wall match as well."""

    places: int
    worth: float
    ambiguity: float
    rival: float
    walls_m: float
    hits: float
    crossing: float
    crossing_mean: float = math.inf
    gone_m: float = math.inf
    faced: float = 0.7

    def are_met_by(self, hypothesis: Hypothesis, rival: float) -> bool:
        """Whether the matches of a hypothesis come up to them, whatever the maps say."""
        return (
            hypothesis.places >= self.places
            and hypothesis.worth >= self.worth
            and hypothesis.ambiguity <= self.ambiguity
            and rival <= self.rival
        )

    def suit(self, overlap: Overlap) -> bool:
        """Whether the whole maps come up to them, whatever their matches say."""
        return (
            overlap.walls_m >= self.walls_m
            and overlap.hits >= self.hits
            and overlap.crossing <= self.crossing
            and overlap.crossing_mean <= self.crossing_mean
            and overlap.gone_m <= self.gone_m
            and overlap.faced >= self.faced
        )


def demands_on(hypothesis: Hypothesis, rival: float, overlap: Overlap) -> Demands:
    """What to hold against a hypothesis: by its matches, or that its maps are clean if they are."""
    usual = next((one for one in (CLEAR, MANY, COUPLE) if one.are_met_by(hypothesis, rival)), FEW)
    clean = CLEAN.are_met_by(hypothesis, rival) and CLEAN.suit(overlap)
    return CLEAN if clean and not usual.suit(overlap) else usual


# Of few places the maps must say more: that they agree to the last bit, over more than a room.
#
# People, glass and drift make one building disagree with itself as much as it does with another:
# wrong pairs of rings had hits 0.83 to 0.87 and crossing 0.056 to 0.058, two runs in Wean Hall have
# 0.83 and 0.052. But what a building disagrees in is seen by one of them, and the mean of both ways
# is 0.032 there; of others both ways are as bad, 0.048 at least in the mean by the 31 wrong
# alignments of three places or more. So much is suffered only with that, and where nothing else
# fits by far.
CLEAR = Demands(
    3,
    worth=1.2,
    ambiguity=0.9,
    rival=0.25,
    walls_m=20.0,
    hits=0.80,
    crossing=0.06,
    crossing_mean=0.04,
)
MANY = Demands(3, worth=1.2, ambiguity=1.0, rival=1.0, walls_m=20.0, hits=0.80, crossing=0.025)
COUPLE = Demands(2, worth=1.2, ambiguity=0.6, rival=1.0, walls_m=25.0, hits=0.85, crossing=0.015)
FEW = Demands(1, worth=0.4, ambiguity=0.85, rival=1.0, walls_m=35.0, hits=0.85, crossing=0.015)
# Maps that share little and disagree in nothing, whatever else their places look like: 558 wrong
# alignments of worlds that do not repeat had crossing 0.008 or more, but for 8 by which one place
# alone fits that looks like others, and at most 0.74 of the returns lie on walls, or 12 m are
# shared. By right ones, with 30 to 50 % in common, it was 0.002 in the median.
CLEAN = Demands(
    1,
    worth=0.4,
    ambiguity=0.85,
    rival=math.inf,
    walls_m=15.0,
    hits=0.75,
    crossing=0.005,
    gone_m=1.5,
    faced=0.55,
)
