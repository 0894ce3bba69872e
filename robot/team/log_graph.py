"""What one log says, as its entries come in."""

from dataclasses import dataclass, field

from protocol.pose import FloatArray, Pose2
from robot.perception.scan import LaserScan
from robot.rows import Rows
from robot.slam.engine import Anchor
from robot.team.entries import Hello, Known, Link
from robot.team.journal import LogName
from robot.team.keyframes import StoredKeyframe

EDGE_COLUMNS = 2 + 3 + 9
KEYFRAME_COLUMNS = 1 + 3


@dataclass(slots=True)
class LogGraph:
    """What one log says: anchors each against the one before, closures, keyframes, and links to
    anchors of other logs: what is asked for by itself as entries, the numbers in them as rows."""

    hello: Hello | None = None
    anchors: list[Anchor] = field(default_factory=list)
    keyframes: list[StoredKeyframe] = field(default_factory=list)
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
        elif isinstance(entry, StoredKeyframe):
            if entry.anchor >= len(self.anchors) or entry.beams != self.hello.beams:
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
        return True

    def scan(self, index: int) -> LaserScan:
        """The scan of a keyframe."""
        assert self.hello is not None
        return LaserScan(self.keyframes[index].ranges, self.hello.angles, self.hello.max_range_m)

    def snapshot(self) -> "LogGraph":
        """A copy that no later entry changes."""
        return LogGraph(
            self.hello,
            self.anchors[:],
            self.keyframes[:],
            self.links[:],
            self.steps.snapshot(),
            self.loops.snapshot(),
            self.ties.snapshot(),
            self.views.snapshot(),
        )


def _append(rows: Rows, of: int, to: int, T_of_to: Pose2, information: FloatArray) -> None:
    rows.append(of, to, T_of_to.x, T_of_to.y, T_of_to.theta, *information.ravel())
