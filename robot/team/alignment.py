"""Alignment: who lies where to whom, how sure that is, and what must not be drawn together.

A pure function of the sorted set of journal entries, so robots with equal journals agree on it, and
an alignment comes apart again by itself when new entries speak against it. Every pair of logs is
judged by itself (`PairJudge`); pairs that are aligned join their logs into groups, strongest first,
and a pair that does not close a cycle with stronger ones is contradictory too.
"""

from dataclasses import dataclass, replace

from protocol.pose import IDENTITY, FloatArray, Pose2, wrap_angle
from robot.team.entries import Link
from robot.team.evidence import Kind
from robot.team.hypothesis import LoneLogs
from robot.team.joint import Group, JointGraph, LinkName
from robot.team.journal import LogName
from robot.team.pair_judge import PairJudge, PairView, State

# A cycle of pairs that misses by more than this has a wrong pair in it.
CYCLE_M, CYCLE_RAD = 1.0, 0.1
# A link that was found by the logs' alignment counts if it is as near to it as this.
NEAR_M, NEAR_RAD = 1.0, 0.15


@dataclass(frozen=True, slots=True)
class Alignment:
    """All pairs in order, and the groups of logs that share a frame, each log in one of them."""

    pairs: tuple[PairView, ...]
    groups: tuple[Group, ...]

    def group_of(self, name: LogName) -> Group | None:
        return next((group for group in self.groups if name in group.logs), None)

    def pair(self, a: LogName, b: LogName) -> PairView | None:
        """How two logs stand; the same whichever is named first."""
        return next((view for view in self.pairs if {view.a, view.b} == {a, b}), None)


def align(graph: JointGraph, noise: FloatArray) -> Alignment:
    """The alignment of all logs in a graph; `noise` of their scans as in `describe_returns`."""
    return join(graph, judge(graph, noise))


def judge(graph: JointGraph, noise: FloatArray) -> tuple[PairView, ...]:
    """How every pair of logs stands, by what the two say of each other: the long part."""
    pairs = PairJudge(graph, LoneLogs(graph), noise)
    known = graph.known_starts().logs
    names = _drawn(graph)
    return tuple(
        pairs.known(a, b) if a in known and b in known else pairs.pair(a, b)
        for k, a in enumerate(names)
        for b in names[k + 1 :]
    )


def join(graph: JointGraph, judged: tuple[PairView, ...]) -> Alignment:
    """The groups that judged pairs make of the logs in a graph, which may have grown since."""
    frames = _Frames(graph)
    pairs = list(judged)
    for k in sorted(range(len(pairs)), key=lambda k: (-pairs[k].worth, k)):
        view = pairs[k]
        if view.state is State.ALIGNED and view.T_a_b is not None and not frames.join(view):
            pairs[k] = replace(view, state=State.CONTRADICTORY, reason="other pairs say otherwise")
    return Alignment(tuple(pairs), frames.groups(pairs))


def _drawn(graph: JointGraph) -> list[LogName]:
    """The logs that have an anchor to be placed by."""
    return [name for name in graph.logs() if (log := graph.log(name)) and log.anchors]


class _Frames:
    """Groups as they grow: in which frame each log lies, and where its first anchor lies in it."""

    def __init__(self, graph: JointGraph) -> None:
        self._graph = graph
        self._lone = LoneLogs(graph)
        self._known = graph.known_starts()
        names = _drawn(graph)
        self._frame = {name: name for name in names}
        self._start = dict.fromkeys(names, IDENTITY)
        for name, start in zip(self._known.logs, self._known.starts, strict=True):
            self._frame[name] = self._known.logs[0]
            self._start[name] = start

    def join(self, view: PairView) -> bool:
        """Bring the groups of a pair into one frame; False if they share one that disagrees."""
        assert view.T_a_b is not None
        a, b = view.a, view.b
        T_frame_b = self._start[a] @ view.T_a_b
        if self._frame[a] == self._frame[b]:
            anchors = self._lone[b].anchors
            middle = Pose2.from_array(anchors[len(anchors) // 2])
            return _near(self._start[b] @ middle, T_frame_b @ middle, CYCLE_M, CYCLE_RAD)
        if self._is_known(b) and not self._is_known(a):
            T_frame_a = self._start[b] @ view.T_a_b.inverse()
            self._move(a, b, T_frame_a @ self._start[a].inverse())
        else:
            self._move(b, a, T_frame_b @ self._start[b].inverse())
        return True

    def _move(self, moved: LogName, kept: LogName, T_new_old: Pose2) -> None:
        """Take all that shares a frame with one log into that of another."""
        old, new = self._frame[moved], self._frame[kept]
        for name, frame in self._frame.items():
            if frame == old:
                self._frame[name] = new
                self._start[name] = T_new_old @ self._start[name]

    def _is_known(self, name: LogName) -> bool:
        return bool(self._known.logs) and self._frame[name] == self._known.logs[0]

    def groups(self, pairs: list[PairView]) -> tuple[Group, ...]:
        """The groups in order of their first logs, each with the links that count in it."""
        counted = {link for view in pairs if view.state is State.ALIGNED for link in view.links}
        members: dict[LogName, list[LogName]] = {}
        for name in sorted(self._frame):
            members.setdefault(self._frame[name], []).append(name)
        return tuple(self._group(logs, counted) for logs in sorted(members.values()))

    def _group(self, logs: list[LogName], counted: set[LinkName]) -> Group:
        held = [name in self._known.logs for name in logs]
        starts = [self._start[name] for name in logs]
        if not any(held):
            # The frame of a group is that of its first log.
            held[0] = True
            T_first_frame = starts[0].inverse()
            starts = [T_first_frame @ start for start in starts]
        placed = dict(zip(logs, starts, strict=True))
        links = {link for link in counted if link[0] in placed}
        for name in logs:
            log = self._graph.log(name)
            assert log is not None
            for number, link in enumerate(log.links):
                if link.log not in placed or link.evidence.kind is not Kind.NEAR:
                    continue
                known = name in self._known.logs and link.log in self._known.logs
                if known or self._agrees(name, link, placed):
                    links.add((name, number))
        return Group(tuple(logs), tuple(starts), tuple(held), frozenset(links))

    def _agrees(self, holder: LogName, link: Link, placed: dict[LogName, Pose2]) -> bool:
        """Whether a link says about what logs whose first anchors are `placed` say already."""
        ours, theirs = self._lone[holder].anchors, self._lone[link.log].anchors
        if link.to >= len(theirs):
            return False
        measured = placed[holder] @ Pose2.from_array(ours[link.of]) @ link.T_of_to
        there = placed[link.log] @ Pose2.from_array(theirs[link.to])
        return _near(measured, there, NEAR_M, NEAR_RAD)


def _near(one: Pose2, other: Pose2, metres: float, radians: float) -> bool:
    turn = abs(wrap_angle(one.theta - other.theta))
    return one.distance_to(other) <= metres and turn <= radians
