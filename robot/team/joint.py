"""The joint solution: where every anchor of every robot lies in the team's frame.

It is a pure function of the sorted set of journal entries: robots with equal journals have equal
solutions, to the last bit, in whatever order the entries came. So it always starts from the
chains of anchors as their owners measured them, never from an older solution.
"""

from collections.abc import Collection
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from protocol.pose import FloatArray, Pose2, compose
from robot.slam.engine import Anchor, Closure, Keyframe
from robot.slam.pose_graph import optimise
from robot.team.entries import Hello, Known, Link
from robot.team.journal import LogName

Solution = dict[LogName, FloatArray]
"""Poses (m×3) of the anchors of each log that is tied to the team's frame."""


@dataclass(slots=True)
class LogGraph:
    """What one log says: anchors each against the one before, closures, keyframes, and links to
    anchors of other logs."""

    hello: Hello | None = None
    anchors: list[Anchor] = field(default_factory=list)
    closures: list[Closure] = field(default_factory=list)
    keyframes: list[Keyframe] = field(default_factory=list)
    links: list[Link] = field(default_factory=list)


LinkName = tuple[LogName, int]
"""The log that holds a link, and its number among the links there."""


@dataclass(frozen=True, slots=True)
class Group:
    """Logs that share a frame: where their first anchors lie in it, which of those are held there,
    and which links count. One at least is held."""

    logs: tuple[LogName, ...]
    starts: tuple[Pose2, ...]
    held: tuple[bool, ...]
    links: frozenset[LinkName]


@dataclass(frozen=True, slots=True)
class Problem:
    """A snapshot of all that the joint solution depends on. Logs sorted, arrays by log."""

    logs: tuple[LogName, ...]
    sizes: tuple[int, ...]
    nodes: FloatArray
    edge_nodes: npt.NDArray[np.int32]
    measurements: FloatArray
    information: FloatArray
    fixed: npt.NDArray[np.bool_]
    robust: npt.NDArray[np.bool_]


class JointGraph:
    """All logs as far as they are held without a gap."""

    def __init__(self) -> None:
        self._logs: dict[LogName, LogGraph] = {}

    def log(self, name: LogName) -> LogGraph | None:
        """What a log says, or None where nothing of it is held."""
        return self._logs.get(name)

    def logs(self) -> list[LogName]:
        return sorted(self._logs)

    def add(self, name: LogName, entry: Known) -> bool:
        """Take in the next entry of a log; False if it does not fit what came before it."""
        log = self._logs.setdefault(name, LogGraph())
        if isinstance(entry, Hello):
            if log.hello is not None:
                return False
            log.hello = entry
        elif log.hello is None:
            return False
        elif isinstance(entry, Anchor):
            if entry.index != len(log.anchors):
                return False
            log.anchors.append(entry)
        elif isinstance(entry, Keyframe):
            if entry.anchor >= len(log.anchors) or len(entry.ranges) != log.hello.beams:
                return False
            log.keyframes.append(entry)
        elif isinstance(entry, Link):
            # The other log may come later; until then the link waits.
            if entry.of >= len(log.anchors) or entry.log == name:
                return False
            log.links.append(entry)
        else:
            if max(entry.of, entry.to) >= len(log.anchors):
                return False
            log.closures.append(entry)
        return True

    def snapshot(self, names: Collection[LogName] | None = None) -> "JointGraph":
        """A copy of some logs, or of all, that no later entry changes: for a job."""
        copy = JointGraph()
        copy._logs = {
            name: LogGraph(
                log.hello, log.anchors[:], log.closures[:], log.keyframes[:], log.links[:]
            )
            for name, log in self._logs.items()
            if names is None or name in names
        }
        return copy

    def known_starts(self) -> Group:
        """The logs whose robots were told where they start, with every link among them."""
        starts = {
            name: log.hello.start
            for name in self.logs()
            if (log := self._logs[name]).hello is not None
            and log.hello.start is not None
            and log.anchors
        }
        links = frozenset((name, n) for name in starts for n in range(len(self._logs[name].links)))
        return Group(tuple(starts), tuple(starts.values()), (True,) * len(starts), links)

    def problem(self, group: Group | None = None) -> Problem:
        """The present state of a group of logs; of those with known starts if none is named."""
        group = group or self.known_starts()
        names = group.logs
        chains = [
            _chain(self._logs[name], start) for name, start in zip(names, group.starts, strict=True)
        ]
        sizes = [len(chain) for chain in chains]
        bases = dict(zip(names, np.cumsum([0, *sizes]).tolist(), strict=False))
        edges = _Edges()
        for name in names:
            self._add_edges(edges, name, bases, group.links)
        poses = np.concatenate(chains) if chains else np.zeros((0, 3))
        fixed = np.zeros(len(poses), dtype=np.bool_)
        fixed[[bases[name] for name, held in zip(names, group.held, strict=True) if held]] = True
        return Problem(
            names,
            tuple(sizes),
            poses,
            np.array(edges.nodes, dtype=np.int32).reshape(-1, 2),
            np.array(edges.measurements).reshape(-1, 3),
            np.array(edges.information).reshape(-1, 3, 3),
            fixed,
            np.array(edges.robust, dtype=np.bool_),
        )

    def _add_edges(
        self,
        edges: "_Edges",
        name: LogName,
        bases: dict[LogName, int],
        counted: frozenset[LinkName],
    ) -> None:
        """What one log says of its own anchors, and of those of others that are there."""
        log, base = self._logs[name], bases[name]
        for anchor in log.anchors[1:]:
            at = base + anchor.index
            edges.add(at - 1, at, anchor.T_previous_anchor, anchor.information, False)
        for closure in log.closures:
            of, to = base + closure.of, base + closure.to
            edges.add(of, to, closure.T_of_to, closure.information, True)
        for number, link in enumerate(log.links):
            if (name, number) not in counted:
                continue
            if link.log in bases and link.to < len(self._logs[link.log].anchors):
                of, to = base + link.of, bases[link.log] + link.to
                edges.add(of, to, link.T_of_to, link.information, True)


