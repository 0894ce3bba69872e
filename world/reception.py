"""Where everything arrives that comes to the world: each message to the robot it is about."""

import logging
import secrets
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Protocol

from protocol.bus import Bus
from protocol.inbox import Arrival, Event, Flood, Presence, Question
from protocol.interrupt import Interrupt
from protocol.messages import (
    Action,
    Ended,
    MapReply,
    RadioFrame,
    Report,
    Tally,
    TrajectoryReply,
)
from protocol.topics import (
    CONFIG,
    ENDED,
    EXACT_MAP,
    MAP,
    ROBOT_ALIVE,
    TALLY,
    TRAJECTORY,
)
from world.last_words import SPOKEN, Counts, LastWords, compare
from world.robot_link import RobotLink
from world.roster import Roster
from world.simulation import Simulation

log = logging.getLogger(__name__)

MUTE_TICKS = 100  # how long who floods is not listened to
POLL_S = 0.2  # how often a wait looks at its interrupt and at the processes it depends on


class Watcher(Protocol):
    """Who is told of the run while it goes on; a `station.observer.Observer` is one."""

    def started(self, simulation: Simulation) -> None: ...

    def ticked(self, simulation: Simulation, reports: Mapping[str, Report]) -> None: ...

    def mapped(self, robot: str, reply: MapReply) -> None: ...


class Reception:
    """Reads the world's inbox and keeps what it says about the robots."""

    def __init__(
        self,
        simulation: Simulation,
        roster: Roster,
        bus: Bus,
        watcher: Watcher,
        interrupt: Interrupt,
        check: Callable[[], None],
    ) -> None:
        self.replies = {name: LastWords() for name in simulation.names}
        self.reports: dict[str, Report] = {}
        """The newest report of each robot."""
        self._simulation = simulation
        self._roster = roster
        self._bus = bus
        self._watcher = watcher
        self._check = check
        self._run = secrets.token_hex(8)
        self._doubles: set[str] = set()
        self._counted_before: dict[str, tuple[Counts, Counts]] = {}
        self._inbox = bus.inbox()
        interrupt.on_request.append(self._inbox.wake)
        for name, link in roster.links.items():
            self._inbox.serve(CONFIG, name, link.allowance)
            for topic in SPOKEN:
                self._inbox.subscribe(topic, name, link.allowance)
            self._inbox.watch(ROBOT_ALIVE, name)

    def read_next(self, timeout_s: float = POLL_S) -> None:
        """Wait for the next event; where none comes, look after the processes we depend on."""
        event = self._inbox.get(timeout_s)
        if event is None:
            self._check()
        else:
            self._take(event)

    def read_all(self) -> None:
        """Take what is there already."""
        for event in self._inbox.drain():
            self._take(event)

    def ask_for_maps(self) -> None:
        """Ask every robot that has time for its present map; the watcher gets the answers."""
        for link in self._roster.alive:
            if not link.owes:
                self._inbox.ask(MAP, link.name)

    def ask_for_last_words(self, timeout_s: float) -> list[str]:
        """Ask every live robot for its last map and trajectory; returns who was asked."""
        asked = [link.name for link in self._roster.alive]
        for name in asked:
            self._inbox.ask(EXACT_MAP, name, timeout_s)
            self._inbox.ask(TRAJECTORY, name, timeout_s)
            self._inbox.ask(TALLY, name, timeout_s)
        return asked

    def dismiss(self, name: str, reason: str) -> None:
        """Send a robot home."""
        self._bus.publish(ENDED, Ended(tick=max(0, self._simulation.tick), reason=reason), name)

    def _take(self, event: Event) -> None:
        link = self._roster.links[event.robot]
        match event:
            case Question():
                self._introduce(link, event)
            case Flood():
                self._mute(link)
            case Presence(alive=True):
                self._welcome(link)
            case Presence(alive=False):
                self._mark_lost(link)
            case Arrival(topic=topic) if link.lost or (link.muted and topic in SPOKEN):
                pass
            case Arrival():
                self._hear(link, event)

    def _hear(self, link: RobotLink, arrival: Arrival) -> None:
        words = self.replies[link.name]
        match arrival.message:
            case RadioFrame() as frame:
                link.accept_frame(frame)
            case Action() as action:
                link.accept_action(action, self._simulation.tick)
            case Report() as report:
                link.accept_report(report, self._simulation.tick)
                if link.reports.latest is not None:
                    self.reports[link.name] = link.reports.latest
            case MapReply() as reply if arrival.topic is EXACT_MAP:
                words.map = reply
            case MapReply() as reply:
                self._watcher.mapped(link.name, reply)
            case TrajectoryReply() as reply:
                words.trajectory = reply
            case Tally() as tally:
                words.wire = compare(link.name, tally, *self._counted_with(link.name))

    def _counted_with(self, name: str) -> tuple[Counts, Counts]:
        """Messages sent to and received from a robot in its present life."""
        sent, received = self._counted_before.get(name, (Counter(), Counter()))
        return self._bus.sent - sent, self._inbox.received - received

    def listen_again(self) -> None:
        """To those who were muted long enough."""
        for link in self._roster.links.values():
            if link.muted_until is not None and self._simulation.tick >= link.muted_until:
                link.unmute()
                self._inbox.unmute(link.name)

    def _mute(self, link: RobotLink) -> None:
        """Its answer may be among what was dropped unread: nobody waits for it."""
        if not link.mutes:
            log.warning("%s floods the world: not listened to for %d ticks", link.name, MUTE_TICKS)
        self._inbox.mute(link.name)
        link.mute(self._simulation.tick + MUTE_TICKS)
        self._simulation.halt(link.name)

    def _introduce(self, link: RobotLink, question: Question) -> None:
        """Tell a robot about itself, unless it is there already: then it is another one that asks,
        or the end of the old one has not come to our ears yet, and the question will come again."""
        if link.alive:
            if link.name not in self._doubles:
                log.warning("a second %s asks to take part; one of that name is here", link.name)
            self._doubles.add(link.name)
            question.pass_over()
            return
        config = self._simulation.robot_config(link.name)
        own = {"run": self._run, "returned": link.lost}
        if link.lost:  # its wheels have turned since it started
            own["start"] = None
        question.reply(config.model_copy(update=own))

    def _welcome(self, link: RobotLink) -> None:
        link.present = True
        if link.lost:
            log.warning("%s is back at tick %d", link.name, self._simulation.tick)
            link.come_back()
            self._counted_before[link.name] = (
                Counter(self._bus.sent),
                Counter(self._inbox.received),
            )
            self._simulation.mark_alive(link.name)

    def _mark_lost(self, link: RobotLink) -> None:
        if not self._roster.closed:
            link.present = False
        elif link.alive:
            log.warning("%s is lost at tick %d; the others go on", link.name, self._simulation.tick)
            link.lost = True
            self._simulation.mark_dead(link.name)
