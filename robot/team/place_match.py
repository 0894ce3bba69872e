"""Is one place part of another, and where? A search over all poses, and tests of what it found.

The search finds the pose at which most of a place's landmarks lie on the other's walls, of all
rotations at which walls of both face the same ways, and what the best pose elsewhere scores. The
evidence is what the search did not look at: rays of one through walls of the other, returns where
the other saw free space, both ways.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from protocol.pose import FloatArray, Pose2
from robot.perception import search_kernels
from robot.perception.field import RESOLUTION_M, SIGMA_M, CorrelationField, Overlay
from robot.perception.matching import Match, match_returns
from robot.perception.search import (
    MAX_NODES,
    SAME_PEAK_M,
    SEARCH_RESOLUTION_M,
    Blocks,
    Pyramid,
)
from robot.perception.search_kernels import NODES_PER_CELL
from robot.slam.gaussian import invert_spd
from robot.team.evidence import Evidence, Kind
from robot.team.place import DIRECTION_BINS, Place

# Rotations are tried degree by degree where the walls' directions agree to this share of the best.
SAME_DIRECTIONS = 0.85
SAME_PEAK_DEG = 15
SEARCH_FLOOR = 0.5
# Peaks lower than this share of the best one are no rivals.
RIVAL_SHARE = 0.75
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
MIN_SCORE, MIN_OVERLAP, MIN_HITS, MAX_CROSSING = 0.3, 0.25, 0.75, 0.08


@dataclass(frozen=True, slots=True)
class PlaceMatch:
    """`T_a_b` between two places' frames with information (3×3, tangent space at b)."""

    T_a_b: Pose2
    information: FloatArray
    score: float
    evidence: Evidence

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
        return ""


@dataclass(frozen=True, slots=True)
class _Peak:
    """A pose that a search found, with its score by the best elsewhere."""

    T_a_b: Pose2
    ambiguity: float


def make_pyramid(place: Place) -> Pyramid:
    """What searches in a place go through; worth keeping."""
    extent_m = float(max(place.surroundings.nodes.shape)) * RESOLUTION_M
    return Pyramid.of(Blocks.of(place.surroundings), extent_m)


def find_place(a: Place, pyramid: Pyramid, b: Place) -> list[PlaceMatch]:
    """Where place b may lie in place a, with no idea of where it is: what no evidence speaks
    against, the best by its score first, and at most two: where places look alike both count."""
    matches = [
        match_from(a, b, peak.T_a_b, Kind.PLACE, peak.ambiguity) for peak in _search(a, pyramid, b)
    ]
    return [match for match in matches if not match.objection]


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
    closer, seen = _climb(a.field, b.field, a, b, match.T_field_base, min)
    if seen.overlap >= MIN_OVERLAP and seen.hits >= MIN_HITS and closer.score >= MIN_SCORE:
        return _place_match(closer, laid, kind, ambiguity, MATCH_FLOOR)
    return _place_match(match, laid, kind, ambiguity, DRIFTED_FLOOR)


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
    match = match_returns(on, b.surfaces, guess)
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


def _search(a: Place, pyramid: Pyramid, b: Place) -> list[_Peak]:
    """The best pose of b in a, and the best elsewhere if that comes near. Rotations are about the
    middle of b, offsets from that of a."""
    if len(b.landmarks) == 0:
        return []
    sigma2 = b.landmarks.values[:, 5] ** 2
    full = 255.0 * float((SIGMA_M / np.sqrt(SIGMA_M**2 + 2.0 * sigma2)).sum())
    field = a.surroundings
    shape = np.array(field.nodes.shape)
    middle = field.origin + 0.5 * RESOLUTION_M * shape[::-1]
    half_rows, half_columns = (shape // (2 * NODES_PER_CELL) + 1).tolist()
    degrees = rotations(a.directions, b.directions)
    angles = np.radians(degrees)
    first, second, _ = search_kernels.branch_and_bound(
        pyramid.levels,
        _cells(b.landmarks.points - b.centre, angles, middle - field.origin),
        degrees,
        half_rows,
        half_columns,
        round(SAME_PEAK_M / SEARCH_RESOLUTION_M),
        SAME_PEAK_DEG,
        int(SEARCH_FLOOR * full),
        RIVAL_SHARE,
        MAX_NODES,
    )
    floor = max(SEARCH_FLOOR * full, RIVAL_SHARE * first[0])
    peaks = []
    for one, other in ((first, second), (second, first)):
        total, angle, row, column = one
        if angle < 0:
            continue
        x, y = middle + SEARCH_RESOLUTION_M * np.array([column, row])
        T_a_centre = _within_cell(a, b, np.array([x, y, angles[angle]]))
        T_a_b = T_a_centre @ Pose2(-float(b.centre[0]), -float(b.centre[1]), 0.0)
        peaks.append(_Peak(T_a_b, min(1.0, max(other[0], floor) / total)))
    return peaks


def _within_cell(a: Place, b: Place, T_a_centre: FloatArray) -> Pose2:
    """The best pose between the nodes of the cell, and the degrees, that a search ended in."""
    pose = T_a_centre.copy()
    search_kernels.best_nearby(
        a.surroundings.nodes,
        a.surroundings.origin,
        RESOLUTION_M,
        np.ascontiguousarray(b.landmarks.points - b.centre),
        T_a_centre,
        0.5 * SEARCH_RESOLUTION_M,
        NODES_PER_CELL // 2,
        math.radians(0.5),
        pose,
    )
    return Pose2.from_array(pose)


def rotations(a: FloatArray, b: FloatArray) -> FloatArray:
    """The whole degrees by which walls with the directions b (180) may be turned to face as those
    with the directions a do.

    Directions lack their sign, so each is there twice, half a turn apart.
    """
    agreement = np.fft.irfft(np.fft.rfft(a) * np.conj(np.fft.rfft(b)), DIRECTION_BINS)
    good = agreement >= SAME_DIRECTIONS * agreement.max()
    # And one to either side: the best of a range may lie beyond its last whole degree.
    good |= np.roll(good, 1) | np.roll(good, -1)
    degrees = np.flatnonzero(good)
    return np.concatenate([degrees, degrees + DIRECTION_BINS]).astype(np.float64)


def _cells(points: FloatArray, angles: FloatArray, middle: FloatArray) -> np.ndarray:
    """Rows and columns (angles×n×2, search cells) of points turned and moved to the middle."""
    c, s = np.cos(angles)[:, None], np.sin(angles)[:, None]
    x, y = points[:, 0][None, :], points[:, 1][None, :]
    nodes = np.stack([middle[1] + s * x + c * y, middle[0] + c * x - s * y], axis=-1) / RESOLUTION_M
    # Search cell k holds the nodes n·k … n·k + n − 1.
    cells = np.floor_divide(np.floor(nodes + 0.5), NODES_PER_CELL)
    return np.ascontiguousarray(cells.astype(np.int64))
