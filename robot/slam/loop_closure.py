"""Loop closure: is this scan part of a submap that was finished long ago, and where?

Candidates are searched as a job (a pure function of a snapshot). Each match found is checked by a
test that the matcher did not use: no rays of the scan through walls of the submap, its returns on
walls wherever the submap knows the place, and no other pose in the window nearly as good.
"""

from dataclasses import dataclass, replace

import numpy as np

from protocol.pose import FloatArray, Pose2
from robot.perception.matching import Match, match_returns
from robot.perception.returns import Returns
from robot.perception.search import Pyramid, Window, search
from robot.slam.config import ClosureConfig
from robot.slam.gaussian import carry, invert_spd
from robot.slam.submap import Submap

# Keeps a match from sliding along a corridor that does not hold it; not part of what is reported.
WEAK_PRIOR = np.diag([0.15**-2, 0.15**-2, 0.1**-2])
# What is known of a direction in which the returns say nothing (1 m, 1 rad).
UNKNOWN = np.eye(3)


@dataclass(frozen=True, slots=True)
class Query:
    """A scan to be found again: its place in the current submap, with covariance there."""

    anchor: int
    T_anchor_base: Pose2
    covariance: FloatArray
    returns: Returns


@dataclass(frozen=True, slots=True)
class Candidate:
    """A finished submap with the guess `T_submap_base`; a window of 0 m asks for no search."""

    submap: Submap
    guess: Pose2
    half_m: float
    half_rad: float


@dataclass(frozen=True, slots=True)
class Verdict:
    """What became of a candidate: the measured `T_of_to` between anchors, and the evidence.

    `overlap`, `hits` and `crossing` as in Overlay; `ambiguity` is the runner-up's score by the best
    one's (0 where nothing was searched).
    """

    of: int
    to: int
    T_of_to: Pose2
    information: FloatArray
    score: float
    overlap: float
    hits: float
    crossing: float
    ambiguity: float
    accepted: bool
    reason: str


def examine(
    query: Query, candidates: tuple[Candidate, ...], config: ClosureConfig
) -> tuple[Verdict, ...]:
    """Match the query against every candidate and judge each result. Pure: may run as a job."""
    return tuple(_examine(query, candidate, config) for candidate in candidates)


def _examine(query: Query, candidate: Candidate, config: ClosureConfig) -> Verdict:
    field = candidate.submap.field
    start, ambiguity, found = candidate.guess, 0.0, True
    if candidate.half_m > 0.0:
        window = Window(candidate.guess, candidate.half_m, candidate.half_rad)
        pyramid = Pyramid.of(field, window.half_m)
        few = query.returns.thinned(config.search_points)
        peak = search(pyramid, few, window, config.search_floor)
        found = peak is not None
        if peak is not None:
            start, ambiguity = peak.pose, peak.runner_up / peak.score
    match = match_returns(field, query.returns, start, WEAK_PRIOR)
    verdict = _measure(query, candidate, match, ambiguity)
    reason = _objection(verdict, config) if found else "nothing in the window"
    return replace(verdict, accepted=not reason, reason=reason or "accepted")


def _measure(query: Query, candidate: Candidate, match: Match, ambiguity: float) -> Verdict:
    """The closure between anchors that a match means, with its evidence."""
    overlay = candidate.submap.field.overlay(match.T_field_base, query.returns)
    return Verdict(
        of=candidate.submap.index,
        to=query.anchor,
        T_of_to=match.T_field_base @ query.T_anchor_base.inverse(),
        information=closure_information(match.information, query),
        score=match.score,
        overlap=overlay.overlap,
        hits=overlay.hits,
        crossing=overlay.crossing,
        ambiguity=ambiguity,
        accepted=False,
        reason="",
    )


def closure_information(match_information: FloatArray, query: Query) -> FloatArray:
    """Information (3×3, tangent space at the query's anchor) of a closure between anchors."""
    covariance = invert_spd(match_information + UNKNOWN) + query.covariance
    return invert_spd(carry(covariance, query.T_anchor_base.inverse()))


def _objection(verdict: Verdict, config: ClosureConfig) -> str:
    """Why a match is no loop closure; empty when nothing speaks against it."""
    if verdict.score < config.min_score:
        return "low score"
    if verdict.overlap < config.min_overlap:
        return "little overlap"
    if verdict.hits < config.min_hits:
        return "returns where the submap is free"
    if verdict.crossing > config.max_crossing:
        return "rays through walls"
    if verdict.ambiguity > config.max_ambiguity:
        return "ambiguous"
    return ""
