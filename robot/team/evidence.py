"""What speaks for a link between two logs, as the robot that found it saw it."""

from dataclasses import dataclass
from enum import IntEnum

# A sighting says who was seen, so one is worth more than a look-alike place can be.
SIGHTING_WEIGHT = 2.0


class Kind(IntEnum):
    """How a link was found: near where both maps already put it, by the look of a place with no
    idea of where it is, or by robots that saw each other."""

    NEAR = 0
    PLACE = 1
    SIGHTING = 2


@dataclass(frozen=True, slots=True)
class Evidence:
    """Shares from 0 to 1, of the worse of both ways but for `overlap`.

    `overlap`: of the returns of one, how many lie where the other map knows the place, for a place
    that was searched for of the better way, as a small one may lie in a large one; `hits`: how many
    of those lie on its walls; `crossing`: of the rays, how many go through its walls; `ambiguity`:
    the score of the best pose elsewhere by that of the pose itself.
    """

    kind: Kind = Kind.NEAR
    overlap: float = 1.0
    hits: float = 1.0
    crossing: float = 0.0
    ambiguity: float = 0.0


ASSUMED = Evidence()


def weight_of(evidence: Evidence) -> float:
    """What a match is worth by itself, 0…1 for a place: one without contradiction, whose surfaces
    agree and which covers much, unlike what is found elsewhere."""
    if evidence.kind == Kind.SIGHTING:
        return SIGHTING_WEIGHT
    agreeing = max(0.0, (evidence.hits - 0.6) / 0.4)
    crossing = max(0.0, 1.0 - evidence.crossing / 0.12)
    covering = min(1.0, evidence.overlap / 0.5)
    return agreeing * crossing * covering
