"""The front end: where the robot is in the present submap, and when a new submap starts.

Two submaps overlap: the older is matched against while the newer fills, and takes its place when
it is full. So the map that is matched against always reaches back some way.
"""

import math
from dataclasses import dataclass

import numpy as np

from protocol.config import LidarConfig
from protocol.pose import IDENTITY, FloatArray, Pose2
from robot.perception.matching import Match, match_returns
from robot.perception.odometry import Motion
from robot.perception.returns import Returns, describe_returns, noise_model
from robot.perception.scan import LaserScan
from robot.perception.search import Blocks, Pyramid, Window, search
from robot.slam.config import FrontEndConfig
from robot.slam.gaussian import carry, invert_spd
from robot.slam.submap import Submap

SEARCH_POINTS = 90
SEARCH_FLOOR = 0.3
# Below this share of returns on walls where the place is known, a robot may be lost: a low score
# alone may also mean that it looks into rooms it has not seen.
LOST_HITS = 0.92
# Another match must be so much more likely than the odometry's own, by `Match.value`. Scores would
# prefer the place where more of the scan is mapped: where the robot was before.
CLEARLY = 5.0
# Where the odometry leaves more open than this (σ at the median return), the window is searched.
VAGUE_M = 0.06
# Odometry errs the same way from scan to scan, its covariance says it does not. A prior that
# believed that would bend the map a little with each of many short steps; one this weak holds only
# where the scan does not.
PRIOR_FLOOR = np.diag([0.03**2, 0.03**2, 0.03**2])


@dataclass(frozen=True, slots=True)
class Expected:
    """Where the odometry puts the robot in the submap, with information (3×3)."""

    pose: Pose2
    information: FloatArray


@dataclass(frozen=True, slots=True)
class NewAnchor:
    """A submap that starts: its anchor as seen from that of submap `of`, with information."""

    of: int
    index: int
    T_of_anchor: Pose2
    information: FloatArray


@dataclass(frozen=True, slots=True)
class Progress:
    """What a scan led to: whether the robot has moved on (and drawn the scan, unless the submap is
    a finished one), an anchor that starts, a submap that is full."""

    match: Match
    returns: Returns
    moved: bool
    anchor: NewAnchor | None = None
    finished: Submap | None = None


