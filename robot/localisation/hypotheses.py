"""Global localisation: where a robot is in a known map when nobody told it.

Places that explain the first scan are found by a search of the whole map (`everywhere`), and are
followed as hypotheses while the robot drives: each moves by the odometry, is matched to the map,
and is judged by what the matcher does not look at, as places of teammates are (`Overlay`): returns
where the map is free, and rays through its walls. What explains some stretch far worse than the
best one does is dropped. Searches from later scans add what the first one missed, judged by all
scans so far. The robot knows where it is once one hypothesis is left that explains all it has
seen; twins that look alike all the way stay, and then the answer is that it is undecided.
"""

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from protocol.config import LidarConfig
from protocol.pose import IDENTITY, FloatArray, Pose2, wrap_angle
from robot.localisation.everywhere import SAME_PEAK_M, SAME_PEAK_RAD, find_everywhere
from robot.localisation.known_map import KnownMap
from robot.perception.matching import Match, match_returns
from robot.perception.odometry import Motion
from robot.perception.returns import Returns, describe_returns, noise_model
from robot.perception.scan import LaserScan

USABLE_RANGE_M = 20.0
# A scan is looked at when the robot has moved so far since the last one.
LOOK_EVERY_M, LOOK_EVERY_RAD = 0.25, math.radians(20.0)
# Of places, the least score, the least share of the best one's, and how many are followed.
FLOOR, SHARE, MOST = 0.3, 0.7, 150
# Every so many looks the whole map is searched again.
SEARCH_EVERY = 6
# Looks that are remembered, for what later searches find.
REMEMBERED = 40
# What odometry errs by from look to look, at least (m, m, rad).
PRIOR = np.diag([0.05**-2, 0.05**-2, 0.05**-2])
# A stretch: so many looks. One that is explained so much worse than by the best is not its place.
STRETCH = 4
FAR_WORSE = 0.12
# Misfit up to which a hypothesis explains what it has seen, and how much it must have seen.
EXPLAINED = 0.15
MIN_LOOKS = 5
MIN_OVERLAP = 0.5


@dataclass(frozen=True, slots=True)
class Look:
    """A scan, and where it was taken by the odometry (`T_odom_base`)."""

    T_odom_base: Pose2
    returns: Returns


@dataclass(slots=True)
class Hypothesis:
    """A place where the robot may be (`T_map_base`), and how well it explains each look that is
    remembered: the sums of `CorrelationField.compare`, and the weight of the scan."""

    pose: Pose2
    sums: deque[FloatArray] = field(default_factory=lambda: deque(maxlen=REMEMBERED))

    def misfit(self, first: int = 0, end: int | None = None) -> float:
        """The share of returns where the map is free, and of rays through walls, over some looks;
        2 is the worst. What the map does not know says nothing."""
        compared, hits, traced, crossing, _ = np.sum(list(self.sums)[first:end], axis=0)
        missed = 1.0 - hits / compared if compared > 0.0 else 1.0
        return float(missed + (crossing / traced if traced > 0.0 else 0.0))

    @property
    def overlap(self) -> float:
        """The share of returns that lie where the map knows the place."""
        compared, _, _, _, weight = np.sum(self.sums, axis=0)
        return float(compared / weight) if weight > 0.0 else 0.0


