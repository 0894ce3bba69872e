"""The poses of all steps, each kept relative to the anchor that was current then."""

import numpy as np
import numpy.typing as npt

from protocol.pose import FloatArray, Pose2, compose

FIRST_CAPACITY = 1024


class RelativeTrajectory:
    """`T_anchor_base` for every step, in arrays that double when they are full."""

    def __init__(self) -> None:
        self._anchors: npt.NDArray[np.int64] = np.empty(FIRST_CAPACITY, dtype=np.int64)
        self._relative = np.empty((FIRST_CAPACITY, 3))
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def append(self, anchor: int, T_anchor_base: Pose2) -> None:
        if self._count == len(self._anchors):
            self._anchors = np.concatenate([self._anchors, np.empty_like(self._anchors)])
            self._relative = np.concatenate([self._relative, np.empty_like(self._relative)])
        self._anchors[self._count] = anchor
        self._relative[self._count] = (T_anchor_base.x, T_anchor_base.y, T_anchor_base.theta)
        self._count += 1

    def poses(self, anchors: FloatArray) -> FloatArray:
        """`T_map_base` of every step (n×3), for anchors at `T_map_anchor` (m×3)."""
        return compose(anchors[self._anchors[: self._count]], self._relative[: self._count])
