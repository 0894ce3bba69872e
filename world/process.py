"""The world's shell: it moves senses and actions of the pure `Simulation` over the bus.

    roster -> { senses out, actions in, step } until done -> last words -> dismissal

Losing a robot ends nothing: it is marked dead and the others go on. What arrives is read by
`world.reception`; how long a tick waits for it is `world.pace`'s.
"""

import logging
import time
from collections.abc import Callable, Mapping

from protocol.bus import Bus
from protocol.interrupt import Interrupt
from protocol.messages import Sense
from protocol.topics import RADIO_IN, SENSE, WORLD_ALIVE
from world.broadcasts import Broadcasts
from world.last_words import LastWords
from world.pace import Lockstep, Pace, RealTime
from world.reception import Reception, Watcher
from world.report_log import ReportLog
from world.roster import Roster
from world.simulation import Simulation

log = logging.getLogger(__name__)

INTERRUPTED = "interrupted"

REPLY_S = 60.0  # wall time for the last maps and trajectories
MAP_EVERY_S = 10.0  # simulated time between two questions for the present maps ...
MAP_PAUSE_S = 1.0  # ... and the least wall time between them


class WorldProcess:
    """One run of a simulation with robots that are somewhere on the bus."""

    def __init__(
        self,
        simulation: Simulation,
        bus: Bus,
        watcher: Watcher,
        interrupt: Interrupt,
        check: Callable[[], None] = lambda: None,
    ) -> None:
        """`check` is called while waiting; what it raises ends the run."""
        self.simulation = simulation
        self.roster = Roster(simulation.names, simulation.scenario.radio.bytes_per_tick)
        self._bus = bus
        self._broadcasts = Broadcasts(simulation, bus, watcher)
        self._interrupt = interrupt
        self._reception = Reception(
            simulation, self.roster, bus, self._broadcasts, interrupt, check
        )
        self._maps_asked_stamp = 0.0
        self._maps_asked_wall = 0.0
        bus.declare_alive(WORLD_ALIVE)

    @property
    def reports(self) -> dict[str, ReportLog]:
        """What each robot reported so far."""
        return {name: link.reports for name, link in self.roster.links.items()}

    @property
    def replies(self) -> dict[str, LastWords]:
        """The robots' last words."""
        return self._reception.replies

    def run(self) -> None:
        """From an empty roster to dismissed robots. Raises RosterError, and what `check` does."""
        try:
            self._await_roster()
            self._broadcasts.started(self.simulation)
            self._play()
            self._collect()
        finally:
            self._dismiss()

    def _await_roster(self) -> None:
        pace = self.simulation.scenario.pace
        deadline = time.monotonic() + pace.roster_s
        while self.roster.missing:
            if self._interrupt.requested:
                raise KeyboardInterrupt  # nothing has happened that could be reported
            if time.monotonic() > deadline:
                if pace.mode == "realtime" and self.roster.alive:
                    missing = ", ".join(self.roster.missing)
                    log.warning("%s did not come; the others begin, who is late joins", missing)
                    break
                self.roster.check_complete(pace.roster_s)
            self._reception.read_next()
        self.roster.closed = True

    def _play(self) -> None:
        simulation, pace = self.simulation, self._pace()
        senses = simulation.step({})
        while not simulation.done:
            self._send(senses, pace)
            pace.gather()
            if self._interrupt.requested:
                simulation.end(INTERRUPTED)
            senses = simulation.step(self.roster.take_actions())
            self._broadcasts.ticked(simulation, self._reception.reports)
            self._reception.listen_again()
            self._ask_for_maps()

    def _pace(self) -> Pace:
        parts = self.simulation, self.roster, self._reception
        if self.simulation.scenario.pace.mode == "realtime":
            return RealTime(*parts)
        return Lockstep(*parts, self._interrupt)

    def _send(self, senses: Mapping[str, Sense], pace: Pace) -> None:
        for link in self.roster.alive:
            sense = senses[link.name]
            if pace.holds(link):
                link.hold(sense.frames)
                self.simulation.set_listening(link.name, not link.is_full)
                continue
            self.simulation.set_listening(link.name, True)
            frames, counted = link.outgoing(sense)
            for frame in frames:
                self._bus.publish(RADIO_IN, frame, link.name)
            self._bus.publish(SENSE, counted, link.name)

    def _ask_for_maps(self) -> None:
        stamp, wall = self.simulation.stamp, time.monotonic()
        if stamp < self._maps_asked_stamp + MAP_EVERY_S:
            return
        if wall < self._maps_asked_wall + MAP_PAUSE_S:
            return
        self._maps_asked_stamp, self._maps_asked_wall = stamp, wall
        self._reception.ask_for_maps()

    def _collect(self) -> None:
        """Wait for the last words of every robot that is still alive."""
        asked = self._reception.ask_for_last_words(REPLY_S)
        deadline = time.monotonic() + REPLY_S
        while time.monotonic() < deadline and any(map(self._owes_last_words, asked)):
            self._reception.read_next()

    def _owes_last_words(self, name: str) -> bool:
        return self.roster.links[name].alive and not self.replies[name].complete

    def _dismiss(self) -> None:
        for link in self.roster.alive:
            self._reception.dismiss(link.name, self.simulation.exit_reason or "the world ends")