class FrontEnd:
    """Pose in the frame of the current submap's anchor, with covariance."""

    def __init__(self, lidar: LidarConfig, config: FrontEndConfig) -> None:
        self._config = config
        self._noise = noise_model(lidar)
        self._range_m = min(lidar.max_range_m, config.usable_range_m)
        self._newest = -1
        self.current = self._new_submap()
        self._next: Submap | None = None
        self._T_current_next = IDENTITY
        self.pose = IDENTITY  # T_anchor_base of the current submap
        self.covariance = np.zeros((3, 3))
        self.match_covariance = np.zeros((3, 3))
        self._since_match = np.zeros((3, 3))
        self._last_motion = IDENTITY  # between the last two scans, as matched
        self._last_scan_pose = IDENTITY
        self._last_drawn: Pose2 | None = None

    def predict(self, motion: Motion) -> None:
        """Move by the odometry: pose, covariance, and what the next match takes as its prior."""
        self.pose = self.pose @ motion.T_before_now
        self.covariance = carry(self.covariance, motion.T_before_now) + motion.covariance
        self._since_match = carry(self._since_match, motion.T_before_now) + motion.covariance

    def correct(self, scan: LaserScan) -> Progress:
        """Match the scan, draw it if the robot has moved on, turn over submaps that are full."""
        returns = describe_returns(scan, self._noise, self._range_m)
        match = self._match(returns)
        self._accept(match)
        if not self._moved_enough():
            return Progress(match, returns, moved=False)
        self._last_drawn = self.pose
        if self.current.finished:
            return Progress(match, returns, moved=True)
        self._draw(returns)
        finished = self._turn_over() if self._fill(self.current) >= 1.0 else None
        anchor = self._start_next(returns) if self._fill(self.current) >= 0.5 else None
        return Progress(match, returns, True, anchor, finished)

    def settle(self, submap: Submap, T_submap_base: Pose2) -> list[Submap]:
        """Go on in a finished submap, in which nothing is drawn any more; what was being filled is
        finished as it is, and returned."""
        T_submap_current = T_submap_base @ self.pose.inverse()
        left = [filling for filling in (self.current, self._next) if filling is not None]
        left = [filling for filling in left if not filling.finished]
        for filling in left:
            filling.finish()
        self.current, self._next = submap, None
        self.pose = self._last_drawn = T_submap_base
        self._last_scan_pose = T_submap_current @ self._last_scan_pose
        return left

    def depart(self, returns: Returns) -> NewAnchor:
        """Leave a finished submap for an empty one, whose anchor is where the robot is now."""
        of, T_of_anchor = self.current.index, self.pose
        self.current = self._new_submap()
        self._last_scan_pose = T_of_anchor.inverse() @ self._last_scan_pose
        self.pose = self._last_drawn = IDENTITY
        self.current.insert(IDENTITY, returns)
        return NewAnchor(of, self.current.index, T_of_anchor, invert_spd(self.covariance))

    # matching

    def _match(self, returns: Returns) -> Match:
        submap = self.current
        if not submap.keyframes:
            return Match(self.pose, np.zeros((3, 3)), 1.0, 0.0, 0, True, "converged")
        expected = Expected(self.pose, invert_spd(self._since_match + PRIOR_FLOOR))
        match = self._climb(returns, expected, self.pose)
        if match.reason == "few returns":
            return match
        reach = returns.median_range_m
        if self._is_jerky(reach):
            steady = self._last_scan_pose @ self._last_motion
            match = _better(match, self._climb(returns, expected, steady))
        if match.score < self._config.doubtful_score or self._is_vague(reach):
            half_m, half_rad = self._prior_window()
            match = self._search(returns, match, expected, Window(self.pose, half_m, half_rad))
        if match.score >= self._config.lost_score or self._hits(match, returns) >= LOST_HITS:
            return match
        window = Window(self._last_scan_pose, self._config.search_m, self._config.search_rad)
        return self._search(returns, match, expected, window)

    def _climb(self, returns: Returns, expected: Expected, start: Pose2) -> Match:
        field = self.current.field
        return match_returns(field, returns, expected.pose, expected.information, start)

    def _is_jerky(self, reach: float) -> bool:
        """Whether the odometry stands still or jumps, such that constant velocity would put returns
        (`reach` m away) out of a climb's reach. After a long way to this scan none is expected."""
        if math.hypot(self._last_motion.x, self._last_motion.y) > self._config.search_m:
            return False
        apart = self.pose.inverse() @ (self._last_scan_pose @ self._last_motion)
        return max(math.hypot(apart.x, apart.y), abs(apart.theta) * reach) > VAGUE_M

    def _is_vague(self, reach: float) -> bool:
        """Whether the odometry's error may carry returns `reach` m away out of a climb's reach."""
        sigma_m = math.sqrt(max(self._since_match[0, 0], self._since_match[1, 1]))
        sigma_rad = math.sqrt(self._since_match[2, 2])
        return max(sigma_m, sigma_rad * reach) > VAGUE_M

    def _prior_window(self) -> tuple[float, float]:
        """Half extents (m, rad) of what the odometry leaves open."""
        variance = self._since_match
        half_m = 3.0 * math.sqrt(max(variance[0, 0], variance[1, 1])) + 0.1
        return min(half_m, 1.5), min(3.0 * math.sqrt(variance[2, 2]) + 0.02, 1.0)

    def _search(self, returns: Returns, first: Match, expected: Expected, window: Window) -> Match:
        """The best match in a window, if it is clearly better than the first one."""
        few = returns.thinned(SEARCH_POINTS)
        reach = window.half_m + float(np.hypot(few.points[:, 0], few.points[:, 1]).max())
        seen = self.current.blocks or Blocks.around(self.current.field, window.centre, reach)
        pyramid = Pyramid.of(seen, window.half_m)
        peak = search(pyramid, few, window, max(SEARCH_FLOOR, first.score))
        return first if peak is None else _better(first, self._climb(returns, expected, peak.pose))

    def _hits(self, match: Match, returns: Returns) -> float:
        """The share of returns on walls, of those that lie where the submap knows the place."""
        return self.current.field.overlay(match.T_field_base, returns, rays=False).hits

    def _accept(self, match: Match) -> None:
        prior = invert_spd(self._since_match + PRIOR_FLOOR)
        self.pose = match.T_field_base
        moved = self._last_scan_pose.inverse() @ self.pose
        self._last_motion, self._last_scan_pose = moved, self.pose
        if match.reason == "few returns":
            return
        self.match_covariance = invert_spd(match.information + prior)
        self.covariance = self.match_covariance + self._drift()
        self._since_match = np.zeros((3, 3))

    def _drift(self) -> FloatArray:
        """What the submap itself may be bent by, growing with its travel."""
        travel = self.current.travel_m + 0.05
        xy = self._config.drift_m_per_sqrt_m**2 * travel
        return np.diag([xy, xy, self._config.drift_rad_per_sqrt_m**2 * travel])

    # submaps

    def _new_submap(self) -> Submap:
        self._newest += 1
        return Submap.start(self._newest, self._range_m + self._config.submap_m + 0.5)

    def _moved_enough(self) -> bool:
        if self._last_drawn is None:
            return True
        moved = self._last_drawn.inverse() @ self.pose
        far = math.hypot(moved.x, moved.y) >= self._config.keyframe_m
        return far or abs(moved.theta) >= self._config.keyframe_rad

    def _fill(self, submap: Submap) -> float:
        """How full a submap is, 1 when it must be finished."""
        by_count = len(submap.keyframes) / self._config.submap_keyframes
        return max(by_count, submap.travel_m / self._config.submap_m)

    def _draw(self, returns: Returns) -> None:
        self.current.insert(self.pose, returns)
        if self._next is not None:
            self._next.insert(self._T_current_next.inverse() @ self.pose, returns)

    def _start_next(self, returns: Returns) -> NewAnchor | None:
        """A submap whose anchor is where the robot is now; the scan just drawn is its first."""
        if self._next is not None:
            return None
        self._next = self._new_submap()
        self._next.insert(IDENTITY, returns)
        self._T_current_next = self.pose
        information = invert_spd(self.covariance)
        return NewAnchor(self.current.index, self._next.index, self.pose, information)

    def _turn_over(self) -> Submap | None:
        """The filling submap takes over; poses are from now on relative to its anchor."""
        if self._next is None:
            return None
        finished, self.current = self.current, self._next
        to_next = self._T_current_next.inverse()
        self.pose = to_next @ self.pose
        self._last_scan_pose = to_next @ self._last_scan_pose
        self._last_drawn = self.pose
        self._next = None
        finished.finish()
        return finished


def _better(first: Match, other: Match) -> Match:
    """The other match only if it is clearly more likely."""
    return other if other.value > first.value + CLEARLY else first
