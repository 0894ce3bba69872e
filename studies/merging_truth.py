"""How well two journals were merged, held against where their robots truly were.

A merge is *right* when it puts the second robot's map within 5 cm and 1° of where it lies to the
first one's, *imprecise* within half a metre and 5°, else *false*, as is every merge of journals
from two worlds. It is *undecided* when no alignment is claimed.
"""

import math
from dataclasses import dataclass

import numpy as np

from protocol.config import LidarConfig
from protocol.pose import FloatArray, Pose2
from robot.team.joint import JointGraph, Solution, keyframe_poses
from robot.team.journal import LogName
from studies.lone_journals import LoneJournal

OUTCOMES = ("right", "undecided", "imprecise", "false")
RIGHT_M, RIGHT_RAD = 0.05, math.radians(1.0)
NEAR_M, NEAR_RAD = 0.5, math.radians(5.0)
ONE, TWO = LogName("a", 0), LogName("b", 0)
LIDAR = LidarConfig()


@dataclass(frozen=True, slots=True)
class Errors:
    """By how much a merge misses: the shift of the middle of the second robot's way and its turn,
    after the first one's way is laid on the truth; and the shift between the two first poses, which
    holds what either robot's own map drifts from there."""

    metres: float
    radians: float
    starts_m: float


def outcome_of(aligned: bool, errors: Errors | None) -> str:
    """In one word; without errors the worlds are not the same."""
    if not aligned:
        return "undecided"
    if errors is None or errors.metres > NEAR_M or errors.radians > NEAR_RAD:
        return "false"
    right = errors.metres <= RIGHT_M and errors.radians <= RIGHT_RAD
    return "right" if right else "imprecise"


def _laid(way: FloatArray, true: FloatArray) -> Pose2:
    """The frame of the truth in which a way (n×3) lies on the true one, on average. By headings: a
    way of a few metres leaves the rotation open."""
    turned = true[:, 2] - way[:, 2]
    theta = math.atan2(float(np.sin(turned).mean()), float(np.cos(turned).mean()))
    x, y = (true[:, :2] - Pose2(0.0, 0.0, theta).apply(way[:, :2])).mean(axis=0)
    return Pose2(float(x), float(y), theta)


class Truth:
    """How two journals truly lie."""

    def __init__(self, one: LoneJournal, two: LoneJournal) -> None:
        self.same = one.world == two.world
        self.T_starts = one.start.inverse() @ two.start
        self._journals = {ONE: one, TWO: two}

    def errors(self, graph: JointGraph, solution: Solution) -> Errors:
        """Of two logs in one frame, by the anchors (m×3) of either."""
        laid, ways = {}, {}
        for name, journal in self._journals.items():
            log = graph.log(name)
            assert log is not None
            ways[name] = keyframe_poses(log, solution[name])
            true = journal.truth[[keyframe.tick for keyframe in log.keyframes]]
            laid[name] = _laid(ways[name], true)
        middle = ways[TWO][:, :2].mean(axis=0, keepdims=True)
        shift = laid[ONE].apply(middle) - laid[TWO].apply(middle)
        first, second = (Pose2.from_array(solution[name][0]) for name in (ONE, TWO))
        return Errors(
            float(np.hypot(*shift[0])),
            abs((laid[TWO].inverse() @ laid[ONE]).theta),
            self._missed(first.inverse() @ second),
        )

    def of_transform(self, T_one_two: Pose2) -> Errors:
        """Of two rigid maps, each in the frame of its first pose; the second one by its middle."""
        two = self._journals[TWO]
        true: FloatArray = two.truth[[keyframe.tick for keyframe in two.keyframes]]
        middle = two.start.inverse().apply(true[:, :2].mean(axis=0, keepdims=True))
        shift = T_one_two.apply(middle) - self.T_starts.apply(middle)
        turn = abs((self.T_starts.inverse() @ T_one_two).theta)
        return Errors(float(np.hypot(*shift[0])), turn, self._missed(T_one_two))

    def _missed(self, T_one_two: Pose2) -> float:
        missed = self.T_starts.inverse() @ T_one_two
        return math.hypot(missed.x, missed.y)
