"""Dead reckoning: wheel odometry alone, the baseline of every comparison."""

import numpy as np

from protocol.config import BodyConfig, LidarConfig
from protocol.pose import FloatArray, Pose2
from robot.jobs import Jobs
from robot.perception.odometry import Motion
from robot.perception.scan import LaserScan
from robot.slam.engine import Anchor, Entry, Estimate, GraphSnapshot, Keyframe
from robot.slam.gaussian import carry
from robot.slam.packed_submap import PackedSubmap
from robot.slam.trajectory import RelativeTrajectory

KEYFRAME_M = 0.3
KEYFRAME_RAD = 0.3


class DeadReckoning:
    """One anchor at the start, never corrected; keyframes are kept so that it draws a map too."""

    def __init__(self, lidar: LidarConfig, body: BodyConfig, start: Pose2, jobs: Jobs) -> None:
        del lidar, body, jobs
        self._start = start
        self._pose = Pose2(0.0, 0.0, 0.0)
        self._covariance = np.zeros((3, 3))
        self._trajectory = RelativeTrajectory()
        self._entries: list[Entry] = [Anchor(0, start, np.eye(3) * 1e6)]
        self._keyframes = 0
        self._last_keyframe: Pose2 | None = None

    @property
    def loop_closures(self) -> int:
        return 0

    @property
    def anchors(self) -> FloatArray:
        return self._start.to_array()[None, :]

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
        return Estimate(self._start @ self._pose, self._covariance.copy())

    def take_entries(self) -> list[Entry]:
        entries, self._entries = self._entries, []
        return entries

    @property
    def submaps(self) -> tuple[PackedSubmap, ...]:
        return ()

    def mapped(self) -> tuple[PackedSubmap, ...]:
        return ()

    def trajectory(self, anchors: FloatArray | None = None) -> FloatArray:
        return self._trajectory.poses(self.anchors if anchors is None else anchors)

    def graph(self) -> GraphSnapshot:
        return GraphSnapshot(
            self.anchors,
            np.empty((0, 2), dtype=np.int32),
            np.empty((0, 3)),
            np.empty((0, 3, 3)),
        )

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
