"""An occupancy map that follows the keyframes it is made of when their anchors move."""

from collections import deque

import numpy as np

from protocol.config import LidarConfig
from protocol.pose import FloatArray, Pose2, wrap_angles
from robot.mapping.occupancy import OccupancyMap
from robot.team.joint import JointGraph, Solution, anchor_poses, keyframe_poses
from robot.team.journal import LogName
from robot.team.log_graph import LogGraph

# A keyframe that moved less than this stays where it is drawn: a fraction of a cell.
MOVED_M, MOVED_RAD = 0.01, 0.002


class KeyframeMap:
    """The map of all keyframes whose logs are placed; redrawn a few keyframes at a time."""

    def __init__(self, lidar: LidarConfig) -> None:
        self.map = OccupancyMap(lidar=lidar)
        self._wanted: dict[LogName, FloatArray] = {}
        self._drawn: dict[LogName, FloatArray] = {}
        self._queue: deque[tuple[LogName, int]] = deque()

    @property
    def waiting(self) -> int:
        """How many keyframes are not drawn where they belong."""
        return len(self._queue)

    def lookouts(self) -> FloatArray:
        """Where (n×2, m) the keyframes that are drawn were taken."""
        drawn = [poses[~np.isnan(poses[:, 0]), :2] for _, poses in sorted(self._drawn.items())]
        return np.concatenate([np.empty((0, 2)), *drawn])

    def follow(self, graph: JointGraph, placed: Solution) -> None:
        """Note where the keyframes belong, for `placed` poses (m×3) of the anchors of logs; those
        of other logs leave the map at once."""
        for name in sorted(set(self._drawn) - set(placed)):
            log = graph.log(name)
            assert log is not None
            for index in range(len(self._drawn[name])):
                self._take_out(name, log, index)
            del self._drawn[name], self._wanted[name]
        for name in sorted(placed):
            log = graph.log(name)
            if log is None or not log.anchors:
                continue
            wanted = keyframe_poses(log, anchor_poses(log, placed[name]))
            drawn = self._drawn.get(name, np.zeros((0, 3)))
            missing = np.full((len(wanted) - len(drawn), 3), np.nan)
            self._wanted[name], self._drawn[name] = wanted, np.concatenate([drawn, missing])
        self._queue = deque(
            (name, int(index))
            for name in sorted(self._wanted)
            for index in np.flatnonzero(_moved(self._drawn[name], self._wanted[name]))
        )

    def draw(self, graph: JointGraph, most: int) -> None:
        """Draw up to `most` of the keyframes that are not where they belong."""
        for _ in range(min(most, len(self._queue))):
            name, index = self._queue.popleft()
            log = graph.log(name)
            assert log is not None
            self._draw_one(name, log, index)

    def _draw_one(self, name: LogName, log: LogGraph, index: int) -> None:
        pose = self._wanted[name][index]
        self._take_out(name, log, index)
        self.map.add(Pose2.from_array(pose), log.scan(index))
        self._drawn[name][index] = pose

    def _take_out(self, name: LogName, log: LogGraph, index: int) -> None:
        """Off the map with a keyframe, if it is on it."""
        pose = self._drawn[name][index]
        if not np.isnan(pose[0]):
            self.map.remove(Pose2.from_array(pose), log.scan(index))


def draw_exactly(graph: JointGraph, placed: Solution, lidar: LidarConfig) -> OccupancyMap:
    """The map of `placed` anchors from nothing: a pure function of the journal's entries."""
    fresh = KeyframeMap(lidar)
    fresh.follow(graph, placed)
    fresh.draw(graph, fresh.waiting)
    return fresh.map


def _moved(drawn: FloatArray, wanted: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Which poses (n) differ, or are not drawn yet (NaN)."""
    shift = np.hypot(wanted[:, 0] - drawn[:, 0], wanted[:, 1] - drawn[:, 1])
    turn = np.abs(wrap_angles(wanted[:, 2] - drawn[:, 2]))
    return ~((shift <= MOVED_M) & (turn <= MOVED_RAD))
