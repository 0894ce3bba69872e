"""What an alignment takes of matches and of the maps."""

import math
from dataclasses import dataclass

from robot.team.hypothesis import Hypothesis
from robot.team.log_map import Overlap


@dataclass(frozen=True, slots=True)
class Demands:
    """What an alignment takes: distinct places, what they are worth together, how like the next
    best most of them may look, and what the next alignment may be worth by this one; of the whole
    maps the walls seen by both, returns on walls, rays through walls, and the walls gone."""

    places: int
    worth: float
    ambiguity: float
    rival: float
    walls_m: float
    hits: float
    crossing: float
    gone_m: float = math.inf

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
            and overlap.gone_m <= self.gone_m
        )


def demands_on(hypothesis: Hypothesis, rival: float, overlap: Overlap) -> Demands:
    """What to hold against a hypothesis: by its matches, or that its maps are clean if they are."""
    usual = next((one for one in (CLEAR, MANY, COUPLE) if one.are_met_by(hypothesis, rival)), FEW)
    clean = CLEAN.are_met_by(hypothesis, rival) and CLEAN.suit(overlap)
    return CLEAN if clean and not usual.suit(overlap) else usual


# Of few places the maps must say more: that they agree to the last bit, over more than a room. Two
# different buildings can disagree as little as people, glass and drift make one disagree (one pair
# of a hundred had hits 0.83 and crossing 0.058, as two runs in Wean Hall have): so much is suffered
# only where nothing else fits by far.
CLEAR = Demands(3, worth=1.2, ambiguity=1.0, rival=0.25, walls_m=25.0, hits=0.80, crossing=0.06)
MANY = Demands(3, worth=1.2, ambiguity=1.0, rival=1.0, walls_m=25.0, hits=0.80, crossing=0.025)
COUPLE = Demands(2, worth=1.2, ambiguity=0.6, rival=1.0, walls_m=25.0, hits=0.85, crossing=0.015)
FEW = Demands(1, worth=0.4, ambiguity=0.85, rival=1.0, walls_m=35.0, hits=0.85, crossing=0.015)
# Maps that share little and disagree in nothing: by wrong alignments of pairs of twelve worlds at
# least 1.1 % of the rays crossed walls and 3.2 m were gone, by right ones at most 0.5 % and 1.5 m.
CLEAN = Demands(
    1, worth=0.8, ambiguity=0.85, rival=0.6, walls_m=20.0, hits=0.80, crossing=0.005, gone_m=1.5
)
# Of the walls that both have seen so many from the same side: two sides of a wall match as well.
MIN_FACED = 0.7