@dataclass(slots=True)
class _Edges:
    """Edges as they are gathered."""

    nodes: list[tuple[int, int]] = field(default_factory=list)
    measurements: list[FloatArray] = field(default_factory=list)
    information: list[FloatArray] = field(default_factory=list)
    robust: list[bool] = field(default_factory=list)

    def add(self, of: int, to: int, T_of_to: Pose2, information: FloatArray, robust: bool) -> None:
        self.nodes.append((of, to))
        self.measurements.append(T_of_to.to_array())
        self.information.append(information)
        self.robust.append(robust)


def solve(problem: Problem) -> Solution:
    """Optimise all logs together; each is held by the pose of its first anchor."""
    nodes = problem.nodes
    if len(problem.edge_nodes):
        nodes = optimise(
            nodes,
            problem.edge_nodes,
            problem.measurements,
            problem.information,
            fixed=problem.fixed,
            robust=problem.robust,
        ).nodes
    ends = np.cumsum(problem.sizes)
    return {
        name: nodes[end - size : end]
        for name, size, end in zip(problem.logs, problem.sizes, ends, strict=True)
    }


def anchor_pose(log: LogGraph | None, solved: FloatArray | None, index: int) -> Pose2 | None:
    """The pose of an anchor, carried on from the last solved one where it is newer than that.

    None where the log is unknown, or not tied to the team's frame, or does not reach so far.
    """
    if log is None or solved is None or index >= len(log.anchors) or not len(solved):
        return None
    known = min(index, len(solved) - 1)
    pose = Pose2.from_array(solved[known])
    for anchor in log.anchors[known + 1 : index + 1]:
        pose = pose @ anchor.T_previous_anchor
    return pose


def anchor_poses(log: LogGraph, solved: FloatArray) -> FloatArray:
    """Poses (m×3) of all anchors of a log, likewise."""
    poses = [Pose2.from_array(row) for row in solved[: len(log.anchors)]]
    for anchor in log.anchors[len(poses) :]:
        poses.append(poses[-1] @ anchor.T_previous_anchor)
    return np.array([pose.to_array() for pose in poses])


def keyframe_poses(log: LogGraph, anchors: FloatArray, since: int = 0) -> FloatArray:
    """Poses (k×3) of the keyframes from number `since` on."""
    keyframes = log.keyframes[since:]
    if not keyframes:
        return np.zeros((0, 3))
    relative = np.array([keyframe.T_anchor_keyframe.to_array() for keyframe in keyframes])
    return compose(anchors[[keyframe.anchor for keyframe in keyframes]], relative)


def _chain(log: LogGraph, pose: Pose2) -> FloatArray:
    """The anchors (m×3) as the chain of their own measurements puts them, the first at `pose`."""
    poses = [pose.to_array()]
    for anchor in log.anchors[1:]:
        pose = pose @ anchor.T_previous_anchor
        poses.append(pose.to_array())
    return np.array(poses)
