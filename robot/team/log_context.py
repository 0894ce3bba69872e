"""What a log has said so far, as far as it tells what the next keyframe will look like.

A robot sees most of what it saw a step before. A keyframe is therefore told against the few before
it in its log: their returns are put where the robot is now, and only what differs from that takes
bytes. Logs are read in order and without a gap, so who reads one has what its writer had. Now and
then a keyframe stands alone: what cannot be read spoils no more than what follows until then.
"""

import numpy as np

from protocol.pose import IDENTITY, FloatArray, Pose2
from robot.slam.engine import Anchor
from robot.team import foresight_kernels
from robot.team.entries import Hello, Known
from robot.team.keyframes import StoredKeyframe
from robot.team.scan_codec import FIRST_RANGE, STEP_M, STEP_SHARE

DEPTH = 4
"""Keyframes that are looked back on."""
RUN = 32
"""Keyframes from one that stands alone to the next."""
MAX_STEPS = 16
"""Anchors between a keyframe and the one before it: from farther away little is foreseen."""


class LogContext:
    """The anchors of a log, and the newest keyframes of its present run."""

    def __init__(self) -> None:
        self._hello: Hello | None = None
        self._steps: list[Pose2] = []
        self._recent: list[StoredKeyframe] = []
        self._ranges: list[FloatArray] = []
        self._run = 0

    @property
    def last(self) -> StoredKeyframe | None:
        """The keyframe that a follower may be told against."""
        return self._recent[-1] if self._recent else None

    def may_follow(self, anchor: int) -> bool:
        """Whether a keyframe on that anchor can be told against those before it."""
        return (
            self._hello is not None
            and self._hello.increment > 0.0
            and self.last is not None
            and anchor < len(self._steps)
            and abs(anchor - self.last.anchor) <= MAX_STEPS
            and self._run < RUN
        )

    def take(self, entry: Known) -> None:
        """Take in the next entry of the log."""
        if isinstance(entry, Hello):
            self._hello = entry
        elif isinstance(entry, Anchor):
            self._steps.append(entry.T_previous_anchor)
        elif isinstance(entry, StoredKeyframe):
            if not entry.follows:
                self.break_off()
            self._recent = [*self._recent[1 - DEPTH :], entry]
            self._ranges = [*self._ranges[1 - DEPTH :], entry.ranges]
            self._run += 1

    def break_off(self) -> None:
        """Something could not be read: nothing is foreseen until a keyframe stands alone."""
        self._recent, self._ranges = [], []
        self._run = 0

    def foresee(self, anchor: int, T_anchor_now: Pose2) -> FloatArray:
        """What the beams (n) of a keyframe at a pose meet, in the numbers of the scan codec, NaN
        where nothing tells."""
        assert self._hello is not None
        hello = self._hello
        single = np.empty((len(self._recent), hello.beams))
        newest_first = zip(reversed(self._recent), reversed(self._ranges), strict=True)
        for row, (then, ranges) in zip(single, newest_first, strict=True):
            T_now_then = (
                T_anchor_now.inverse() @ self._between(anchor, then.anchor) @ then.T_anchor_keyframe
            )
            foresight_kernels.foresee(
                ranges,
                T_now_then.to_array(),
                hello.angle_min,
                hello.increment,
                STEP_M,
                STEP_SHARE,
                row,
            )
        foreseen = np.empty(hello.beams)
        foresight_kernels.agreed(single, foreseen)
        return foreseen + FIRST_RANGE

    def _between(self, a: int, b: int) -> Pose2:
        """T_a_b of two anchors, by the chain between them."""
        if a > b:
            return self._between(b, a).inverse()
        T_a_b = IDENTITY
        for step in self._steps[a + 1 : b + 1]:
            T_a_b = T_a_b @ step
        return T_a_b
