"""Which finished submaps a scan is looked for in, and how widely."""

import numpy as np
import numpy.typing as npt

from protocol.pose import FloatArray, Pose2
from robot.slam import candidate_kernels
from robot.slam.config import ClosureConfig
from robot.slam.engine import Closure
from robot.slam.loop_closure import Candidate
from robot.slam.packed_submap import PackedSubmap
from robot.slam.submap import Submap

# So many submaps stay as they are searched: what one attempt looks at, the next one mostly does.
UNPACKED = 12


class CandidateFinder:
    """The finished submaps, and how far the robot has come since it was last tied to old ones."""

    def __init__(self, config: ClosureConfig) -> None:
        self._config = config
        self._submaps: list[PackedSubmap] = []
        self._unpacked: dict[int, Submap] = {}  # by place, the last one used at the end
        self._indices = np.zeros(0, dtype=np.int64)
        self._ways = np.zeros((0, 2))  # one after the other, in their frames
        self._way_starts: npt.NDArray[np.int64] = np.zeros(1, dtype=np.int64)
        self._circles = np.zeros((0, 3))  # centre and radius of each
        self._untied_m = 0.0
        self._last: tuple[int, Pose2] | None = None
        self._since = 0
        self._per_pair: dict[tuple[int, int], int] = {}

    @property
    def submaps(self) -> tuple[PackedSubmap, ...]:
        """All finished submaps, oldest first."""
        return tuple(self._submaps)

    def add(self, submap: Submap) -> None:
        """A submap that is finished from now on."""
        packed = PackedSubmap.of(submap)
        self._keep_unpacked(len(self._submaps), submap)
        self._submaps.append(packed)
        centre = 0.5 * (packed.way.min(axis=0) + packed.way.max(axis=0))
        radius = np.hypot(*(packed.way - centre).T).max()
        self._indices = np.append(self._indices, submap.index)
        self._ways = np.vstack([self._ways, packed.way])
        self._way_starts = np.append(self._way_starts, len(self._ways))
        self._circles = np.vstack([self._circles, [*centre, radius]])

    def advance(self, anchor: int, T_anchor_base: Pose2) -> bool:
        """Count a drawn keyframe and the travel to it; True when an attempt is due."""
        if self._last is not None and self._last[0] == anchor:
            self._untied_m += self._last[1].distance_to(T_anchor_base)
        self._last = (anchor, T_anchor_base)
        self._since += 1
        if self._since < self._config.every_keyframes:
            return False
        self._since = 0
        return True

    def note(self, closures: tuple[Closure, ...]) -> None:
        """Closures to old submaps end the drift that had gathered."""
        for closure in closures:
            pair = (closure.of, closure.to)
            self._per_pair[pair] = self._per_pair.get(pair, 0) + 1
        if any(c.to - c.of > self._config.near_in_time for c in closures):
            self._untied_m = 0.0

    def find(self, anchor: int, T_anchor_base: Pose2, nodes: FloatArray) -> tuple[Candidate, ...]:
        """The nearest submaps that are not the last ones, nearest first; nodes are anchors m×3."""
        here = Pose2.from_array(nodes[anchor]) @ T_anchor_base
        half_m, half_rad = self._window()
        near = [
            place
            for place in self.near(here, nodes, self._config.radius_m + half_m)
            if self._may_tie(self._submaps[place].index, anchor)
        ]
        candidates, searches = [], 0
        for place in near[: self._config.max_candidates]:
            submap = self._unpack(place)
            guess = Pose2.from_array(nodes[submap.index]).inverse() @ here
            old = anchor - submap.index > self._config.near_in_time
            if not old or self._untied_m <= self._config.tied_m:
                candidates.append(Candidate(submap, guess))
            elif searches < self._config.max_searches:
                candidates.append(Candidate.searched(submap, guess, half_m, half_rad))
                searches += 1
        return tuple(candidates)

    def others(
        self, anchor: int, here: Pose2, nodes: FloatArray, reach_m: float, most: int
    ) -> tuple[Candidate, ...]:
        """The nearest submaps but that of `anchor`, to be matched without a search."""
        near = self.near(here, nodes, reach_m)
        others = [place for place in near if self._submaps[place].index != anchor]
        return tuple(
            Candidate(submap, Pose2.from_array(nodes[submap.index]).inverse() @ here)
            for submap in map(self._unpack, others[:most])
        )

    def near(self, here: Pose2, nodes: FloatArray, reach_m: float) -> list[int]:
        """Places (in `submaps`) of those whose way comes within reach of `here`, nearest first."""
        away, within = self._distances(here, nodes, reach_m)
        order: list[int] = away.argsort(kind="stable")[:within].tolist()
        return order

    def how_many_near(self, here: Pose2, nodes: FloatArray, reach_m: float) -> int:
        """How many places `near` would return."""
        return self._distances(here, nodes, reach_m)[1]

    def _distances(self, here: Pose2, nodes: FloatArray, reach_m: float) -> tuple[FloatArray, int]:
        """How far each submap's way is away, ∞ beyond reach, and how many are not."""
        away = np.empty(len(self._submaps))
        within = candidate_kernels.distances(
            nodes,
            self._indices,
            here.x,
            here.y,
            self._circles,
            self._way_starts,
            self._ways,
            reach_m,
            away,
        )
        return away, int(within)

    def _unpack(self, place: int) -> Submap:
        """A submap to be searched, for a job too: it is not written to again."""
        submap = self._unpacked.pop(place, None) or self._submaps[place].unpack()
        self._keep_unpacked(place, submap)
        return submap

    def _keep_unpacked(self, place: int, submap: Submap) -> None:
        """The last one used; the one that was not used for longest stays packed alone."""
        self._unpacked[place] = submap
        if len(self._unpacked) > UNPACKED:
            del self._unpacked[next(iter(self._unpacked))]

    def _may_tie(self, of: int, to: int) -> bool:
        """Whether a closure between two anchors would tell anything new."""
        tied = self._per_pair.get((of, to), 0)
        return of <= to - self._config.recent and tied < self._config.max_per_pair

    def may_tie_again(self, of: int, to: int) -> bool:
        """Whether two submaps that know each other's place hold less closures than are of use."""
        tied = self._per_pair.get((of, to), 0) + self._per_pair.get((to, of), 0)
        return tied < self._config.max_per_pair

    def forget_drift(self) -> None:
        """The robot is on known ground: from here on drift begins anew."""
        self._untied_m, self._last = 0.0, None

    def _window(self) -> tuple[float, float]:
        """Half extents (m, rad) that hold the drift since the last closure."""
        config = self._config
        return (
            min(config.window_m + config.window_m_per_m * self._untied_m, config.max_window_m),
            min(
                config.window_rad + config.window_rad_per_m * self._untied_m,
                config.max_window_rad,
            ),
        )
