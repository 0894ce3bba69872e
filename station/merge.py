"""Merging maps of robots that do not know where the others started, offline.

The same as robots do when they meet (`robot.team`), with all the time in the world: every place of
every log is looked for in every place of the others, the alignment follows from what was found, and
logs that it puts into one frame are tied more closely where they are near.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from protocol.config import LidarConfig
from protocol.pose import FloatArray
from robot.perception.returns import noise_model
from robot.team.alignment import Alignment, align
from robot.team.entries import Known, Link
from robot.team.joint import JointGraph, Solution, solve
from robot.team.journal import LogName
from robot.team.near_matches import near_matches
from robot.team.place import Place, make_place, searched, stretches
from robot.team.place_match import find_place
from robot.team.place_search import SearchGround

Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class Merge:
    """Logs with the links that were found, the alignment these lead to, and the poses of anchors
    (m×3) in the frame of each group, in the order of `alignment.groups`."""

    graph: JointGraph
    noise: FloatArray
    alignment: Alignment
    solutions: tuple[Solution, ...]
    compared: int


def make_graph(logs: Mapping[LogName, Sequence[Known]]) -> JointGraph:
    graph = JointGraph()
    for name, entries in logs.items():
        for entry in entries:
            graph.add(name, entry)
    return graph


def merge(
    logs: Mapping[LogName, Sequence[Known]], lidar: LidarConfig, progress: Progress | None = None
) -> Merge:
    """Merge logs; `lidar` says what noise their ranges have. `progress` is told (done, of)."""
    graph, noise = make_graph(logs), noise_model(lidar)
    places = {name: make_places(graph, name, noise) for name in graph.logs()}
    compared = find_everywhere(graph, places, progress)
    found = align(graph, noise)
    for group in found.groups:
        solution = solve(graph.problem(group))
        for k, a in enumerate(group.logs):
            for b in group.logs[k + 1 :]:
                for link in near_matches(solution, places, a, b):
                    graph.add(a, link)
    found = align(graph, noise)
    solutions = tuple(solve(graph.problem(group)) for group in found.groups)
    return Merge(graph, noise, found, solutions, compared)


def make_places(graph: JointGraph, name: LogName, noise: FloatArray) -> list[Place]:
    """All places of a log, the unfinished last one too."""
    log = graph.log(name)
    assert log is not None
    return [make_place(log, stretch, noise) for stretch in stretches(log, whole=True)]


def find_everywhere(
    graph: JointGraph, places: dict[LogName, list[Place]], progress: Progress | None = None
) -> int:
    """Look for every place in those of other logs that are searched, both ways; what was found goes
    into the graph as links. Returns how many pairs of places were compared."""
    pairs = [
        (a, b, ours, theirs)
        for a in sorted(places)
        for ours in searched(places[a])
        for b in sorted(places)
        if b != a
        for theirs in places[b]
    ]
    ground = None
    for done, (a, b, ours, theirs) in enumerate(pairs):
        if ground is None or ground.place is not ours:
            ground = SearchGround.of(ours)
        for match in find_place(ground, theirs):
            link = Link(
                ours.anchor, b, theirs.anchor, match.T_a_b, match.information, match.evidence
            )
            graph.add(a, link)
        if progress is not None:
            progress(done + 1, len(pairs))
    return len(pairs)
