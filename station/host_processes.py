"""The world here with an embedded router, and each robot as a process of its own."""

import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

from protocol.bus import Bus, BusError, open_bus
from protocol.bus_config import BusConfig, loopback_endpoint
from protocol.interrupt import Interrupt
from protocol.keys import key_path, make_keys
from protocol.messages import Report
from robot.journal_file import remove_journals
from station.child import Child, children
from station.crew import Crew, Restarted
from station.forks import robot_starter
from station.free_port import free_port
from station.hosts import LaunchError, Played, Relay, played
from station.observer import Observer
from station.warm_up import is_warm, warm_up
from world.process import WorldProcess
from world.simulation import Simulation

ATTEMPTS = 5
PEAK_EVERY_S = 1.0  # wall time
SAMPLE_EVERY_S = 1.0
JOURNALS = "journals"


def play_processes(
    simulation: Simulation,
    observer: Observer,
    interrupt: Interrupt,
    folder: Path | None = None,
    restart: bool = False,
) -> Played:
    """Play a run to its end. What robots print, and their journals, go to `folder`. With `restart`
    robots that are killed are started again and go on from their journals.

    Journals that an earlier run left there are removed: this is another world, and a robot that
    found one would take itself for restarted. Raises LaunchError when a robot dies before the
    run begins.
    """
    if not is_warm():  # once here, and not in every robot at the same time
        warm_up()
    names = simulation.names
    with (
        _folder(folder) as kept,
        _throw_away_keys(names) as keys,
        robot_starter(kept) as starter,
        _free_router(keys, names) as (bus, endpoint),
        children() as family,
    ):
        remove_journals(kept / JOURNALS)
        sampled = _MemorySampled(observer, family)
        arguments = {
            name: _robot_arguments(name, endpoint, key_path(keys, name), kept / JOURNALS)
            for name in names
        }
        crew = Crew(starter, family, kept, arguments)
        watcher = Restarted(sampled, crew) if restart else sampled
        world = WorldProcess(
            simulation, bus, watcher, interrupt, lambda: _check_start(simulation, family)
        )
        for name in names:
            crew.start(name)
        try:
            world.run()
        finally:
            sampled.note_peaks()
    return played(world, {child.name: child for child in family})


def _robot_arguments(name: str, endpoint: str, key: Path, journals: Path) -> list[str]:
    own = ["--keys", str(key), "--journal", str(journals)]
    return ["robot", name, "--connect", endpoint, *own]


def _check_start(simulation: Simulation, family: list[Child]) -> None:
    """A robot that dies before tick 0 will not come: say at once what it said."""
    if simulation.tick >= 0:
        return
    for child in family:
        if child.exit_code is not None:
            raise LaunchError(
                f"robot {child.name} ended with code {child.exit_code} before the run began: "
                + (child.log_tail() or "it said nothing")
            )


@contextmanager
def _folder(folder: Path | None) -> Iterator[Path]:
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        yield folder
        return
    with tempfile.TemporaryDirectory(prefix="earshot-") as scratch:
        yield Path(scratch)


@contextmanager
def _throw_away_keys(names: tuple[str, ...]) -> Iterator[Path]:
    """Keys of this run alone, in a folder that only this user can enter."""
    with tempfile.TemporaryDirectory(prefix="earshot-keys-") as folder:
        make_keys(Path(folder), names)
        yield Path(folder)


@contextmanager
def _free_router(keys: Path, names: tuple[str, ...]) -> Iterator[tuple[Bus, str]]:
    """A router on a free port of 127.0.0.1; another program may take a port in between."""
    with ExitStack() as stack:
        for attempt in range(ATTEMPTS):
            endpoint = loopback_endpoint(free_port())
            try:
                config = BusConfig.router(endpoint).walled(keys, names)
                bus = stack.enter_context(open_bus(config))
                break
            except BusError:
                if attempt == ATTEMPTS - 1:
                    raise
        yield bus, endpoint


class _MemorySampled(Relay):
    """Looks at the robots' memory each second or so, and now and then more closely."""

    def __init__(self, observer: Observer, family: list[Child]) -> None:
        super().__init__(observer)
        self._family = family
        self._next_peak = self._next_sample = 0.0

    def note_peaks(self) -> None:
        for child in self._family:
            child.note_peak()

    def ticked(self, simulation: Simulation, reports: Mapping[str, Report]) -> None:
        super().ticked(simulation, reports)
        now = time.monotonic()
        if now >= self._next_peak:
            self._next_peak = now + PEAK_EVERY_S
            self.note_peaks()
        if now >= self._next_sample:
            self._next_sample = now + SAMPLE_EVERY_S
            for child in self._family:
                child.sample_memory(simulation.stamp)
