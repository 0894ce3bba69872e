"""The joint solution: where every anchor of every robot lies in the team's frame.

It is a pure function of the sorted set of journal entries: robots with equal journals have equal
solutions, to the last bit, in whatever order the entries came. So it always starts from the
chains of anchors as their owners measured them, never from an older solution.
"""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from protocol.pose import FloatArray, Pose2, compose
from robot.slam.pose_graph import optimise
from robot.team.entries import Known
from robot.team.journal import LogName
from robot.team.log_graph import EDGE_COLUMNS, LogGraph

IntArray = npt.NDArray[np.int32]
NO_NODES: IntArray = np.zeros((0, 2), dtype=np.int32)

Solution = dict[LogName, FloatArray]
"""Poses (m×3) of the anchors of each log that is tied to the team's frame."""


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
    edge_nodes: IntArray
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

    def has_anchor(self, name: LogName, index: int) -> bool:
        """Whether an anchor of a log has come: links to it may come before."""
        log = self._logs.get(name)
        return log is not None and index < len(log.anchors)

    def logs(self) -> list[LogName]:
        return sorted(self._logs)

    def add(self, name: LogName, entry: Known) -> bool:
        """Take in the next entry of a log; False if it does not fit what came before it."""
        return self._logs.setdefault(name, LogGraph()).add(name, entry)

    def snapshot(self, names: Collection[LogName] | None = None) -> "JointGraph":
        """A copy of some logs, or of all, that no later entry changes: for a job."""
        copy = JointGraph()
        copy._logs = {
            name: log.snapshot()
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
        edges = [edge for name in names for edge in self._edges(name, bases, _numbers(group, name))]
        rows = np.concatenate([np.zeros((0, EDGE_COLUMNS)), *(edge.rows for edge in edges)])
        poses = np.concatenate(chains) if chains else np.zeros((0, 3))
        fixed = np.zeros(len(poses), dtype=np.bool_)
        fixed[[bases[name] for name, held in zip(names, group.held, strict=True) if held]] = True
        return Problem(
            names,
            tuple(sizes),
            poses,
            np.concatenate([NO_NODES, *(edge.nodes for edge in edges)]),
            rows[:, 2:5].copy(),
            rows[:, 5:].reshape(-1, 3, 3),
            fixed,
            np.concatenate([fixed[:0], *(np.full(len(edge.rows), edge.robust) for edge in edges)]),
        )

    def _edges(
        self, name: LogName, bases: dict[LogName, int], counted: list[int]
    ) -> "tuple[_Edges, _Edges, _Edges]":
        """What one log says of its own anchors, and of those of others that are there."""
        log, base = self._logs[name], bases[name]
        there = [
            number
            for number in counted
            if (link := log.links[number]).log in bases and self.has_anchor(link.log, link.to)
        ]
        ties = log.ties.values[there]
        to = np.array([bases[log.links[number].log] for number in there], dtype=np.int32)
        return (
            _Edges(log.steps.values, _nodes(log.steps.values, base, base), False),
            _Edges(log.loops.values, _nodes(log.loops.values, base, base), True),
            _Edges(ties, _nodes(ties, base, to), True),
        )


@dataclass(frozen=True, slots=True)
class _Edges:
    """Edges of one kind in one log: rows of a `LogGraph`, and the nodes (k×2) they tie."""

    rows: FloatArray
    nodes: IntArray
    robust: bool


def _nodes(rows: FloatArray, of: int, to: "int | IntArray") -> IntArray:
    """Numbers of anchors in their logs to those of nodes, for the first nodes of the logs."""
    nodes = rows[:, :2].astype(np.int32)
    nodes[:, 0] += of
    nodes[:, 1] += to
    return nodes


def _numbers(group: Group, name: LogName) -> list[int]:
    """The links of a log that count, in their order."""
    return sorted(number for holder, number in group.links if holder == name)


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
    return by_log(problem, nodes)


def by_log(problem: Problem, nodes: FloatArray) -> Solution:
    """The nodes (n×3) of a problem, each log's by itself."""
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
    newer = log.anchors[len(solved) :]
    if not newer:
        return solved[: len(log.anchors)].copy()
    poses = [Pose2.from_array(solved[-1])]
    for anchor in newer:
        poses.append(poses[-1] @ anchor.T_previous_anchor)
    return np.concatenate([solved, [pose.to_array() for pose in poses[1:]]])


def keyframe_poses(log: LogGraph, anchors: FloatArray, since: int = 0) -> FloatArray:
    """Poses (k×3) of the keyframes from number `since` on."""
    views = log.views.values[since:]
    return compose(anchors[views[:, 0].astype(np.int64)], views[:, 1:])


def _chain(log: LogGraph, pose: Pose2) -> FloatArray:
    """The anchors (m×3) as the chain of their own measurements puts them, the first at `pose`."""
    poses = [pose.to_array()]
    for anchor in log.anchors[1:]:
        pose = pose @ anchor.T_previous_anchor
        poses.append(pose.to_array())
    return np.array(poses)
