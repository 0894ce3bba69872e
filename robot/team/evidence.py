"""What speaks for a link between two logs, as the robot that found it saw it."""

from dataclasses import dataclass
from enum import IntEnum


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
