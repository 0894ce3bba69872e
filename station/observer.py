"""What a run tells whoever watches it, and what is left of it at its end.

All ways to run (inline, in memory, processes) drive the same `Observer`, so that live table,
live picture and report know nothing of how the robots are hosted.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from protocol.messages import MapReply, Report, TrajectoryReply
from station.memory_use import MemorySample
from world.last_words import WireCount
from world.report_log import ReportLog
from world.simulation import Simulation


@dataclass(frozen=True, slots=True)
class RobotOutcome:
    """What one robot answered at the end. A robot that died answers nothing: both are None."""

    map: MapReply | None
    trajectory: TrajectoryReply | None
    peak_rss_mb: float | None
    """Of its process; None where it had none of its own."""
    note: str = ""
    """What became of it, where that is not the ordinary: killed, stalled, timed out."""
    wire: Mapping[str, WireCount] | None = None
    """By topic, what was sent to it or by it and how much of that arrived; None without a wire,
    and where it did not say."""
    missed_ticks: int = 0
    """Ticks of real time that it had not answered when the next was due."""
    memory: tuple[MemorySample, ...] = ()
    """Of its process, every few seconds of wall time; none where it had none of its own."""


@dataclass(frozen=True, slots=True)
class RunOutcome:
    """A finished run. `simulation` still holds scenario, terrain, true history and ledger."""

    simulation: Simulation
    exit_reason: str
    wall_s: float
    mode: str
    robots: Mapping[str, RobotOutcome]
    world_peak_rss_mb: float
    reports: Mapping[str, ReportLog] = field(default_factory=dict)


class Observer(Protocol):
    """Watches a run. Must be quick: in lockstep the world waits for it."""

    def started(self, simulation: Simulation) -> None:
        """Once, before tick 0."""

    def ticked(self, simulation: Simulation, reports: Mapping[str, Report]) -> None:
        """After every tick, with the latest report of each robot."""

    def mapped(self, robot: str, reply: MapReply) -> None:
        """Now and then, when a robot answered with its present map."""

    def ended(self, outcome: RunOutcome) -> None:
        """Once, after the robots answered for the last time."""
