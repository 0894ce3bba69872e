"""Which finished submaps a scan is looked for in, and how widely."""

import numpy as np

from protocol.pose import FloatArray, Pose2, compose
from robot.slam.config import ClosureConfig
from robot.slam.engine import Closure
from robot.slam.loop_closure import Candidate
from robot.slam.submap import Submap


class CandidateFinder:
    """The finished submaps, and how far the robot has come since it was last tied to old ones."""

    def __init__(self, config: ClosureConfig) -> None:
        self._config = config
        self._submaps: list[Submap] = []
        self._untied_m = 0.0
        self._last: tuple[int, Pose2] | None = None
        self._since = 0
        self._per_pair: dict[tuple[int, int], int] = {}

    @property
    def submaps(self) -> tuple[Submap, ...]:
        """All finished submaps, oldest first."""
        return tuple(self._submaps)

    def add(self, submap: Submap) -> None:
        """A submap that is finished from now on."""
        self._submaps.append(submap)

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
        near: list[tuple[float, int]] = []
        for place, submap in enumerate(self._submaps):
            if submap.index > anchor - self._config.recent:
                continue
            if self._per_pair.get((submap.index, anchor), 0) >= self._config.max_per_pair:
                continue
            seen_from = compose(nodes[submap.index], np.array(submap.keyframes))
            away = np.hypot(seen_from[:, 0] - here.x, seen_from[:, 1] - here.y).min()
            if away <= self._config.radius_m + half_m:
                near.append((float(away), place))
        chosen = sorted(near)[: self._config.max_candidates]
        candidates, searches = [], 0
        for _, place in chosen:
            submap = self._submaps[place]
            guess = Pose2.from_array(nodes[submap.index]).inverse() @ here
            old = anchor - submap.index > self._config.near_in_time
            if not old or self._untied_m <= self._config.tied_m:
                candidates.append(Candidate(submap, guess, 0.0, 0.0))
            elif searches < self._config.max_searches:
                candidates.append(Candidate(submap, guess, half_m, half_rad))
                searches += 1
        return tuple(candidates)

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
