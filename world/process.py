"""The world's shell: it moves senses and actions of the pure `Simulation` over the bus.

    roster -> { senses out, actions in, step } until done -> replies -> dismissal

Lockstep waits for every live robot's answer, up to a deadline; real time waits for nobody.
Losing a robot ends nothing: it is marked dead and the others go on.
"""

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from protocol.bus import Arrival, Bus, Event, Presence, Question
from protocol.errors import EarshotError
from protocol.interrupt import Interrupt
from protocol.messages import (
    Action,
    Ended,
    MapReply,
    RadioFrame,
    Report,
    Sense,
    TrajectoryReply,
    Truth,
)
from protocol.topics import (
    ACT,
    CONFIG,
    ENDED,
    EXACT_MAP,
    MAP,
    RADIO_IN,
    RADIO_OUT,
    REPORT,
    ROBOT_ALIVE,
    SENSE,
    TRAJECTORY,
    TRUTH,
    WORLD_ALIVE,
)
from world.robot_link import RobotLink
from world.simulation import Simulation

log = logging.getLogger(__name__)

INTERRUPTED = "interrupted"
NO_ANSWER = "no robot answers"

POLL_S = 0.2  # how often a wait looks at its interrupt and at the processes it depends on
SILENCE_S = 60.0  # wall time without any answer, all robots stalled, after which a run ends
REPLY_S = 60.0  # wall time for the last maps and trajectories
MAP_EVERY_S = 10.0  # simulated time between two questions for the present maps ...
MAP_PAUSE_S = 1.0  # ... and the least wall time between them


class RosterError(EarshotError):
    """Not every robot arrived in time."""


class Watcher(Protocol):
    """Who is told of the run while it goes on; a `station.observer.Observer` is one."""

    def started(self, simulation: Simulation) -> None: ...

    def ticked(self, simulation: Simulation, reports: Mapping[str, Report]) -> None: ...

    def mapped(self, robot: str, reply: MapReply) -> None: ...


