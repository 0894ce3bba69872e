"""Looking for a teammate's places in this robot's own, while nobody knows how their maps lie.

A few pairs of places at a time, as a job, the newest first: robots that have just met are near each
other. Of every pair one robot tries first; the other tries it the other way round when it has no
better to do, for what a search finds depends on which of the places is searched.
"""

from collections.abc import Collection, Iterator
from dataclasses import dataclass

from protocol.config import LidarConfig
from protocol.pose import FloatArray
from robot.jobs import Jobs
from robot.perception.returns import noise_model
from robot.team.entries import Link
from robot.team.joint import JointGraph
from robot.team.journal import LogName
from robot.team.log_graph import LogGraph
from robot.team.place import Stretch, make_place, searched, stretches
from robot.team.place_match import find_place
from robot.team.place_search import SearchGround

JOB = "places"
EVERY_TICKS = 3
LANDING_TICKS = 6
PAIRS_A_JOB = 4
# Places kept drawn; others are drawn again when they are wanted.
MAX_KEPT = 24

PlaceName = tuple[LogName, int]


@dataclass(frozen=True, slots=True)
class Errand:
    """Look for place `theirs` of a log in place `ours` of this robot's own."""

    ours: Stretch
    log: LogName
    theirs: Stretch


@dataclass(frozen=True, slots=True)
class Findings:
    """Links that were found, and the places that were drawn for it."""

    links: tuple[Link, ...]
    drawn: dict[PlaceName, SearchGround]


class PlaceFinder:
    """Goes through all pairs of own places and those of logs that are not aligned with it."""

    TRANSIENT = ("_drawn",)

    def __init__(self, own: LogName, lidar: LidarConfig) -> None:
        self._own = own
        self._noise = noise_model(lidar)
        self._examined: set[tuple[int, LogName, int]] = set()
        self._drawn: dict[PlaceName, SearchGround] | None = None

    def step(
        self, tick: int, jobs: Jobs, graph: JointGraph, aligned: Collection[LogName]
    ) -> list[Link]:
        """The links that landed at this tick; starts the next errands when none are under way,
        to logs that are not `aligned` with this one."""
        found: list[Link] = []
        for findings in jobs.landed(JOB, tick):
            found += findings.links
            self._keep(findings.drawn)
        if tick % EVERY_TICKS == 0 and not jobs.pending(JOB):
            errands = self._next_errands(graph, aligned)
            if errands:
                self._start(tick, jobs, graph, errands)
        return found

    def _keep(self, drawn: dict[PlaceName, SearchGround]) -> None:
        """The places used last, up to a number."""
        kept = {name: one for name, one in (self._drawn or {}).items() if name not in drawn}
        kept.update(drawn)
        self._drawn = {name: kept[name] for name in list(kept)[-MAX_KEPT:]}

    def _start(self, tick: int, jobs: Jobs, graph: JointGraph, errands: tuple[Errand, ...]) -> None:
        names = {self._own, *(errand.log for errand in errands)}
        wanted = {(self._own, errand.ours.number) for errand in errands}
        wanted |= {(errand.log, errand.theirs.number) for errand in errands}
        kept = {name: one for name, one in (self._drawn or {}).items() if name in wanted}
        jobs.start(
            JOB,
            tick,
            LANDING_TICKS,
            run_errands,
            errands,
            self._own,
            graph.snapshot(names),
            kept,
            self._noise,
        )

    def _next_errands(self, graph: JointGraph, aligned: Collection[LogName]) -> tuple[Errand, ...]:
        """The most promising pairs that were not tried yet."""
        ours = graph.log(self._own)
        strangers = self._strangers(graph, aligned)
        if ours is None or not strangers:
            self._drawn = None
            return ()
        own_places = stretches(ours)
        waiting = sorted(
            (rank, errand.log, errand.ours.number, errand.theirs.number, errand)
            for name in strangers
            for rank, errand in self._waiting(own_places, name, graph)
        )
        chosen = tuple(row[-1] for row in waiting[:PAIRS_A_JOB])
        for errand in chosen:
            self._examined.add((errand.ours.number, errand.log, errand.theirs.number))
        return chosen

    def _strangers(self, graph: JointGraph, aligned: Collection[LogName]) -> list[LogName]:
        """Logs of others that this one does not share a frame with yet."""
        known = graph.known_starts().logs
        if self._own in known:
            aligned = {*aligned, *known}
        return [
            name
            for name in graph.logs()
            if name != self._own and name not in aligned and _is_readable(graph.log(name))
        ]

    def _waiting(
        self, own_places: list[Stretch], name: LogName, graph: JointGraph
    ) -> Iterator[tuple[int, Errand]]:
        """Errands not run yet, and how far down the list each belongs."""
        log = graph.log(name)
        assert log is not None
        theirs = stretches(log)
        lower = self._own < name
        for a in searched(own_places):
            for b in theirs:
                if (a.number, name, b.number) in self._examined:
                    continue
                age = len(own_places) - a.number + len(theirs) - b.number
                second = (a.number + b.number) % 2 == lower
                yield age + (len(own_places) + len(theirs)) * second, Errand(a, name, b)


def _is_readable(log: LogGraph | None) -> bool:
    return log is not None and log.hello is not None and bool(log.keyframes)


def run_errands(
    errands: tuple[Errand, ...],
    own: LogName,
    graph: JointGraph,
    kept: dict[PlaceName, SearchGround],
    noise: FloatArray,
) -> Findings:
    """Draw the places that are missing, search, and judge. Pure: runs as a job."""
    drawn: dict[PlaceName, SearchGround] = {}

    def draw(name: LogName, stretch: Stretch) -> SearchGround:
        key = (name, stretch.number)
        if key not in drawn:
            log = graph.log(name)
            assert log is not None
            if key in kept:
                drawn[key] = kept[key]
            else:
                drawn[key] = SearchGround.of(make_place(log, stretch, noise))
        return drawn[key]

    links = []
    for errand in errands:
        ours, theirs = draw(own, errand.ours), draw(errand.log, errand.theirs)
        of, to = ours.place.anchor, theirs.place.anchor
        links += [
            Link(of, errand.log, to, match.T_a_b, match.information, match.evidence)
            for match in find_place(ours, theirs.place)
        ]
    return Findings(tuple(links), drawn)
