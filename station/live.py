"""Watching a run on the screen: a table that renews itself, or plain lines for logs and pipes."""

import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from types import TracebackType
from typing import Self, TextIO

from rich.box import SIMPLE_HEAD
from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from protocol.messages import MapReply, Report
from station.live_groups import ALIGNED
from station.live_status import RunTracker, Status
from station.observer import Observer, RunOutcome
from station.wording import centimetres, clock_time, describe, percent, times
from world.simulation import Simulation

REFRESH_S = 0.25
LINE_EVERY_S = 10.0
# rich knows terminals by names; these are the nearest to the colours of `station.pictures`.
STATE_STYLES = {"aligned": "green", "tentative": "yellow", "contradictory": "bold red"}
MAX_PAIRS = 10
TERMINAL_COLOURS = ("dodger_blue1", "dark_orange", "spring_green3", "orchid", "gold1", "cyan")


class Observers:
    """Several observers as one. Use in `with`, so that each gives the screen back at the end."""

    def __init__(self, observers: Sequence[Observer]) -> None:
        self._observers = tuple(observers)

    def started(self, simulation: Simulation) -> None:
        for observer in self._observers:
            observer.started(simulation)

    def ticked(self, simulation: Simulation, reports: Mapping[str, Report]) -> None:
        for observer in self._observers:
            observer.ticked(simulation, reports)

    def mapped(self, robot: str, reply: MapReply) -> None:
        for observer in self._observers:
            observer.mapped(robot, reply)

    def ended(self, outcome: RunOutcome) -> None:
        for observer in self._observers:
            observer.ended(outcome)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for observer in self._observers:
            if isinstance(observer, LiveTable):
                observer.close()


class LiveTable:
    """A table that is redrawn in place about four times a second of wall time."""

    def __init__(
        self,
        console: Console | None = None,
        tracker: RunTracker | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.tracker = tracker or RunTracker(clock)
        self._clock = clock
        self._drawn = -REFRESH_S
        self._stamp = 0.0
        self._title = ""
        self._live = Live(console=console, auto_refresh=False, transient=False)

    def started(self, simulation: Simulation) -> None:
        self.tracker.started(simulation)
        self._title = describe(simulation.scenario)
        self._live.start()

    def ticked(self, simulation: Simulation, reports: Mapping[str, Report]) -> None:
        self.tracker.ticked(simulation)
        self._stamp = simulation.stamp
        now = self._clock()
        if now - self._drawn >= REFRESH_S:
            self._drawn = now
            self._draw(self.tracker.status(simulation, reports))

    def mapped(self, robot: str, reply: MapReply) -> None:
        self.tracker.mapped(robot, reply, self._stamp)

    def ended(self, outcome: RunOutcome) -> None:
        self._draw(self.tracker.ended(outcome))
        self.close()

    def close(self) -> None:
        """Leave the last table standing and give the cursor back; may be called twice."""
        self._live.stop()

    def _draw(self, status: Status) -> None:
        self._live.update(render(self._title, status), refresh=True)


class PlainLines:
    """One line every so many simulated seconds, for logs and pipes."""

    def __init__(
        self,
        stream: TextIO | None = None,
        tracker: RunTracker | None = None,
        every_s: float = LINE_EVERY_S,
    ) -> None:
        self.tracker = tracker or RunTracker()
        self._stream = stream or sys.stdout
        self._every_s = every_s
        self._due_s = 0.0
        self._stamp = 0.0

    def started(self, simulation: Simulation) -> None:
        self.tracker.started(simulation)
        self._write(describe(simulation.scenario))

    def ticked(self, simulation: Simulation, reports: Mapping[str, Report]) -> None:
        self.tracker.ticked(simulation)
        self._stamp = simulation.stamp
        if simulation.stamp >= self._due_s:
            self._due_s = simulation.stamp + self._every_s
            self._write(one_line(self.tracker.status(simulation, reports)))

    def mapped(self, robot: str, reply: MapReply) -> None:
        self.tracker.mapped(robot, reply, self._stamp)

    def ended(self, outcome: RunOutcome) -> None:
        self._write(one_line(self.tracker.ended(outcome)))
        self._write(f"ended: {outcome.exit_reason}")

    def _write(self, line: str) -> None:
        self._stream.write(line + "\n")
        self._stream.flush()


def one_line(status: Status) -> str:
    """The run now, for a log."""
    errors = [robot.error_m for robot in status.robots if robot.error_m is not None]
    parts = [
        f"t {clock_time(status.stamp)}",
        f"pace {times(status.pace)}",
        f"coverage {percent(status.coverage)}",
        f"expected end {clock_time(status.expected_end_s)}",
        f"links {status.links}/{status.pairs}",
        *([f"maps aligned {_aligned(status)}/{status.pairs}"] if status.maps else []),
        f"worst error {centimetres(max(errors, default=None))}",
        f"finished {sum(robot.finished for robot in status.robots)}/{len(status.robots)}",
    ]
    return " · ".join(parts)


def render(title: str, status: Status) -> Group:
    """The whole display: a headline, how far it is, one row per robot."""
    headline = Text.assemble(
        (title, "bold"),
        f"   simulated {clock_time(status.stamp)}",
        f" · pace {times(status.pace)}",
        f" · wall {clock_time(status.wall_s)}",
        no_wrap=True,
        overflow="ellipsis",
    )
    progress = Table.grid(padding=(0, 1))
    progress.add_row(
        "coverage",
        ProgressBar(total=1.0, completed=status.coverage or 0.0, width=40),
        percent(status.coverage),
        f"expected end {clock_time(status.expected_end_s)}",
        f"links {status.links} of {status.pairs}",
    )
    maps = [_maps(status)] if status.maps else []
    return Group(headline, progress, _robots(status), *maps)


def _aligned(status: Status) -> int:
    return sum(pair.state == ALIGNED for pair in status.maps)


def _maps(status: Status) -> Table | Text:
    """How the maps of each two robots stand to each other and why; of a crowd, how many do how."""
    if len(status.maps) > MAX_PAIRS:
        counts = Counter(pair.state for pair in status.maps)
        return Text(
            "maps: " + ", ".join(f"{count} pairs {state}" for state, count in counts.items())
        )
    table = Table(expand=True, pad_edge=False, header_style="dim", box=SIMPLE_HEAD)
    table.add_column("maps of", no_wrap=True)
    table.add_column("are", no_wrap=True)
    table.add_column("because", ratio=1, no_wrap=True, overflow="ellipsis")
    for pair in status.maps:
        style = STATE_STYLES.get(pair.state, "")
        table.add_row(f"{pair.a} – {pair.b}", Text(pair.state, style=style), pair.reason)
    return table


def _robots(status: Status) -> Table:
    table = Table(expand=True, pad_edge=False, header_style="dim", box=SIMPLE_HEAD)
    table.add_column("robot", no_wrap=True)
    table.add_column("state", ratio=1, no_wrap=True, overflow="ellipsis")
    for heading in ("error cm", "driven m", "entries", "loops"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("hears", no_wrap=True, overflow="ellipsis", max_width=20)
    for index, robot in enumerate(status.robots):
        colour = TERMINAL_COLOURS[index % len(TERMINAL_COLOURS)]
        table.add_row(
            Text(robot.name, style=f"bold {colour}"),
            Text(robot.activity, style="dim" if robot.finished else ""),
            "–" if robot.error_m is None else f"{100.0 * robot.error_m:.1f}",
            f"{robot.driven_m:.1f}",
            str(robot.entries),
            str(robot.loop_closures),
            " ".join(robot.hears) or "nobody",
        )
    return table
