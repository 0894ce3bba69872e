"""Hypotheses: the ways in which two logs may lie to each other, by the matches between them."""

from dataclasses import dataclass

import numpy as np

from protocol.pose import FloatArray, Pose2
from robot.slam.gaussian import carry, invert_spd
from robot.team.consistency import IntArray, Matches, consistent_sets, gathered_covariance, worth
from robot.team.evidence import Evidence, Kind, weight_of
from robot.team.joint import Group, JointGraph, LinkName, Solution, solve
from robot.team.journal import LogName
from robot.team.log_graph import LogGraph

MAX_MATCHES = 150
MAX_HYPOTHESES = 6
# A step of a chain that says so little (m², rad²) was not driven: the robot went on in another
# submap for a while, and a closure holds the anchor. At its word it would let all matches agree.
UNTIED = 1.0
# Two sightings each of which says who was seen need no look-alike places to be ruled out.
MIN_SIGHTINGS = 2
# Below this a place match says next to nothing.
LEAST_WEIGHT = 0.02


@dataclass(frozen=True, slots=True)
class LoneLog:
    """One log solved by itself: its anchors (m×3) in the frame of its first one's own pose, and the
    covariance (m×3×3) gathered along the chain, in that frame."""

    anchors: FloatArray
    chain: FloatArray


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """An alignment that a consistent set of matches speaks for.

    `places` counts the distinct places matched on the side with fewer, `worth` their weights;
    `sightings` the sightings among the matches; `ambiguity` that of most of them. `solution` places
    both logs in the frame of the first by these matches alone.
    """

    links: tuple[LinkName, ...]
    worth: float
    places: int
    sightings: int
    ambiguity: float
    solution: Solution

    def transform(self, a: LogName, b: LogName) -> Pose2:
        """`T_a_b` between the first anchors of the logs."""
        first = Pose2.from_array(self.solution[a][0])
        return first.inverse() @ Pose2.from_array(self.solution[b][0])


def solve_alone(graph: JointGraph, name: LogName) -> LoneLog:
    """A log as its own measurements and closures put it, its first anchor at the origin."""
    log = graph.log(name)
    assert log is not None
    group = Group((name,), (Pose2(0.0, 0.0, 0.0),), (True,), frozenset())
    anchors = solve(graph.problem(group))[name]
    relative = np.zeros((len(log.anchors), 3))
    covariance = np.zeros((len(log.anchors), 3, 3))
    for k, anchor in enumerate(log.anchors[1:], start=1):
        relative[k] = anchor.T_previous_anchor.to_array()
        covariance[k] = invert_spd(anchor.information)
        if np.trace(covariance[k]) > UNTIED:
            covariance[k] = _held_by(log, k, covariance[k])
    return LoneLog(anchors, gathered_covariance(relative, covariance))


def _held_by(log: LogGraph, index: int, covariance: FloatArray) -> FloatArray:
    """The covariance (3×3) of the closure that holds an anchor; as given where there is none."""
    for row in log.loops.values[log.loops.values[:, 1] == index]:
        closed = invert_spd(row[5:].reshape(3, 3))
        if np.trace(closed) < np.trace(covariance):
            covariance = closed
    return covariance


class LoneLogs:
    """Logs solved by themselves, each when it is first asked for."""

    def __init__(self, graph: JointGraph) -> None:
        self._graph = graph
        self._solved: dict[LogName, LoneLog] = {}

    def __getitem__(self, name: LogName) -> LoneLog:
        if name not in self._solved:
            self._solved[name] = solve_alone(self._graph, name)
        return self._solved[name]


def hypotheses(graph: JointGraph, lone: LoneLogs, a: LogName, b: LogName) -> list[Hypothesis]:
    """The ways in which log b may lie to log a, the one of most worth first."""
    matches, names = _matches(graph, lone, a, b)
    if not names:
        return []
    found = []
    for chosen in _sets(matches, [_evidence(graph, name) for name in names]):
        links = tuple(names[k] for k in chosen)
        best = int(chosen[int(np.argmax(matches.weights[chosen]))])
        T_a_b = (
            Pose2.from_array(matches.poses_a[best])
            @ Pose2.from_array(matches.measured[best])
            @ Pose2.from_array(matches.poses_b[best]).inverse()
        )
        places = min(len(np.unique(matches.of[chosen])), len(np.unique(matches.to[chosen])))
        evidence = [_evidence(graph, name) for name in links]
        group = Group((a, b), (Pose2(0.0, 0.0, 0.0), T_a_b), (True, False), frozenset(links))
        found.append(
            Hypothesis(
                links,
                worth(matches, chosen),
                places,
                sum(one.kind is Kind.SIGHTING for one in evidence),
                float(np.median([one.ambiguity for one in evidence])),
                solve(graph.problem(group)),
            )
        )
    return found


def _sets(matches: Matches, evidence: list[Evidence]) -> list[IntArray]:
    """The sets worth most, and that of the sightings however many rooms that look alike outdo it:
    these say who was seen."""
    sets = consistent_sets(matches, MAX_HYPOTHESES)
    seen = np.array([one.kind is Kind.SIGHTING for one in evidence])
    if seen.sum() >= MIN_SIGHTINGS and all(seen[chosen].sum() < MIN_SIGHTINGS for chosen in sets):
        sighted = np.flatnonzero(seen)
        sets.append(sighted[consistent_sets(matches.only(sighted), 1)[0]])
    return sets


def _matches(
    graph: JointGraph, lone: LoneLogs, a: LogName, b: LogName
) -> tuple[Matches, list[LinkName]]:
    """What either log says of the other without having assumed it, as seen from log a."""
    rows = []
    for holder, other in ((a, b), (b, a)):
        log = graph.log(holder)
        assert log is not None
        for number, link in enumerate(log.links):
            weight = weight_of(link.evidence)
            if link.log != other or link.evidence.kind == Kind.NEAR or weight < LEAST_WEIGHT:
                continue
            if link.to >= len(lone[other].anchors):
                continue  # its anchor has not come yet
            covariance = invert_spd(link.information)
            if holder == a:
                row = (link.of, link.to, link.T_of_to, covariance)
            else:
                inverse = link.T_of_to.inverse()
                row = (link.to, link.of, inverse, carry(covariance, inverse))
            rows.append((-weight, (holder, number), row))
    rows = sorted(rows, key=lambda row: row[:2])[:MAX_MATCHES]
    rows.sort(key=lambda row: row[1])
    of = np.array([row[2][0] for row in rows], dtype=np.int64)
    to = np.array([row[2][1] for row in rows], dtype=np.int64)
    return (
        Matches(
            of,
            to,
            lone[a].anchors[of],
            lone[b].anchors[to],
            np.array([row[2][2].to_array() for row in rows]).reshape(-1, 3),
            np.array([row[2][3] for row in rows]).reshape(-1, 3, 3),
            lone[a].chain[of],
            lone[b].chain[to],
            np.array([-row[0] for row in rows]),
        ),
        [row[1] for row in rows],
    )


def _evidence(graph: JointGraph, name: LinkName) -> Evidence:
    log = graph.log(name[0])
    assert log is not None
    return log.links[name[1]].evidence
