"""The front end: the submap that the robot is followed in, and when a new one starts.

Two submaps overlap: the older is matched against while the newer fills, and takes its place when
it is full. So the map that is matched against always reaches back some way.
"""

from dataclasses import dataclass
from typing import NamedTuple

from protocol.config import LidarConfig
from protocol.pose import IDENTITY, FloatArray, Pose2, wrap_angle
from robot.perception.field import CorrelationField
from robot.perception.matching import Match
from robot.perception.odometry import Motion
from robot.perception.returns import Returns, describe_returns, noise_model
from robot.perception.scan import LaserScan
from robot.slam.config import FrontEndConfig
from robot.slam.gaussian import invert_spd
from robot.slam.submap import Submap
from robot.slam.tracker import Tracker


@dataclass(frozen=True, slots=True)
class NewAnchor:
    """A submap that starts: its anchor as seen from that of submap `of`, with information."""

    of: int
    index: int
    T_of_anchor: Pose2
    information: FloatArray


class Progress(NamedTuple):
    """What a scan led to: whether the robot has moved on (and drawn the scan, unless the submap is
    a finished one), an anchor that starts, a submap that is full."""

    match: Match
    returns: Returns
    moved: bool
    anchor: NewAnchor | None = None
    finished: Submap | None = None


class FrontEnd:
    """Pose in the frame of the current submap's anchor, with covariance."""

    TRANSIENT = ("_spare",)

    def __init__(self, lidar: LidarConfig, config: FrontEndConfig) -> None:
        self._config = config
        self._noise = noise_model(lidar)
        self._range_m = min(lidar.max_range_m, config.usable_range_m)
        self._newest = -1
        self._spare: CorrelationField | None = None  # empty, for the next submap
        self.current = self._new_submap()
        self._next: Submap | None = None
        self._T_current_next = IDENTITY
        self._tracker = Tracker(config)
        self._last_drawn: Pose2 | None = None

    @property
    def pose(self) -> Pose2:
        """`T_anchor_base` of the current submap."""
        return self._tracker.pose

    @property
    def covariance(self) -> FloatArray:
        """3×3, tangent space at the pose, against the anchor."""
        return self._tracker.covariance

    @property
    def match_covariance(self) -> FloatArray:
        """That of the last match alone: what the submap may be bent by is not in it."""
        return self._tracker.match_covariance

    def predict(self, motion: Motion) -> None:
        """Move by the odometry."""
        self._tracker.predict(motion)

    def correct(self, scan: LaserScan) -> Progress:
        """Match the scan, draw it if the robot has moved on, turn over submaps that are full."""
        returns = describe_returns(scan, self._noise, self._range_m)
        match = self._tracker.correct(self.current, returns)
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
        left = [filling for filling in (self.current, self._next) if filling is not None]
        left = [filling for filling in left if not filling.finished]
        for filling in left:
            filling.finish()
        self.current, self._next = submap, None
        self._spare = None  # on known ground no submap is started soon
        self._enter(T_submap_base @ self.pose.inverse(), T_submap_base)
        return left

    def depart(self, returns: Returns) -> NewAnchor:
        """Leave a finished submap for an empty one, whose anchor is where the robot is now."""
        of, T_of_anchor = self.current.index, self.pose
        self.current = self._new_submap()
        self._enter(T_of_anchor.inverse(), IDENTITY)
        self.current.insert(IDENTITY, returns)
        return NewAnchor(of, self.current.index, T_of_anchor, invert_spd(self.covariance))

    # submaps

    def _new_submap(self) -> Submap:
        self._newest += 1
        spare, self._spare = self._spare, None
        extent_m = self._range_m + self._config.submap_m + 0.5
        return Submap.start(self._newest, extent_m, spare)

    def _enter(self, T_new_old: Pose2, pose: Pose2) -> None:
        """Go on at a pose in the frame of another submap, where this scan counts as drawn."""
        self._tracker.enter(T_new_old, pose)
        self._last_drawn = pose

    def _moved_enough(self) -> bool:
        if self._last_drawn is None:
            return True
        turned = abs(wrap_angle(self.pose.theta - self._last_drawn.theta))
        far = self._last_drawn.distance_to(self.pose) >= self._config.keyframe_m
        return far or turned >= self._config.keyframe_rad

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
        self._enter(to_next, to_next @ self.pose)
        self._next = None
        self._spare = finished.finish()
        return finished
