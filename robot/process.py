"""A robot's shell: it moves senses and actions between the bus and the pure `Brain`.

It answers the newest sense with all frames heard so far, so that the same loop serves lockstep,
where there is never more than one, and real time, where a slow robot skips senses but no frame.
When the world is gone there are no wheels to stop: it says so and ends.
"""

import logging
import math
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from enum import Enum
from pathlib import Path
from typing import Protocol

from protocol.bus import Bus
from protocol.config import RobotConfig
from protocol.errors import EarshotError, MalformedMessageError
from protocol.inbox import Arrival, Event, Presence, Question
from protocol.interrupt import Interrupt
from protocol.messages import (
    Action,
    Ended,
    HeardFrame,
    MapReply,
    Report,
    Sense,
    Tally,
    TrajectoryReply,
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
    TALLY,
    TRAJECTORY,
    WORLD_ALIVE,
)
from robot.jobs import Jobs
from robot.journal_file import JournalFile, Life, next_incarnation
from robot.recollection import recall

log = logging.getLogger(__name__)

POLL_S = 0.5
REPORT_EVERY_S = 1.0
WHEELS = 2


class WorldMissingError(EarshotError):
    """The world did not answer when the robot started."""


class Farewell(Enum):
    """Why a robot's shell came to its end."""

    ENDED = "the run has ended"
    INTERRUPTED = "interrupted"
    WORLD_LOST = "the world is gone: wheels stopped"


class Mind(Protocol):
    """What the shell asks of a brain."""

    def remember(self, records: Sequence[bytes]) -> None: ...

    def step(self, sense: Sense) -> Action: ...

    def take_records(self) -> list[bytes]: ...

    def report(self) -> Report: ...

    def map_reply(self, exact: bool = False) -> MapReply: ...

    def trajectory_reply(self) -> TrajectoryReply: ...


MindMaker = Callable[[RobotConfig, int, Jobs], Mind]


class ReportClock:
    """Says when a report is due: once in each simulated second, and when the robot finishes, for
    nobody may ask for another one after that."""

    def __init__(self) -> None:
        self._last: float | None = None
        self._finished = False

    def due(self, stamp: float, finished: bool) -> bool:
        recent = self._last is not None and stamp < self._last + REPORT_EVERY_S - 1e-6
        if recent and finished == self._finished:
            return False
        self._last, self._finished = stamp, finished
        return True


def run_robot(
    bus: Bus,
    name: str,
    make_mind: MindMaker,
    interrupt: Interrupt,
    *,
    journal_folder: Path | None = None,
    resume: bool = False,
    world_wait_s: float = 60.0,
) -> Farewell:
    """Be the robot `name` until the run ends; to `resume`, with the memory of earlier lives.

    Raises WorldMissingError if there is no world that waits for this robot.
    """
    config = ask_config(bus, name, interrupt, world_wait_s)
    if config is None:
        return Farewell.INTERRUPTED
    incarnation, remembered = begin_life(config, journal_folder, resume)
    journal: AbstractContextManager[JournalFile | None] = nullcontext()
    if journal_folder is not None:
        journal = JournalFile(journal_folder, Life(name, incarnation, config.run))
    with journal as file, ThreadPoolExecutor(1, thread_name_prefix=f"{name}-jobs") as executor:
        mind = make_mind(config, incarnation, Jobs(executor))
        mind.remember(remembered)
        return RobotProcess(bus, config, mind, interrupt, file).run()


def begin_life(
    config: RobotConfig, journal_folder: Path | None, resume: bool
) -> tuple[int, list[bytes]]:
    """The incarnation of a robot that starts, and what it remembers of earlier ones.

    A robot that is back in a run is named by the second in which it starts. So no name is used
    twice, also where its journal was lost, taken from an old copy, or copied for another robot.
    """
    remembered, incarnation = [], 0
    if journal_folder is not None:
        incarnation = next_incarnation(journal_folder, config.name)
        if resume:
            remembered = recall(journal_folder, config.name, config.run)
            log.info("%s: remembers %d entries", config.name, len(remembered))
    if resume or config.returned:
        incarnation = max(incarnation, int(time.time()))
    return incarnation, remembered