class GlobalLocaliser:
    """Hypotheses of where a robot is in a known map; `settled` is the one that is left."""

    def __init__(self, known: KnownMap, lidar: LidarConfig) -> None:
        self._known = known
        self._noise = noise_model(lidar)
        self._range_m = min(lidar.max_range_m, USABLE_RANGE_M)
        self._odometry = IDENTITY
        self._looks: deque[Look] = deque(maxlen=REMEMBERED)
        self._seen = 0
        self.hypotheses: list[Hypothesis] = []
        """The best one first."""
        self.settled: Hypothesis | None = None

    def step(self, motion: Motion, scan: LaserScan | None) -> None:
        """Move all hypotheses, and judge them by the scan when the robot has moved on."""
        self._odometry = self._odometry @ motion.T_before_now
        for hypothesis in self.hypotheses:
            hypothesis.pose = hypothesis.pose @ motion.T_before_now
        if scan is None or not self._moved_enough():
            return
        returns = describe_returns(scan, self._noise, self._range_m)
        if len(returns) == 0:
            return
        look = Look(self._odometry, returns)
        for hypothesis in self.hypotheses:
            self._judge(hypothesis, look)
        self._looks.append(look)
        if self._seen % SEARCH_EVERY == 0:
            self._search(look)
        self._seen += 1
        self._drop()
        self.settled = self._decide()

    def _moved_enough(self) -> bool:
        if not self._looks:
            return True
        moved = self._looks[-1].T_odom_base.inverse() @ self._odometry
        return math.hypot(moved.x, moved.y) >= LOOK_EVERY_M or abs(moved.theta) >= LOOK_EVERY_RAD

    def _judge(self, hypothesis: Hypothesis, look: Look) -> None:
        """Match a look from where the hypothesis has it, and note what speaks for and against."""
        match = self._match(look, hypothesis.pose)
        hypothesis.pose = match.T_field_base
        hypothesis.sums.append(self._compare(look, match.T_field_base))

    def _match(self, look: Look, pose: Pose2) -> Match:
        return match_returns(self._known.field, look.returns, pose, PRIOR)

    def _compare(self, look: Look, pose: Pose2) -> FloatArray:
        weight = float(look.returns.values[:, 4].sum())
        return np.append(self._known.field.compare(pose, look.returns), weight)

    def _search(self, look: Look) -> None:
        """Places of this look that nobody follows yet, judged by all looks before it."""
        places = find_everywhere(self._known, look.returns, FLOOR, SHARE, MOST)
        for place in places.peaks:
            pose = self._match(look, place.pose).T_field_base
            if any(_is_same(pose, other.pose) for other in self.hypotheses):
                continue
            self.hypotheses.append(Hypothesis(pose, self._followed_back(pose)))

    def _followed_back(self, pose: Pose2) -> deque[FloatArray]:
        """The sums of all looks for a robot that is now at a pose, by the odometry and the map."""
        sums: deque[FloatArray] = deque(maxlen=REMEMBERED)
        after = self._looks[-1]
        for look in reversed(self._looks):
            back = after.T_odom_base.inverse() @ look.T_odom_base
            pose = self._match(look, pose @ back).T_field_base
            sums.appendleft(self._compare(look, pose))
            after = look
        return sums

    def _drop(self) -> None:
        """Leave what has come to the same place as a better one, or explains a stretch far worse
        than the best."""
        self.hypotheses.sort(key=lambda hypothesis: hypothesis.misfit())
        kept: list[Hypothesis] = []
        for hypothesis in self.hypotheses:
            if any(_is_same(hypothesis.pose, other.pose) for other in kept):
                continue
            if kept and self._is_far_worse(hypothesis, kept[0]):
                continue
            kept.append(hypothesis)
        self.hypotheses = kept[:MOST]

    def _is_far_worse(self, hypothesis: Hypothesis, best: Hypothesis) -> bool:
        """Whether it explains some stretch far worse, back from now."""
        looks = len(best.sums)
        if looks < STRETCH:
            return hypothesis.misfit() > best.misfit() + 2.0 * FAR_WORSE
        return any(
            hypothesis.misfit(end - STRETCH, end) > best.misfit(end - STRETCH, end) + FAR_WORSE
            for end in range(looks, STRETCH - 1, -STRETCH)
        )

    def _decide(self) -> Hypothesis | None:
        if len(self.hypotheses) != 1 or self._seen < MIN_LOOKS:
            return None
        (only,) = self.hypotheses
        explained = only.misfit() <= EXPLAINED and only.overlap >= MIN_OVERLAP
        return only if explained else None


def _is_same(a: Pose2, b: Pose2) -> bool:
    return a.distance_to(b) < SAME_PEAK_M and abs(wrap_angle(a.theta - b.theta)) < SAME_PEAK_RAD
