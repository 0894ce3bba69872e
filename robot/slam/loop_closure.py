"""Loop closure: is this scan part of a submap that was finished long ago, and where?

Candidates are searched as a job (a pure function of a snapshot). Each match found is checked by a
test that the matcher did not use: no rays of the scan through walls of the submap, its returns on
walls wherever the submap knows the place, and no other pose in the window nearly as good.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from protocol.pose import FloatArray, Pose2
from robot.perception.field import Overlay
from robot.perception.matching import match_returns
from robot.perception.returns import Returns
from robot.perception.search import Pyramid, Window, search
from robot.slam.config import ClosureConfig
from robot.slam.engine import Closure
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
    """A finished submap with the guess `T_submap_base`, and the window of a search if that is
    wanted, with the submap as it is searched in one of that size."""

    submap: Submap
    guess: Pose2
    window: Window | None = None
    pyramid: Pyramid | None = None

    @staticmethod
    def searched(submap: Submap, guess: Pose2, half_m: float, half_rad: float) -> "Candidate":
        """With a window of ± `half_m` and ± `half_rad` round the guess."""
        window = Window(guess, half_m, half_rad)
        return Candidate(submap, guess, window, submap.searchable(half_m))


class Verdict(NamedTuple):
    """What became of a candidate: the score of the match, the closure between anchors that it means
    if nothing speaks against it, or else the reason."""

    score: float
    closure: Closure | None
    reason: str


def examine(
    query: Query, candidates: tuple[Candidate, ...], config: ClosureConfig
) -> tuple[Verdict, ...]:
    """Match the query against every candidate and judge each result. Pure: may run as a job."""
    return tuple(_examine(query, candidate, config) for candidate in candidates)


def _examine(query: Query, candidate: Candidate, config: ClosureConfig) -> Verdict:
    submap, start, ambiguity = candidate.submap, candidate.guess, 0.0
    if candidate.window is not None and candidate.pyramid is not None:
        few = query.returns.thinned(config.search_points)
        peak = search(
            candidate.pyramid, few, candidate.window, config.search_floor, config.max_ambiguity
        )
        if peak is None:
            return Verdict(0.0, None, "nothing in the window")
        start, ambiguity = peak.pose, peak.runner_up / peak.score
    match = match_returns(submap.field, query.returns, start, WEAK_PRIOR, wanted=config.min_score)
    if match.score < config.min_score:
        return Verdict(match.score, None, "low score")
    overlay = submap.field.overlay(match.T_field_base, query.returns)
    objection = _objection(overlay, ambiguity, config)
    if objection:
        return Verdict(match.score, None, objection)
    closure = Closure(
        submap.index,
        query.anchor,
        match.T_field_base @ query.T_anchor_base.inverse(),
        closure_information(match.information, query),
    )
    return Verdict(match.score, closure, "accepted")


def closure_information(match_information: FloatArray, query: Query) -> FloatArray:
    """Information (3×3, tangent space at the query's anchor) of a closure between anchors."""
    covariance = invert_spd(match_information + UNKNOWN) + query.covariance
    return invert_spd(carry(covariance, query.T_anchor_base.inverse()))


def _objection(overlay: Overlay, ambiguity: float, config: ClosureConfig) -> str:
    """Why a match is no loop closure; empty when nothing speaks against it."""
    if overlay.overlap < config.min_overlap:
        return "little overlap"
    if overlay.hits < config.min_hits:
        return "returns where the submap is free"
    if overlay.crossing > config.max_crossing:
        return "rays through walls"
    if ambiguity > config.max_ambiguity:
        return "ambiguous"
    return ""