def ask_config(
    bus: Bus, name: str, interrupt: Interrupt, world_wait_s: float
) -> RobotConfig | None:
    """The robot's configuration from the world; None when interrupted while waiting for it."""
    deadline = time.monotonic() + world_wait_s
    while not interrupt.requested:
        config = bus.query(CONFIG, RobotConfig, name, timeout_s=2.0)
        if config is not None:
            return config
        if time.monotonic() > deadline:
            raise WorldMissingError(
                f"no world answers for a robot named {name}: is it running, with {name} in its "
                f"scenario and under the same --namespace, and no other {name} there already?"
            )
        time.sleep(0.1)  # a world that is not there yet refuses at once
    return None


class RobotProcess:
    """The loop of one robot."""

    def __init__(
        self,
        bus: Bus,
        config: RobotConfig,
        mind: Mind,
        interrupt: Interrupt,
        journal: JournalFile | None,
    ) -> None:
        self._bus = bus
        self._inbox = bus.inbox()
        self._config = config
        self._name = config.name
        self._last_stamp = -math.inf
        self._mind = mind
        self._interrupt = interrupt
        self._journal = journal
        self._sense: Sense | None = None
        self._frames: list[HeardFrame] = []
        self._farewell: Farewell | None = None
        self._report_clock = ReportClock()

    def run(self) -> Farewell:
        """Answer senses and questions until there is a reason to end."""
        inbox = self._inbox
        self._listen()
        try:
            while self._farewell is None:
                event = inbox.get(POLL_S)
                if self._interrupt.requested:
                    self._farewell = Farewell.INTERRUPTED
                elif event is not None:
                    self._handle(event)
                    for further in inbox.drain():
                        self._handle(further)
                    self._answer()
        finally:
            self._bus.withdraw(ROBOT_ALIVE, self._name)
        return self._farewell

    def _listen(self) -> None:
        inbox, name = self._inbox, self._name
        self._interrupt.on_request.append(inbox.wake)
        for topic in (RADIO_IN, ENDED):
            inbox.subscribe(topic, name)
        inbox.subscribe(SENSE, name, check=self._check_sense)
        for topic in (MAP, EXACT_MAP, TRAJECTORY, TALLY):
            inbox.serve(topic, name)
        inbox.watch(WORLD_ALIVE)
        # Last of all: who sees the token may send at once.
        self._bus.declare_alive(ROBOT_ALIVE, name)

    def _check_sense(self, sense: Sense) -> None:
        """Raise MalformedMessageError for the sense of another body, or of a time gone by."""
        if len(sense.encoders) != WHEELS:
            raise MalformedMessageError("misfit", f"{len(sense.encoders)} wheels counted")
        if sense.ranges is not None and len(sense.ranges) != self._config.lidar.beams:
            raise MalformedMessageError("misfit", f"a scan of {len(sense.ranges)} beams")
        if sense.stamp <= self._last_stamp:
            raise MalformedMessageError("misfit", "its stamp lies before the last one")
        self._last_stamp = sense.stamp

    def _handle(self, event: Event) -> None:
        match event:
            case Arrival(message=HeardFrame() as frame):
                self._frames.append(frame)
            case Arrival(message=Sense() as sense):
                self._sense = sense
            case Arrival(message=Ended()):
                self._farewell = self._farewell or Farewell.ENDED
            case Question():
                self._reply(event)
            case Presence(alive=False):
                self._farewell = self._farewell or Farewell.WORLD_LOST

    def _reply(self, question: Question) -> None:
        if question.topic is TRAJECTORY:
            question.reply(self._mind.trajectory_reply())
        elif question.topic is TALLY:
            question.reply(self._tally())
        else:
            question.reply(self._mind.map_reply(exact=question.topic is EXACT_MAP))

    def _tally(self) -> Tally:
        sent, received = self._bus.sent, self._inbox.received
        return Tally(
            sent={topic: n for (topic, robot), n in sent.items() if robot == self._name},
            received={topic: n for (topic, robot), n in received.items() if robot == self._name},
            malformed=self._inbox.malformed.total(),
        )

    def _answer(self) -> None:
        """Step on the newest sense, with every frame that was heard up to it."""
        if self._sense is None or self._farewell is not None:
            return
        sense, self._sense = self._sense, None
        frames, self._frames = tuple(self._frames), []
        sense = sense.model_copy(update={"frames": frames, "frame_count": len(frames)})
        action = self._mind.step(sense)
        records = self._mind.take_records()
        if self._journal is not None and records:
            self._journal.append(records)
        for frame in action.frames:
            self._bus.publish(RADIO_OUT, frame, self._name)
        self._bus.publish(ACT, action, self._name)
        if self._report_clock.due(sense.stamp, action.finished):
            self._bus.publish(REPORT, self._mind.report(), self._name)
