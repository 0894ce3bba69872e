"""What one log says, as its entries come in."""

from dataclasses import dataclass, field

import numpy as np

from protocol.pose import FloatArray, Pose2
from robot.slam.engine import Anchor, Closure, Keyframe
from robot.team.entries import Hello, Known, Link
from robot.team.journal import LogName

FIRST_CAPACITY = 64
EDGE_COLUMNS = 2 + 3 + 9
KEYFRAME_COLUMNS = 1 + 3


class Rows:
    """Rows of numbers that are only ever added to, in an array that doubles when it is full.

    The joint solution is made anew many times: out of arrays that takes a tenth of the time that
    it takes out of entries.
    """

    def __init__(self, columns: int) -> None:
        self._values = np.empty((FIRST_CAPACITY, columns))
        self._count = 0

    @property
    def values(self) -> FloatArray:
        """All rows (n×columns), not to be written to."""
        return self._values[: self._count]

    def append(self, *row: float) -> None:
        if self._count == len(self._values):
            self._values = np.concatenate([self._values, np.empty_like(self._values)])
        self._values[self._count] = row
        self._count += 1

    def snapshot(self) -> "Rows":
        """The rows that there are now. They never change, so they are shared."""
        copy = Rows.__new__(Rows)
        copy._values, copy._count = self._values, self._count
        return copy


@dataclass(slots=True)
class LogGraph:
    """What one log says: anchors each against the one before, closures, keyframes, and links to
    anchors of other logs. Entries as they are, and the numbers in them as rows."""

    hello: Hello | None = None
    anchors: list[Anchor] = field(default_factory=list)
    closures: list[Closure] = field(default_factory=list)
    keyframes: list[Keyframe] = field(default_factory=list)
    links: list[Link] = field(default_factory=list)
    steps: Rows = field(default_factory=lambda: Rows(EDGE_COLUMNS))
    """Of every anchor but the first: anchors of and to, measurement (3), information (9)."""
    loops: Rows = field(default_factory=lambda: Rows(EDGE_COLUMNS))
    """Of every closure, likewise."""
    ties: Rows = field(default_factory=lambda: Rows(EDGE_COLUMNS))
    """Of every link, likewise; the anchor it leads to is one of another log."""
    views: Rows = field(default_factory=lambda: Rows(KEYFRAME_COLUMNS))
    """Of every keyframe: its anchor and its pose (3) relative to that."""

    def add(self, name: LogName, entry: Known) -> bool:
        """Take in the next entry of the log of that name; False if it does not fit what is here."""
        if isinstance(entry, Hello):
            if self.hello is not None:
                return False
            self.hello = entry
        elif self.hello is None:
            return False
        elif isinstance(entry, Anchor):
            if entry.index != len(self.anchors):
                return False
            if self.anchors:
                at = entry.index
                _append(self.steps, at - 1, at, entry.T_previous_anchor, entry.information)
            self.anchors.append(entry)
        elif isinstance(entry, Keyframe):
            if entry.anchor >= len(self.anchors) or len(entry.ranges) != self.hello.beams:
                return False
            pose = entry.T_anchor_keyframe
            self.views.append(entry.anchor, pose.x, pose.y, pose.theta)
            self.keyframes.append(entry)
        elif isinstance(entry, Link):
            # The other log may come later; until then the link waits.
            if entry.of >= len(self.anchors) or entry.log == name:
                return False
            _append(self.ties, entry.of, entry.to, entry.T_of_to, entry.information)
            self.links.append(entry)
        else:
            if max(entry.of, entry.to) >= len(self.anchors):
                return False
            _append(self.loops, entry.of, entry.to, entry.T_of_to, entry.information)
            self.closures.append(entry)
        return True

    def snapshot(self) -> "LogGraph":
        """A copy that no later entry changes."""
        return LogGraph(
            self.hello,
            self.anchors[:],
            self.closures[:],
            self.keyframes[:],
            self.links[:],
            self.steps.snapshot(),
            self.loops.snapshot(),
            self.ties.snapshot(),
            self.views.snapshot(),
        )


def _append(rows: Rows, of: int, to: int, T_of_to: Pose2, information: FloatArray) -> None:
    rows.append(of, to, T_of_to.x, T_of_to.y, T_of_to.theta, *information.ravel())
