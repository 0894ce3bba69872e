"""What the ways to run have in common: who hosts the robots, and what is left at the end."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, get_args

from protocol.errors import EarshotError
from protocol.messages import MapReply, Report
from station.child import Child
from station.observer import Observer, RobotOutcome, RunOutcome
from world.process import WorldProcess
from world.report_log import ReportLog
from world.simulation import Simulation

Mode = Literal["processes", "memory", "inline"]
MODES: tuple[Mode, ...] = get_args(Mode)


class LaunchError(EarshotError):
    """A run could not be started."""


@dataclass(frozen=True, slots=True)
class Played:
    """What a host hands back: the robots' last words, and what they reported."""

    robots: Mapping[str, RobotOutcome]
    reports: Mapping[str, ReportLog] = field(default_factory=dict)


def played(world: WorldProcess, processes: Mapping[str, Child] | None = None) -> Played:
    """The last words as a world's shell collected them, and what is known of the `processes`."""
    robots = {}
    for name, replies in world.replies.items():
        process, link = (processes or {}).get(name), world.roster.links[name]
        robots[name] = RobotOutcome(
            map=replies.map,
            trajectory=replies.trajectory,
            peak_rss_mb=process.peak_rss_mb if process else None,
            note=link.note,
            wire=replies.wire,
            missed_ticks=link.missed,
            memory=tuple(process.memory) if process else (),
        )
    return Played(robots, world.reports)


class Unwatched:
    """An observer for runs that nobody looks at."""

    def started(self, simulation: Simulation) -> None:
        pass

    def ticked(self, simulation: Simulation, reports: Mapping[str, Report]) -> None:
        pass

    def mapped(self, robot: str, reply: MapReply) -> None:
        pass

    def ended(self, outcome: RunOutcome) -> None:
        pass


class Relay:
    """An observer that passes everything on; the base of those that also look themselves."""

    def __init__(self, observer: Observer) -> None:
        self._observer = observer

    def started(self, simulation: Simulation) -> None:
        self._observer.started(simulation)

    def ticked(self, simulation: Simulation, reports: Mapping[str, Report]) -> None:
        self._observer.ticked(simulation, reports)

    def mapped(self, robot: str, reply: MapReply) -> None:
        self._observer.mapped(robot, reply)

    def ended(self, outcome: RunOutcome) -> None:
        self._observer.ended(outcome)


class Timed(Relay):
    """Takes the wall time from before tick 0 to the last tick."""

    wall_s = 0.0

    def started(self, simulation: Simulation) -> None:
        super().started(simulation)
        self._begin = time.monotonic()

    def ticked(self, simulation: Simulation, reports: Mapping[str, Report]) -> None:
        self.wall_s = time.monotonic() - self._begin
        super().ticked(simulation, reports)
