"""How long a tick waits for its answers: for every live robot in lockstep, for nobody in real time.

A pace `holds` the senses of a robot that owes an answer back, or does not, and `gather`s what has
to be in before the next tick.
"""

import logging
import time
from typing import Protocol

from protocol.interrupt import Interrupt
from world.reception import POLL_S, Reception
from world.robot_link import RobotLink
from world.roster import Roster
from world.simulation import Simulation

log = logging.getLogger(__name__)

NO_ANSWER = "no robot answers"
SILENCE_S = 60.0  # wall time without any answer, all robots stalled, after which a run ends
HOPELESS_S = 1.0  # so far behind, real time goes on from here instead of rushing after itself


class Pace(Protocol):
    """When the next tick is due."""

    def holds(self, link: RobotLink) -> bool: ...

    def gather(self) -> None: ...


class Lockstep:
    """Wait until every live robot that is not stalled answered, or the deadline passed."""

    def __init__(
        self, simulation: Simulation, roster: Roster, reception: Reception, interrupt: Interrupt
    ) -> None:
        self._simulation = simulation
        self._roster = roster
        self._reception = reception
        self._interrupt = interrupt
        self._deadline_s = simulation.scenario.pace.deadline_s

    def holds(self, link: RobotLink) -> bool:
        return link.owes

    def gather(self) -> None:
        start = time.monotonic()
        while self._roster.awaited:
            if time.monotonic() - start > self._deadline_s:
                self._stall_awaited()
                return
            self._reception.read_next(min(POLL_S, self._deadline_s))

    def _stall_awaited(self) -> None:
        for link in self._roster.awaited:
            if not link.stalled:
                log.warning(
                    "%s is stalled: no answer to tick %d within %g s; its wheels stop",
                    link.name,
                    self._simulation.tick,
                    self._deadline_s,
                )
                link.stall()
            self._simulation.halt(link.name)
        if all(link.stalled for link in self._roster.alive):
            self._await_any()

    def _await_any(self) -> None:
        """Nothing moves while all robots are stalled, so nothing is lost by waiting for one."""
        deadline = time.monotonic() + SILENCE_S
        while self._roster.awaited and not self._interrupt.requested:
            if time.monotonic() > deadline:
                self._simulation.end(NO_ANSWER)
                return
            self._reception.read_next()


class RealTime:
    """Take what arrives until the next tick is due."""

    def __init__(self, simulation: Simulation, roster: Roster, reception: Reception) -> None:
        self._roster = roster
        self._reception = reception
        self._tick_wall_s = simulation.scenario.tick_s / simulation.scenario.pace.factor
        self._next = time.monotonic()

    def holds(self, link: RobotLink) -> bool:
        del link
        return False

    def gather(self) -> None:
        self._next += self._tick_wall_s
        while (left := self._next - time.monotonic()) > 0.0:
            self._reception.read_next(min(POLL_S, left))
        if left < -HOPELESS_S:
            self._next = time.monotonic()
        self._reception.read_all()
        for link in self._roster.alive:
            link.missed += link.owes
