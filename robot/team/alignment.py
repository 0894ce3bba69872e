"""Alignment: who lies where to whom, how sure that is, and what must not be drawn together.

A pure function of the sorted set of journal entries, so robots with equal journals agree on it, and
an alignment comes apart again by itself when new entries speak against it. Every pair of logs is
judged by itself (`PairJudge`); pairs that are aligned join their logs into groups, strongest first,
and a pair that does not close a cycle with stronger ones is contradictory too.
"""

from dataclasses import dataclass, replace

from protocol.pose import IDENTITY, FloatArray
from robot.team.evidence import Kind
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
    judge = PairJudge(graph, noise)
    known = graph.known_starts()
    names = [name for name in graph.logs() if (log := graph.log(name)) and log.anchors]
    pairs = [
        judge.known(a, b) if a in known.logs and b in known.logs else judge.pair(a, b)
        for k, a in enumerate(names)
        for b in names[k + 1 :]
    ]
    frames = _Frames(names, known)
    by_worth = sorted(range(len(pairs)), key=lambda k: (-pairs[k].worth, k))
    for k in by_worth:
        view = pairs[k]
        if view.state is State.ALIGNED and view.T_a_b is not None and not frames.join(view, judge):
            pairs[k] = replace(view, state=State.CONTRADICTORY, reason="other pairs say otherwise")
    return Alignment(tuple(pairs), frames.groups(graph, pairs, judge))


class _Frames:
    """Groups as they grow: in which frame each log lies, and where its first anchor lies in it."""

    def __init__(self, names: list[LogName], known: Group) -> None:
        self._known = known
        self._frame = {name: name for name in names}
        self._start = dict.fromkeys(names, IDENTITY)
        for name, start in zip(known.logs, known.starts, strict=True):
            self._frame[name] = known.logs[0]
            self._start[name] = start

    def join(self, view: PairView, judge: PairJudge) -> bool:
        """Bring the groups of a pair into one frame; False if they share one that disagrees."""
        assert view.T_a_b is not None
        a, b = view.a, view.b
        T_frame_b = self._start[a] @ view.T_a_b
        if self._frame[a] == self._frame[b]:
            return judge.near(b, self._start[b], T_frame_b, CYCLE_M, CYCLE_RAD)
        moved, kept = (a, b) if self._is_known(b) and not self._is_known(a) else (b, a)
        # T_kept_moved: from the frame that is given up into the one that stays.
        if moved == b:
            shift = T_frame_b @ self._start[b].inverse()
        else:
            shift = self._start[b] @ view.T_a_b.inverse() @ self._start[a].inverse()
        old, new = self._frame[moved], self._frame[kept]
        for name, frame in self._frame.items():
            if frame == old:
                self._frame[name] = new
                self._start[name] = shift @ self._start[name]
        return True

    def _is_known(self, name: LogName) -> bool:
        return bool(self._known.logs) and self._frame[name] == self._known.logs[0]

    def groups(
        self, graph: JointGraph, pairs: list[PairView], judge: PairJudge
    ) -> tuple[Group, ...]:
        """The groups in order of their first logs, each with the links that count in it."""
        counted = {link for view in pairs if view.state is State.ALIGNED for link in view.links}
        members: dict[LogName, list[LogName]] = {}
        for name in sorted(self._frame):
            members.setdefault(self._frame[name], []).append(name)
        return tuple(self._group(graph, logs, counted, judge) for logs in sorted(members.values()))

    def _group(
        self,
        graph: JointGraph,
        logs: list[LogName],
        counted: set[LinkName],
        judge: PairJudge,
    ) -> Group:
        held = [name in self._known.logs for name in logs]
        starts = [self._start[name] for name in logs]
        if not any(held):
            # The frame of a group is that of its first log.
            held[0] = True
            shift = starts[0].inverse()
            starts = [shift @ start for start in starts]
        placed = dict(zip(logs, starts, strict=True))
        links = {link for link in counted if link[0] in placed}
        for name in logs:
            log = graph.log(name)
            assert log is not None
            for number, link in enumerate(log.links):
                if link.log not in placed or link.evidence.kind is not Kind.NEAR:
                    continue
                known = name in self._known.logs and link.log in self._known.logs
                if known or judge.agrees(name, link, placed, NEAR_M, NEAR_RAD):
                    links.add((name, number))
        return Group(tuple(logs), tuple(starts), tuple(held), frozenset(links))
