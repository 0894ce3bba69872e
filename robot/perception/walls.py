"""Which way walls face: a wall matches from both of its sides, off by as much as it is thick."""

import numpy as np
from scipy.spatial import cKDTree

from protocol.pose import FloatArray, Pose2
from robot.perception.field import BoolArray
from robot.perception.returns import Returns

# Surfaces nearer than this lie on one another. The sides of most walls are farther apart.
SAME_M = 0.08
# Enough of a wall's surfaces to hold one of each of its sides, and what stands at its corner.
NEIGHBOURS = 8
# Cosine from which two normals are those of one side, or with the other sign of two.
ALIKE = 0.5


class Walls:
    """Surfaces that were seen, each with the normal towards who saw it."""

    def __init__(self, surfaces: Returns) -> None:
        lined = surfaces.values[np.abs(surfaces.values[:, 2:4]).sum(axis=1) > 0.0]
        self._normals: FloatArray = np.concatenate([lined[:, 2:4], np.zeros((1, 2))])
        self._tree = cKDTree(lined[:, :2])

    def sides(self, pose: Pose2, returns: Returns) -> tuple[BoolArray, BoolArray]:
        """Which of the returns (n), with normals towards who saw them, lie at `pose`
        (`T_walls_base`) on walls seen from the same side, and which on walls seen from the other
        side alone."""
        placed = returns.moved(pose)
        _, near = self._tree.query(placed.points, NEIGHBOURS, distance_upper_bound=SAME_M)
        # Where there are fewer neighbours the tree names the number of all: no normal.
        cosines = (self._normals[near] * placed.values[:, None, 2:4]).sum(axis=-1)
        same: BoolArray = (cosines >= ALIKE).any(axis=1)
        behind: BoolArray = (cosines <= -ALIKE).any(axis=1) & ~same
        return same, behind

    def faced(self, pose: Pose2, returns: Returns, least: int = 1) -> float:
        """Of such returns on walls the share that is seen from the same side; 1 if fewer than
        `least` are on walls, which says nothing."""
        same, behind = (int(side.sum()) for side in self.sides(pose, returns))
        return same / (same + behind) if same + behind >= max(1, least) else 1.0