@dataclass(slots=True)
class Replies:
    """What one robot answered at the end; None for what it did not."""

    map: MapReply | None = None
    trajectory: TrajectoryReply | None = None


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
        self.links = {name: RobotLink(name) for name in simulation.names}
        self.replies = {name: Replies() for name in simulation.names}
        self._bus = bus
        self._watcher = watcher
        self._interrupt = interrupt
        self._check = check
        self._pace = simulation.scenario.pace
        self._roster_closed = False
        self._reports: dict[str, Report] = {}
        self._maps_asked_stamp = 0.0
        self._maps_asked_wall = 0.0
        self._listen()

    @property
    def reports(self) -> dict[str, list[Report]]:
        """Every report so far, by robot."""
        return {name: link.reports for name, link in self.links.items()}

    @property
    def notes(self) -> dict[str, str]:
        """What became of each robot, where that is not the ordinary."""
        return {name: link.note for name, link in self.links.items()}

    def run(self) -> None:
        """From an empty roster to dismissed robots. Raises RosterError, and what `check` does."""
        try:
            self._await_roster()
            self._roster_closed = True
            self._watcher.started(self.simulation)
            self._play()
            self._collect()
        finally:
            self._dismiss()

    def _listen(self) -> None:
        self._inbox = self._bus.inbox()
        self._interrupt.on_request.append(self._inbox.wake)
        for name in self.simulation.names:
            self._inbox.serve(CONFIG, name)
            for topic in (RADIO_OUT, ACT, REPORT):
                self._inbox.subscribe(topic, name)
            self._inbox.watch(ROBOT_ALIVE, name)
        self._bus.declare_alive(WORLD_ALIVE)

    # -- before tick 0

    def _await_roster(self) -> None:
        deadline = time.monotonic() + self._pace.roster_s
        while not all(link.present for link in self.links.values()):
            if self._interrupt.requested:
                raise KeyboardInterrupt  # nothing has happened that could be reported
            if time.monotonic() > deadline:
                missing = [name for name, link in self.links.items() if not link.present]
                raise RosterError(
                    f"{', '.join(missing)} did not arrive within {self._pace.roster_s:g} s: "
                    f"start each with `earshot robot NAME --connect ENDPOINT`, or run with fewer"
                )
            self._handle_next(POLL_S)

    # -- the run

    def _play(self) -> None:
        simulation, gather = self.simulation, self._gather_lockstep
        if self._pace.mode == "realtime":
            gather = self._gather_realtime
        self._next_tick_wall = time.monotonic()
        senses = simulation.step({})
        while not simulation.done:
            self._send(senses)
            gather()
            if self._interrupt.requested:
                simulation.end(INTERRUPTED)
            senses = simulation.step(self._take_actions())
            self._watcher.ticked(simulation, self._reports)
            self._tell_truth()
            self._ask_for_maps()

    def _send(self, senses: Mapping[str, Sense]) -> None:
        for name, sense in senses.items():
            link = self.links[name]
            if not link.alive:
                continue
            if link.owes and self._pace.mode == "lockstep":
                link.hold(sense.frames)
                continue
            frames, counted = link.outgoing(sense)
            for frame in frames:
                self._bus.publish(RADIO_IN, frame, name)
            self._bus.publish(SENSE, counted, name)

    def _gather_lockstep(self) -> None:
        """Wait until every live robot that is not stalled answered, or the deadline passed."""
        start = time.monotonic()
        while self._awaited():
            waited = time.monotonic() - start
            if waited > self._pace.deadline_s:
                self._stall_awaited()
                return
            self._handle_next(min(POLL_S, self._pace.deadline_s))

    def _awaited(self) -> list[RobotLink]:
        """Whom the tick waits for; when all are stalled, for the first of them to answer."""
        alive = [link for link in self.links.values() if link.alive]
        owing = [link for link in alive if link.owes]
        prompt = [link for link in owing if not link.stalled]
        return prompt or (owing if len(owing) == len(alive) else [])

    def _stall_awaited(self) -> None:
        awaited = self._awaited()
        for link in awaited:
            if not link.stalled:
                log.warning(
                    "%s is stalled: no answer to tick %d within %g s; its wheels stop",
                    link.name,
                    self.simulation.tick,
                    self._pace.deadline_s,
                )
                link.stall()
            self.simulation.halt(link.name)
        if all(link.stalled for link in self.links.values() if link.alive):
            self._await_any()

    def _await_any(self) -> None:
        """Nothing moves while all robots are stalled, so nothing is lost by waiting for one."""
        deadline = time.monotonic() + SILENCE_S
        while self._awaited() and not self._interrupt.requested:
            if time.monotonic() > deadline:
                self.simulation.end(NO_ANSWER)
                return
            self._handle_next(POLL_S)

    def _gather_realtime(self) -> None:
        """Take what arrives until the next tick is due."""
        self._next_tick_wall += self.simulation.scenario.tick_s / self._pace.factor
        while (left := self._next_tick_wall - time.monotonic()) > 0.0:
            self._handle_next(min(POLL_S, left))
        if left < -1.0:  # hopelessly late: go on from here instead of rushing after it
            self._next_tick_wall = time.monotonic()
        for event in self._inbox.drain():
            self._handle(event)
        for link in self.links.values():
            link.missed += link.alive and link.owes

    def _take_actions(self) -> dict[str, Action]:
        actions = {name: link.take_action() for name, link in self.links.items() if link.alive}
        return {name: action for name, action in actions.items() if action is not None}

    def _tell_truth(self) -> None:
        if not self._bus.is_heard(TRUTH):
            return
        simulation = self.simulation
        truth = Truth(
            tick=simulation.tick,
            stamp=simulation.stamp,
            robots=simulation.names,
            poses=simulation.poses,
            links=simulation.links,
        )
        self._bus.publish(TRUTH, truth)

    def _ask_for_maps(self) -> None:
        stamp, wall = self.simulation.stamp, time.monotonic()
        if stamp < self._maps_asked_stamp + MAP_EVERY_S:
            return
        if wall < self._maps_asked_wall + MAP_PAUSE_S:
            return
        self._maps_asked_stamp, self._maps_asked_wall = stamp, wall
        for name, link in self.links.items():
            if link.alive and not link.owes:
                self._inbox.ask(MAP, name)

    # -- what arrives

    def _handle_next(self, timeout_s: float) -> None:
        event = self._inbox.get(timeout_s)
        if event is None:
            self._check()
        else:
            self._handle(event)

    def _handle(self, event: Event) -> None:
        link = self.links[event.robot]
        match event:
            case Question():
                event.reply(self.simulation.robot_config(event.robot))
            case Presence(alive=True):
                self._welcome(link)
            case Presence(alive=False):
                self._mark_lost(link)
            case Arrival() if link.lost:
                pass
            case Arrival(message=RadioFrame() as frame):
                link.accept_frame(frame)
            case Arrival(message=Action() as action):
                link.accept_action(action)
            case Arrival(message=Report() as report):
                link.reports.append(report)
                self._reports[event.robot] = report
            case Arrival(topic=topic, message=MapReply() as reply):
                if topic is EXACT_MAP:
                    self.replies[event.robot].map = reply
                else:
                    self._watcher.mapped(event.robot, reply)
            case Arrival(message=TrajectoryReply() as reply):
                self.replies[event.robot].trajectory = reply

    def _welcome(self, link: RobotLink) -> None:
        if link.lost:  # its teammates already went on without it
            self._dismiss_one(link.name, "it was given up for lost")
        link.present = True

    def _mark_lost(self, link: RobotLink) -> None:
        if not self._roster_closed:
            link.present = False
        elif link.alive:
            log.warning("%s is lost at tick %d; the others go on", link.name, self.simulation.tick)
            link.lost = True
            self.simulation.mark_dead(link.name)

    # -- after the last tick

    def _collect(self) -> None:
        """Ask every live robot for its last word."""
        asked = [name for name, link in self.links.items() if link.alive]
        for name in asked:
            self._inbox.ask(EXACT_MAP, name, REPLY_S)
            self._inbox.ask(TRAJECTORY, name, REPLY_S)
        deadline = time.monotonic() + REPLY_S
        while time.monotonic() < deadline and any(map(self._owes_replies, asked)):
            self._handle_next(POLL_S)

    def _owes_replies(self, name: str) -> bool:
        replies = self.replies[name]
        return self.links[name].alive and (replies.map is None or replies.trajectory is None)

    def _dismiss(self) -> None:
        for name, link in self.links.items():
            if link.alive:
                self._dismiss_one(name, self.simulation.exit_reason or "the world ends")

    def _dismiss_one(self, name: str, reason: str) -> None:
        self._bus.publish(ENDED, Ended(tick=max(0, self.simulation.tick), reason=reason), name)
