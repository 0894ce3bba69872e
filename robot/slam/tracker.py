"""Following the robot in one submap: odometry foretells the pose, matches of scans correct it."""

import math
from typing import NamedTuple

import numpy as np

from protocol.pose import IDENTITY, FloatArray, Pose2, wrap_angle
from robot.perception.matching import Match, match_returns
from robot.perception.odometry import Motion
from robot.perception.returns import Returns
from robot.perception.search import Blocks, Pyramid, Window, search
from robot.slam.config import FrontEndConfig
from robot.slam.gaussian import advance, invert_sum
from robot.slam.submap import Submap

SEARCH_POINTS = 90
SEARCH_FLOOR = 0.3
# Below this share of returns on walls where the place is known, a robot may be lost: a low score
# alone may also mean that it looks into rooms it has not seen.
LOST_HITS = 0.92
# Another match must be so much more likely than the odometry's own, by `Match.value`. Scores would
# prefer the place where more of the scan is mapped: where the robot was before.
CLEARLY = 5.0
# From this score on a climb is not tried from elsewhere too: of some four hundred such climbs that
# led to a clearly better match, on four recorded logs played in four ways, the first one's score
# was 0.87 at most.
GOOD_SCORE = 0.9
# Where the odometry leaves more open than this (σ at the median return), the window is searched.
VAGUE_M = 0.06
# Odometry errs the same way from scan to scan, its covariance says it does not. A prior that
# believed that would bend the map a little with each of many short steps; one this weak holds only
# where the scan does not.
PRIOR_FLOOR = np.diag([0.02**2, 0.02**2, 0.02**2])


class Expected(NamedTuple):
    """Where the odometry puts the robot in a submap, with information (3×3)."""

    pose: Pose2
    information: FloatArray


class Tracker:
    """`pose` in the frame of a submap's anchor; `covariance` (3×3) there, of which
    `match_covariance` is that of the last match alone."""

    def __init__(self, config: FrontEndConfig) -> None:
        self._config = config
        self.pose = IDENTITY
        self.covariance = np.zeros((3, 3))
        self.match_covariance = np.zeros((3, 3))
        self._since_match = np.zeros((3, 3))
        xy, theta = config.drift_m_per_sqrt_m**2, config.drift_rad_per_sqrt_m**2
        self._drift_per_m = np.diag([xy, xy, theta])
        self._last_motion = IDENTITY  # between the last two scans, as matched
        self._last_scan_pose = IDENTITY

    def predict(self, motion: Motion) -> None:
        """Move by the odometry: pose, covariance, and what the next match takes as its prior."""
        self.pose = self.pose @ motion.T_before_now
        self.covariance = advance(self.covariance, motion.T_before_now, motion.covariance)
        self._since_match = advance(self._since_match, motion.T_before_now, motion.covariance)

    def correct(self, submap: Submap, returns: Returns) -> Match:
        """Match a scan in the submap, and be where it says."""
        expected = Expected(self.pose, invert_sum(self._since_match, PRIOR_FLOOR))
        match = self._match(submap, returns, expected)
        self.pose = match.T_field_base
        self._last_motion = self._last_scan_pose.inverse() @ self.pose
        self._last_scan_pose = self.pose
        if match.reason != "few returns":
            self.match_covariance = invert_sum(match.information, expected.information)
            self.covariance = self.match_covariance + self._drift(submap)
            self._since_match = np.zeros((3, 3))
        return match

    def enter(self, T_new_old: Pose2, pose: Pose2) -> None:
        """Go on at `pose` in the frame of another submap."""
        self.pose = pose
        self._last_scan_pose = T_new_old @ self._last_scan_pose

    def _match(self, submap: Submap, returns: Returns, expected: Expected) -> Match:
        """From where the odometry says; and from elsewhere, where that may be wrong."""
        if not submap.keyframes:
            return Match(expected.pose, np.zeros((3, 3)), 1.0, 0.0, 0, True, "converged")
        match = _climb(submap, returns, expected, expected.pose)
        if match.reason == "few returns":
            return match
        steady = self._last_scan_pose @ self._last_motion
        if match.score < GOOD_SCORE and self._is_jerky(steady, returns):
            match = _better(submap, returns, match, _climb(submap, returns, expected, steady))
        if match.score < self._config.doubtful_score or self._is_vague(returns):
            match = _search(submap, returns, expected, self._prior_window(), match)
        if match.score < self._config.lost_score and _hits(submap, returns, match) < LOST_HITS:
            window = Window(self._last_scan_pose, self._config.search_m, self._config.search_rad)
            match = _search(submap, returns, expected, window, match)
        return match

    def _is_jerky(self, steady: Pose2, returns: Returns) -> bool:
        """Whether the odometry stands still or jumps, such that constant velocity would put returns
        out of a climb's reach. After a long way to this scan none is expected."""
        if math.hypot(self._last_motion.x, self._last_motion.y) > self._config.search_m:
            return False
        turned = abs(wrap_angle(steady.theta - self.pose.theta))
        return self.pose.distance_to(steady) > VAGUE_M or returns.are_moved(turned, VAGUE_M)

    def _is_vague(self, returns: Returns) -> bool:
        """Whether the odometry's error may carry returns out of a climb's reach."""
        sigma_m = math.sqrt(max(self._since_match[0, 0], self._since_match[1, 1]))
        sigma_rad = math.sqrt(self._since_match[2, 2])
        return sigma_m > VAGUE_M or returns.are_moved(sigma_rad, VAGUE_M)

    def _prior_window(self) -> Window:
        """All that the odometry leaves open."""
        variance = self._since_match
        half_m = 3.0 * math.sqrt(max(variance[0, 0], variance[1, 1])) + 0.1
        half_rad = 3.0 * math.sqrt(variance[2, 2]) + 0.02
        return Window(self.pose, min(half_m, 1.5), min(half_rad, 1.0))

    def _drift(self, submap: Submap) -> FloatArray:
        """What the submap itself may be bent by, growing with its travel."""
        return self._drift_per_m * (submap.travel_m + 0.05)


