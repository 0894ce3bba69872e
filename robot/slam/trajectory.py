"""The poses of all steps, each kept relative to the anchor that was current then."""

import numpy as np

from protocol.pose import FloatArray, Pose2, compose
from robot.rows import Rows


class RelativeTrajectory:
    """`T_anchor_base` for every step."""

    def __init__(self) -> None:
        self._anchors = Rows(1, np.int32)
        self._relative = Rows(3)

    def __len__(self) -> int:
        return len(self._anchors)

    def append(self, anchor: int, T_anchor_base: Pose2) -> None:
        self._anchors.append(anchor)
        self._relative.append(T_anchor_base.x, T_anchor_base.y, T_anchor_base.theta)

    def poses(self, anchors: FloatArray) -> FloatArray:
        """`T_map_base` of every step (n×3), for anchors at `T_map_anchor` (m×3)."""
        return compose(anchors[self._anchors.values[:, 0]], self._relative.values)
