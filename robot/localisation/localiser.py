"""Localisation without mapping: where the robot is in a known map, which stays as it is.

The front end follows the robot as it does on known ground, in the whole map as one finished
submap. Before the place is known, and after it was lost, hypotheses are followed instead
(`GlobalLocaliser`); the way until they are settled is then told by the odometry back from there.
"""

import math

import numpy as np

from protocol.config import LidarConfig
from protocol.pose import IDENTITY, FloatArray, Pose2, compose
from robot.localisation.hypotheses import GlobalLocaliser
from robot.localisation.known_map import KnownMap
from robot.perception.odometry import Motion
from robot.perception.scan import LaserScan
from robot.rows import Rows
from robot.slam.config import FrontEndConfig
from robot.slam.engine import Estimate, Keyframe, Mapless
from robot.slam.front_end import FrontEnd, Progress

# Nobody knows where: a covariance that no map is larger than (m², rad²).
ANYWHERE = np.diag([1e6, 1e6, math.pi**2])
# So many scans in a row that the map explains so badly (returns where it is free, rays through its
# walls, as shares): the place is lost.
LOST_MISFIT, LOST_SCANS = 0.35, 12


class Localiser(Mapless):
    """An engine (`robot.slam.engine.Engine`) that maps nothing; its one anchor is the map's."""

    def __init__(
        self,
        known: KnownMap,
        lidar: LidarConfig,
        start: Pose2 | None,
        config: FrontEndConfig | None = None,
    ) -> None:
        super().__init__(IDENTITY)
        self._known = known
        self._lidar = lidar
        self._config = config or FrontEndConfig()
        self._front_end: FrontEnd | None = None
        self._search: GlobalLocaliser | None = None
        self._odometry = IDENTITY
        self._waiting = Rows(3)  # by the odometry, since the place is not known
        self._poses = Rows(3)
        self._keyframes = 0
        self._last_kept: Pose2 | None = None
        self._off = 0
        self.losses = 0
        """How often the place was lost again."""
        if start is None:
            self._search = GlobalLocaliser(known, lidar)
        else:
            self._front_end = self._at(start)

    @property
    def settled(self) -> bool:
        """Whether the robot knows where it is."""
        return self._front_end is not None

    def step(
        self, tick: int, motion: Motion, scan: LaserScan | None, explored: bool = False
    ) -> Estimate:
        """Follow the motion and the scan, or look for the place."""
        del explored
        self._odometry = self._odometry @ motion.T_before_now
        if self._search is not None:
            return self._look_for_place(self._search, motion, scan)
        front_end = self._front_end
        assert front_end is not None
        front_end.predict(motion)
        if scan is not None:
            progress = front_end.correct(scan)
            self._keep(tick, front_end.pose, scan)
            if progress.moved and self._is_lost(front_end, progress):
                self._front_end, self._search = None, GlobalLocaliser(self._known, self._lidar)
                self._odometry = front_end.pose
                self.losses += 1
        self._poses.append(front_end.pose.x, front_end.pose.y, front_end.pose.theta)
        return Estimate(front_end.pose, front_end.covariance)

    def _look_for_place(
        self, search: GlobalLocaliser, motion: Motion, scan: LaserScan | None
    ) -> Estimate:
        search.step(motion, scan)
        self._waiting.append(self._odometry.x, self._odometry.y, self._odometry.theta)
        if search.settled is not None:
            pose = search.settled.pose
            self._search, self._front_end = None, self._at(pose)
            for row in self._carried(pose):
                self._poses.append(*row)
            self._waiting = Rows(3)
            return Estimate(pose, self._front_end.covariance)
        best = search.hypotheses[0].pose if search.hypotheses else self._odometry
        return Estimate(best, ANYWHERE)

    def _carried(self, pose: Pose2) -> FloatArray:
        """The steps that wait (k×3), by the odometry, if the last of them was at a pose."""
        T_map_odom = pose @ self._odometry.inverse()
        return compose(T_map_odom.to_array(), self._waiting.values)

    def _at(self, pose: Pose2) -> FrontEnd:
        front_end = FrontEnd(self._lidar, self._config)
        front_end.settle(self._known.submap(), pose)
        return front_end

    def _is_lost(self, front_end: FrontEnd, progress: Progress) -> bool:
        overlay = self._known.field.overlay(front_end.pose, progress.returns)
        misfit = 1.0 - overlay.hits + overlay.crossing
        self._off = self._off + 1 if misfit > LOST_MISFIT else 0
        if self._off < LOST_SCANS:
            return False
        self._off = 0
        return True

    def _keep(self, tick: int, pose: Pose2, scan: LaserScan) -> None:
        """Keyframes to draw what was seen, where the known map puts it."""
        if self._last_kept is not None:
            moved = self._last_kept.inverse() @ pose
            near = math.hypot(moved.x, moved.y) < self._config.journal_m
            if near and abs(moved.theta) < self._config.journal_rad:
                return
        self._last_kept = pose
        self._entries.append(Keyframe(self._keyframes, tick, 0, pose, ANYWHERE.copy(), scan.ranges))
        self._keyframes += 1

    def trajectory(self, anchors: FloatArray | None = None) -> FloatArray:
        """The pose at every step; where the place is not known yet, as the best hypothesis, or the
        odometry alone, would have it."""
        del anchors
        if self._search is None:
            return self._poses.values.copy()
        best = self._search.hypotheses[0].pose if self._search.hypotheses else self._odometry
        return np.concatenate([self._poses.values, self._carried(best)])