def _climb(submap: Submap, returns: Returns, expected: Expected, start: Pose2) -> Match:
    return match_returns(submap.field, returns, expected.pose, expected.information, start)


def _search(
    submap: Submap, returns: Returns, expected: Expected, window: Window, first: Match
) -> Match:
    """The best match in a window, if it is clearly better than the first one."""
    few = returns.thinned(SEARCH_POINTS)
    if submap.finished:
        pyramid = submap.searchable(window.half_m)
    else:
        pyramid = Pyramid.of(Blocks.under(submap.field, few.points, window), window.half_m)
    floor = max(SEARCH_FLOOR, first.score)
    peak = search(pyramid, few, window, floor, share=1.0, known=first.T_field_base)
    if peak is None:
        return first
    return _better(submap, returns, first, _climb(submap, returns, expected, peak.pose))


def _hits(submap: Submap, returns: Returns, match: Match) -> float:
    """The share of returns on walls, of those that lie where the submap knows the place."""
    return submap.field.overlay(match.T_field_base, returns, rays=False).hits


def _better(submap: Submap, returns: Returns, first: Match, other: Match) -> Match:
    """The other match only if it is clearly more likely, also by what speaks against a place.

    `Match.value` counts walls that are met, and so draws a scan that shows new ground back over
    the old: there it has rays through walls, and returns in free ground.
    """
    gain = other.value - first.value
    if gain <= CLEARLY:
        return first
    gain -= _contradiction(submap, returns, other) - _contradiction(submap, returns, first)
    return other if gain > CLEARLY else first


def _contradiction(submap: Submap, returns: Returns, match: Match) -> float:
    """Weight of the returns where the submap is free, and of rays through its walls."""
    compared, hits, _, crossing = submap.field.compare(match.T_field_base, returns)
    return float(compared - hits + crossing * returns.values[:, 4].mean())
