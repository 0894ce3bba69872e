"""What an alignment takes of matches and of the maps."""

from dataclasses import dataclass

from robot.team.hypothesis import Hypothesis


@dataclass(frozen=True, slots=True)
class Demands:
    """What an alignment takes: distinct places, what they are worth together, how like the next
    best most of them may look, and what the next alignment may be worth by this one; of the whole
    maps the walls seen by both, returns on walls, and rays through them."""

    places: int
    worth: float
    ambiguity: float
    rival: float
    walls_m: float
    hits: float
    crossing: float

    def are_met_by(self, hypothesis: Hypothesis, rival: float) -> bool:
        """Whether the matches of a hypothesis come up to them, whatever the maps say."""
        return (
            hypothesis.places >= self.places
            and hypothesis.worth >= self.worth
            and hypothesis.ambiguity <= self.ambiguity
            and rival <= self.rival
        )


# Of few places the maps must say more: that they agree to the last bit, over more than a room. Two
# different buildings can disagree as little as people, glass and drift make one disagree (one pair
# of a hundred had hits 0.83 and crossing 0.058, as two runs in Wean Hall have): so much is suffered
# only where nothing else fits by far.
CLEAR = Demands(3, worth=1.2, ambiguity=1.0, rival=0.25, walls_m=25.0, hits=0.80, crossing=0.06)
MANY = Demands(3, worth=1.2, ambiguity=1.0, rival=1.0, walls_m=25.0, hits=0.80, crossing=0.025)
COUPLE = Demands(2, worth=1.2, ambiguity=0.6, rival=1.0, walls_m=25.0, hits=0.85, crossing=0.015)
FEW = Demands(1, worth=0.4, ambiguity=0.85, rival=1.0, walls_m=35.0, hits=0.85, crossing=0.015)
# Of the walls that both have seen so many from the same side: two sides of a wall match as well.
MIN_FACED = 0.7
