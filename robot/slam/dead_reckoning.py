"""Dead reckoning: wheel odometry alone, the baseline of every comparison."""

import numpy as np

from protocol.config import BodyConfig, LidarConfig
from protocol.pose import FloatArray, Pose2
from robot.jobs import Jobs
from robot.perception.odometry import Motion
from robot.perception.scan import LaserScan
from robot.slam.engine import Estimate, Keyframe, Mapless
from robot.slam.gaussian import carry
from robot.slam.trajectory import RelativeTrajectory

KEYFRAME_M = 0.3
KEYFRAME_RAD = 0.3


class DeadReckoning(Mapless):
    """One anchor at the start, never corrected; keyframes are kept so that it draws a map too."""

    def __init__(self, lidar: LidarConfig, body: BodyConfig, start: Pose2, jobs: Jobs) -> None:
        del lidar, body, jobs
        super().__init__(start)
        self._pose = Pose2(0.0, 0.0, 0.0)
        self._covariance = np.zeros((3, 3))
        self._trajectory = RelativeTrajectory()
        self._keyframes = 0
        self._last_keyframe: Pose2 | None = None

    def step(
        self, tick: int, motion: Motion, scan: LaserScan | None, explored: bool = False
    ) -> Estimate:
        """Add a motion: pose and covariance are composed, nothing ever shrinks the latter."""
        del explored
        self._covariance = carry(self._covariance, motion.T_before_now) + motion.covariance
        self._pose = self._pose @ motion.T_before_now
        self._trajectory.append(0, self._pose)
        if scan is not None and self._moved_enough():
            self._keep(tick, scan)
        return Estimate(self._T_map_anchor @ self._pose, self._covariance.copy())

    def trajectory(self, anchors: FloatArray | None = None) -> FloatArray:
        return self._trajectory.poses(self.anchors if anchors is None else anchors)

    def _moved_enough(self) -> bool:
        if self._last_keyframe is None:
            return True
        moved = self._last_keyframe.inverse() @ self._pose
        return abs(moved.theta) > KEYFRAME_RAD or np.hypot(moved.x, moved.y) > KEYFRAME_M

    def _keep(self, tick: int, scan: LaserScan) -> None:
        self._entries.append(
            Keyframe(self._keyframes, tick, 0, self._pose, self._covariance.copy(), scan.ranges)
        )
        self._keyframes += 1
        self._last_keyframe = self._pose
