"""The interface of every SLAM engine, and what engines hand to the journal.

Global poses are derived, never stored twice: keyframes hold poses relative to their anchor (the
origin of a submap), and an optimiser moves anchors alone. A new engine is one file that has
these methods, and its name in `robot.slam.engines`.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from protocol.pose import FloatArray, Pose2
from robot.perception.odometry import Motion
from robot.perception.scan import LaserScan

if TYPE_CHECKING:
    from robot.slam.packed_submap import PackedSubmap


class Estimate(NamedTuple):
    """`T_map_base` with its covariance (3×3), tangent space at the base, order (x, y, θ)."""

    pose: Pose2
    covariance: FloatArray


@dataclass(frozen=True, slots=True)
class Anchor:
    """The origin of submap `index`, as measured against the one before it.

    For index 0 `T_previous_anchor` is the anchor's pose in the engine's map frame. `information`
    (3×3) is the inverse covariance in the tangent space at the anchor.
    """

    index: int
    T_previous_anchor: Pose2
    information: FloatArray


@dataclass(frozen=True, slots=True)
class Keyframe:
    """A scan worth keeping, at a pose relative to anchor `anchor`.

    `ranges` (n) as in LaserScan. `covariance` (3×3) of the relative pose.
    """

    index: int
    tick: int
    anchor: int
    T_anchor_keyframe: Pose2
    covariance: FloatArray
    ranges: FloatArray


@dataclass(frozen=True, slots=True)
class Closure:
    """A verified loop closure: anchor `to` as seen from anchor `of`, with information (3×3)."""

    of: int
    to: int
    T_of_to: Pose2
    information: FloatArray


Entry = Anchor | Keyframe | Closure


@dataclass(frozen=True, slots=True)
class GraphSnapshot:
    """A pose graph: node poses m×3; edges i, j (k×2), measurements T_i_j (k×3), information
    (k×3×3)."""

    nodes: FloatArray
    edge_nodes: npt.NDArray[np.int32]
    measurements: FloatArray
    information: FloatArray


class Engine(Protocol):
    """SLAM of one robot. Deterministic: the same steps give the same results to the last bit."""

    @property
    def loop_closures(self) -> int:
        """How many closures were accepted so far."""

    @property
    def anchors(self) -> FloatArray:
        """`T_map_anchor` of every anchor (m×3), as optimised now; not to be written to."""

    def step(
        self, tick: int, motion: Motion, scan: LaserScan | None, explored: bool = False
    ) -> Estimate:
        """Take the motion since the last step, and the scan at its end if there is one.

        In a building that is `explored` an engine may map no more than it needs to know where it
        is."""

    def take_entries(self) -> list[Entry]:
        """What is new for the journal since the last call, in an order that can be replayed:
        an anchor before its keyframes, both ends of a closure before it."""

    @property
    def submaps(self) -> "tuple[PackedSubmap, ...]":
        """The finished submaps, oldest first, in which others' scans can be found again."""

    def mapped(self) -> "tuple[PackedSubmap, ...]":
        """All submaps as they are now: those that are finished, and the one being filled."""

    def trajectory(self, anchors: FloatArray | None = None) -> FloatArray:
        """The pose at every step so far (n×3), as optimised now, or with its anchors elsewhere
        (m×3, all of them)."""

    def graph(self) -> GraphSnapshot:
        """The pose graph over anchors."""


class Mapless:
    """What engines that build no submaps have in common: one anchor that nothing moves."""

    def __init__(self, T_map_anchor: Pose2) -> None:
        self._T_map_anchor = T_map_anchor
        self._entries: list[Entry] = [Anchor(0, T_map_anchor, np.eye(3) * 1e6)]

    @property
    def loop_closures(self) -> int:
        return 0

    @property
    def anchors(self) -> FloatArray:
        return self._T_map_anchor.to_array()[None, :]

    def take_entries(self) -> list[Entry]:
        entries, self._entries = self._entries, []
        return entries

    @property
    def submaps(self) -> "tuple[PackedSubmap, ...]":
        return ()

    def mapped(self) -> "tuple[PackedSubmap, ...]":
        return ()

    def graph(self) -> GraphSnapshot:
        return GraphSnapshot(
            self.anchors,
            np.empty((0, 2), dtype=np.int32),
            np.empty((0, 3)),
            np.empty((0, 3, 3)),
        )
