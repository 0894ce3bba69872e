"""Is one place part of another, and where? Tests of what a search found (`place_search`).

The search knows landmarks and cells. The evidence is what it did not look at: rays of one through
walls of the other, returns where the other saw free space, both ways.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from protocol.pose import FloatArray, Pose2, wrap_angle
from robot.perception.field import CorrelationField, Overlay
from robot.perception.matching import Match, match_facing
from robot.perception.search import SAME_PEAK_M, SAME_PEAK_RAD
from robot.slam.gaussian import invert_spd
from robot.team.evidence import Evidence, Kind, weight_of
from robot.team.place import Place
from robot.team.place_search import SearchGround, find_peaks

# What a place is told to be found at.
MAX_FOUND = 2
# Every so many scans of a place are laid over the other.
LAY_EVERY = 2
# What a match of places errs by however many surfaces agree.
MATCH_FLOOR = np.diag([0.01**2, 0.01**2, 0.003**2])
# And in surroundings that were seen some metres before.
DRIFTED_FLOOR = np.diag([0.03**2, 0.03**2, 0.01**2])
# Neighbouring surfaces err together: so many of them count as one.
CORRELATED = 8.0
# What is known of a direction in which the surfaces say nothing (1 m, 1 rad).
UNKNOWN = np.eye(3)
# What it takes to be worth telling the team.
MIN_SCORE, MIN_OVERLAP, MIN_HITS, MAX_CROSSING = 0.2, 0.25, 0.75, 0.08
# Of a place that is looked for most has to be seen from the same side; of what it is looked for in,
# whose surroundings may be larger, half. So few points on walls (5 m) say nothing: what is looked
# for may lie in these surroundings alone.
MIN_FACED, MIN_FACED_BACK = 0.7, 0.5
MIN_FACING = 60


@dataclass(frozen=True, slots=True)
class PlaceMatch:
    """`T_a_b` between two places' frames with information (3×3, tangent space at b).

    `faced`: of b's surfaces on walls of a and the other way round, the shares that both have seen
    from the same side. Two sides of one wall match as well, off by its thickness.
    """

    T_a_b: Pose2
    information: FloatArray
    score: float
    evidence: Evidence
    faced: tuple[float, float] = (1.0, 1.0)

    @property
    def objection(self) -> str:
        """Why this is no match; empty when nothing speaks against it."""
        evidence = self.evidence
        if self.score < MIN_SCORE:
            return "low score"
        if evidence.overlap < MIN_OVERLAP:
            return "little overlap"
        if evidence.hits < MIN_HITS:
            return "returns where the other is free"
        if evidence.crossing > MAX_CROSSING:
            return "rays through walls"
        if self.faced[0] < MIN_FACED or self.faced[1] < MIN_FACED_BACK:
            return "walls seen from the other side"
        return ""


def find_place(ground: SearchGround, b: Place) -> list[PlaceMatch]:
    """Where place b may lie in another, a, with no idea of where it is: what no evidence speaks
    against, what is worth most first, and at most two: where places look alike both count."""
    a = ground.place
    matches: list[PlaceMatch] = []
    for peak in find_peaks(ground, b):
        match = match_from(a, b, peak.T_a_b, Kind.PLACE, peak.ambiguity)
        if not match.objection and not any(_same(match, other) for other in matches):
            matches.append(match)
    matches.sort(key=lambda match: -weight_of(match.evidence))
    return matches[:MAX_FOUND]


def _same(one: PlaceMatch, other: PlaceMatch) -> bool:
    """Whether two peaks were climbed to one."""
    turn = abs(wrap_angle(one.T_a_b.theta - other.T_a_b.theta))
    return one.T_a_b.distance_to(other.T_a_b) < SAME_PEAK_M and turn < SAME_PEAK_RAD


def match_from(
    a: Place, b: Place, guess: Pose2, kind: Kind = Kind.NEAR, ambiguity: float = 0.0
) -> PlaceMatch:
    """Climb from a guess of `T_a_b`, and gather the evidence.

    A place that was searched for may lie in the surroundings of another, and evidence is gathered
    there. These hold what the chain drifted: where the places themselves overlap, they say best how
    they lie, and where they do not the match is known less well.
    """
    if kind is Kind.NEAR:
        match, laid = _climb(a.field, b.field, a, b, guess, min)
        return _place_match(match, laid, kind, ambiguity, MATCH_FLOOR)
    match, laid = _climb(a.surroundings, b.surroundings, a, b, guess, max)
    T_a_b = match.T_field_base
    drifted = replace(
        _place_match(match, laid, kind, ambiguity, DRIFTED_FLOOR),
        faced=(
            a.walls.faced(T_a_b, b.surfaces, MIN_FACING),
            b.walls.faced(T_a_b.inverse(), a.surfaces, MIN_FACING),
        ),
    )
    if drifted.objection:
        return drifted
    closer, seen = _climb(a.field, b.field, a, b, T_a_b, min)
    if seen.overlap >= MIN_OVERLAP and seen.hits >= MIN_HITS and closer.score >= MIN_SCORE:
        return _place_match(closer, laid, kind, ambiguity, MATCH_FLOOR)
    return drifted


def _climb(
    on: CorrelationField,
    onto: CorrelationField,
    a: Place,
    b: Place,
    guess: Pose2,
    fold: Callable[[float, float], float],
) -> tuple[Match, Overlay]:
    """Place b matched on what was drawn of a, and both ways laid over each other; `fold` says which
    of the overlaps counts."""
    match = match_facing(on, a.walls, b.surfaces, guess)
    T_a_b = match.T_field_base
    on_a, on_b = _lay_over(on, b, T_a_b), _lay_over(onto, a, T_a_b.inverse())
    laid = Overlay(
        fold(on_a.overlap, on_b.overlap),
        min(on_a.hits, on_b.hits),
        max(on_a.crossing, on_b.crossing),
    )
    return match, laid


def _place_match(
    match: Match, laid: Overlay, kind: Kind, ambiguity: float, floor: FloatArray
) -> PlaceMatch:
    covariance = invert_spd(match.information / CORRELATED + UNKNOWN) + floor
    evidence = Evidence(kind, laid.overlap, laid.hits, laid.crossing, ambiguity)
    return PlaceMatch(match.T_field_base, invert_spd(covariance), match.score, evidence)


def _lay_over(a: CorrelationField, b: Place, T_a_b: Pose2) -> Overlay:
    """How the scans of place b lie on what was drawn of place a."""
    total, weight = np.zeros(4), 0.0
    for pose, scan in zip(b.keyframes[::LAY_EVERY], b.scans[::LAY_EVERY], strict=True):
        total += a.compare(T_a_b @ Pose2.from_array(pose), scan)
        weight += float(scan.values[:, 4].sum())
    return Overlay.of(total, weight)
