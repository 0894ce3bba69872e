"""What truly happened: poses, velocities and collisions at every tick."""

from typing import Any

import numpy as np
import numpy.typing as npt

from maps.grid import BoolArray
from protocol.pose import FloatArray


class History:
    """Grows by one row a tick; row k is of tick k.

    A row takes 49 bytes for each robot, and room is made in steps of half of what there is: 1.8 to
    2.7 MB for a robot and simulated hour.
    """

    def __init__(self, robots: int) -> None:
        self._length = 0
        self._poses = np.zeros((256, robots, 3))
        self._velocities = np.zeros((256, robots, 2))
        self._collisions = np.zeros((256, robots), dtype=np.int64)
        self._present = np.zeros((256, robots), dtype=bool)

    def __len__(self) -> int:
        return self._length

    @property
    def poses(self) -> FloatArray:
        """True poses, T×n×3 (m, m, rad), in the world frame."""
        return self._poses[: self._length]

    @property
    def velocities(self) -> FloatArray:
        """How the wheels drove to each tick, T×n×2 (m/s forward, rad/s)."""
        return self._velocities[: self._length]

    @property
    def collisions(self) -> npt.NDArray[np.int64]:
        """Collisions of each robot up to each tick, T×n."""
        return self._collisions[: self._length]

    @property
    def present(self) -> BoolArray:
        """Which robots were alive at each tick, T×n."""
        return self._present[: self._length]

    def driven_m(self, robot: int) -> float:
        """How far a robot truly moved so far (m)."""
        steps = np.diff(self.poses[:, robot, :2], axis=0)
        return float(np.hypot(steps[:, 0], steps[:, 1]).sum())

    def append(
        self,
        poses: FloatArray,
        velocities: FloatArray,
        collisions: npt.NDArray[np.int64],
        present: BoolArray,
    ) -> None:
        """Add the next tick."""
        if self._length == len(self._poses):
            self._grow()
        k = self._length
        self._poses[k] = poses
        self._velocities[k] = velocities
        self._collisions[k] = collisions
        self._present[k] = present
        self._length += 1

    def _grow(self) -> None:
        self._poses = _longer(self._poses)
        self._velocities = _longer(self._velocities)
        self._collisions = _longer(self._collisions)
        self._present = _longer(self._present)


def _longer(rows: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """The same rows with room for half as many more."""
    return np.concatenate([rows, np.zeros_like(rows[: len(rows) // 2])])
