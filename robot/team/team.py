"""The team as one robot knows it: it hears, remembers, and speaks."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from protocol.config import RobotConfig
from protocol.errors import MalformedMessageError
from protocol.messages import HeardFrame, RadioFrame, Sighting
from protocol.pose import FloatArray, Pose2
from robot.jobs import Jobs
from robot.slam.engine import Entry
from robot.team.beacon import BEACON, Beacon, decode_beacon, encode_beacon
from robot.team.entries import Hello, Link, decode_entry, encode_entry
from robot.team.gossip import Gossip
from robot.team.joint import JointGraph, Solution, anchor_pose
from robot.team.journal import EntryName, Journal, LogName, decode_record, encode_record
from robot.team.log_context import LogContext
from robot.team.meetings import Meetings
from robot.team.parcels import ENTRIES, FRAME_OVERHEAD_BYTES, PART
from robot.team.standing import Standing

BEACON_EVERY_TICKS = 20
# While a robot is seen whose map does not fit yet: beacons tell how it stands, and it may be gone
# the tick after next, so the first ones go out at once.
MEETING_TICKS = 3
GLIMPSE_BEACONS = 6


@dataclass(frozen=True, slots=True)
class LiveState:
    """What a beacon says of the robot itself, relative to its own anchor `anchor`; `meeting`: it
    sees a robot that is not where it takes it to be."""

    anchor: int
    T_anchor_base: Pose2
    covariance: FloatArray
    T_anchor_goal: Pose2 | None
    finished: bool
    sightings: tuple[Sighting, ...] = ()
    meeting: bool = False


@dataclass(frozen=True, slots=True)
class Heard:
    """The last beacon of a teammate."""

    tick: int
    beacon: Beacon


class Team:
    """Journal, gossip, beacons and the joint solution of one robot."""

    def __init__(self, config: RobotConfig, incarnation: int, jobs: Jobs) -> None:
        self.own_log = LogName(config.name, incarnation)
        self._roster = tuple(sorted(config.team))
        self._jobs = jobs
        self.journal = Journal()
        self.gossip = Gossip(config.name, self.journal, config.radio.bytes_per_tick)
        self.graph = JointGraph()
        self.heard: dict[str, Heard] = {}
        start = config.start.to_pose() if config.start else None
        self.standing = Standing(self.own_log, start, config.lidar)
        self._meetings = Meetings(self.own_log, config.sightings)
        self.malformed: dict[str, int] = {}
        self._decoded: dict[LogName, int] = {}
        self._contexts: dict[LogName, LogContext] = {}
        self._records: list[bytes] = []
        self._beaconed = -MEETING_TICKS
        self._hasty = 0  # beacons since a stranger came in sight
        self.write_hello(Hello.of(config))

    # -- what this robot learns by itself

    def write_hello(self, hello: Hello) -> None:
        self._remember(EntryName(self.own_log, 0), encode_entry(hello))

    def write(self, entries: Sequence[Entry | Link]) -> None:
        """Append what this robot found to its own log."""
        for entry in entries:
            name = EntryName(self.own_log, self.journal.prefix(self.own_log))
            self._remember(name, encode_entry(entry, self._contexts[self.own_log]))

    def recall(self, records: Sequence[bytes]) -> None:
        """Take in what earlier lives wrote down, or heard; that is durable already."""
        unwritten = self._records[:]
        for record in records:
            try:
                self._remember(*decode_record(record))
            except MalformedMessageError as error:
                self._count(error.kind)
        self._records = unwritten

    def take_records(self) -> list[bytes]:
        """Entries that are new since the last call, to be made durable."""
        records, self._records = self._records, []
        return records

    # -- what it hears

    def hear(self, tick: int, frames: tuple[HeardFrame, ...]) -> None:
        """Take in what came over the radio; what is malformed is counted and dropped."""
        for frame in frames:
            try:
                self._hear_frame(tick, frame)
            except MalformedMessageError as error:
                self._count(error.kind)

    def _count(self, kind: str) -> None:
        self.malformed[kind] = self.malformed.get(kind, 0) + 1

    def _hear_frame(self, tick: int, frame: HeardFrame) -> None:
        if frame.sender not in self._roster or frame.sender == self.own_log.robot:
            raise MalformedMessageError("sender", f"{frame.sender} is not of the team")
        if frame.kind == BEACON:
            beacon = decode_beacon(frame.payload, self._roster)
            self.heard[frame.sender] = Heard(frame.sent_tick, beacon)
            self.gossip.hear_vector(tick, frame.sender, beacon.vector, beacon.hears)
            self._meet(frame.sender, frame.sent_tick, beacon)
        elif frame.kind in (ENTRIES, PART):
            for name, body in self.gossip.hear_entries(frame.sender, frame.kind, frame.payload):
                if name.log != self.own_log:
                    self._remember(name, body)
                elif not self._is_ours(name, body):
                    self._count("impostor")
        else:
            raise MalformedMessageError("kind", f"unknown kind of frame {frame.kind!r}")

    def _is_ours(self, name: EntryName, body: bytes) -> bool:
        """Whether an entry of this life is one that this robot wrote: nobody knows that better."""
        return name.sequence < self.journal.prefix(name.log) and self.journal.body(name) == body

    def _meet(self, sender: str, sent_tick: int, beacon: Beacon) -> None:
        """Write down how two robots that saw each other stood, unless both know it anyway."""
        known = self.graph.known_starts().logs
        if self.own_log in known and LogName(sender, beacon.incarnation) in known:
            return
        link = self._meetings.hear(sender, sent_tick, beacon)
        if link is not None:
            self.write([link])

    def _remember(self, name: EntryName, body: bytes) -> None:
        if not self.journal.add(name, body):
            return
        self._records.append(encode_record(name, body))
        # Later entries build on earlier ones, so a log is read only as far as it has no gap.
        for sequence in range(self._decoded.get(name.log, 0), self.journal.prefix(name.log)):
            self._read(EntryName(name.log, sequence))
            self._decoded[name.log] = sequence + 1

    def _read(self, name: EntryName) -> None:
        context = self._contexts.setdefault(name.log, LogContext())
        try:
            entry = decode_entry(self.journal.body(name), name.sequence, context)
        except MalformedMessageError as error:
            context.break_off()
            self._count(error.kind)
            return
        context.take(entry)
        if not self.graph.add(name.log, entry):
            self._count("order")
        self.standing.note_entry()

    # -- what it says

    def speak(self, tick: int, live: LiveState) -> list[RadioFrame]:
        """The frames of this tick: a beacon now and then, and what teammates in range lack."""
        self._meetings.remember(tick, live.anchor, live.T_anchor_base, live.sightings)
        frames: list[RadioFrame] = []
        spent = 0
        hasty = self._is_hasty(tick, live.meeting)
        if hasty or tick % BEACON_EVERY_TICKS == 0:
            self._beaconed = tick
            payload = encode_beacon(self._beacon(tick, live), self._roster)
            frames.append(RadioFrame(kind=BEACON, payload=payload))
            spent = len(payload) + FRAME_OVERHEAD_BYTES
        return frames + self.gossip.speak(tick, spent, hasty)

    def _is_hasty(self, tick: int, meeting: bool) -> bool:
        """Whether to speak now, since a stranger may be gone soon."""
        if not meeting:
            self._hasty = 0
            return False
        due = self._hasty < GLIMPSE_BEACONS or tick - self._beaconed >= MEETING_TICKS
        self._hasty += due
        return due

    def _beacon(self, tick: int, live: LiveState) -> Beacon:
        return Beacon(
            self.own_log.incarnation,
            live.anchor,
            live.T_anchor_base,
            np.sqrt(np.diag(live.covariance)),
            live.T_anchor_goal,
            live.finished,
            self.gossip.in_range(tick),
            self.journal.vector(),
            live.sightings,
        )

    def untold(self, tick: int) -> tuple[str, ...]:
        """Teammates that nobody passes anything on to, and that lack entries or had not finished
        when they were heard last: they have something to be told, or to tell. In an order that
        two of them share: by the first name of each pair."""
        near = self.gossip.in_range(tick)
        reached = {*near, *(other for name in near for other in self.gossip.peers[name].hears)}
        away = {
            name
            for name, heard in self.heard.items()
            if name not in reached
            if not heard.beacon.finished or self.gossip.lacks(name)
        }
        own = self.own_log.robot
        return tuple(sorted(away, key=lambda name: (min(name, own), max(name, own))))

    # -- what follows from all of it

    @property
    def solution(self) -> Solution:
        """Where the anchors of the logs lie that this robot is aligned with, in its own frame."""
        return self.standing.solution

    def solve(self, tick: int) -> bool:
        """Keep alignment and joint solution up to date, by jobs; True when a new one landed."""
        return self.standing.step(tick, self._jobs, self.graph)

    def teammate_pose(self, name: str) -> tuple[Pose2, Pose2 | None] | None:
        """Pose and goal of a teammate by its last beacon, in this robot's frame, if known."""
        heard = self.heard.get(name)
        if heard is None:
            return None
        log = LogName(name, heard.beacon.incarnation)
        anchor = anchor_pose(self.graph.log(log), self.solution.get(log), heard.beacon.anchor)
        if anchor is None:
            return None
        goal = heard.beacon.T_anchor_goal
        return anchor @ heard.beacon.T_anchor_base, None if goal is None else anchor @ goal
