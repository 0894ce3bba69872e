"""The team as one robot knows it: it hears, remembers, and speaks."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from protocol.config import RobotConfig
from protocol.errors import MalformedMessageError
from protocol.messages import HeardFrame, RadioFrame
from protocol.pose import FloatArray, Pose2
from robot.jobs import Jobs
from robot.slam.engine import Entry
from robot.team.beacon import Beacon, decode_beacon, encode_beacon
from robot.team.entries import Hello, Link, decode_entry, encode_entry
from robot.team.gossip import ENTRIES, FRAME_OVERHEAD_BYTES, PART, Gossip
from robot.team.joint import JointGraph, Solution, anchor_pose, solve
from robot.team.journal import EntryName, Journal, LogName, encode_record

BEACON = "beacon"
BEACON_EVERY_TICKS = 5
SOLVE_EVERY_TICKS = 20
SOLVE_DELAY_TICKS = 5


@dataclass(frozen=True, slots=True)
class LiveState:
    """What a beacon says of the robot itself, relative to its own anchor `anchor`."""

    anchor: int
    T_anchor_base: Pose2
    covariance: FloatArray
    T_anchor_goal: Pose2 | None
    finished: bool


@dataclass(frozen=True, slots=True)
class Heard:
    """The last beacon of a teammate."""

    tick: int
    beacon: Beacon


class Team:
    """Journal, gossip, beacons and the joint solution of one robot."""

    def __init__(self, config: RobotConfig, incarnation: int, jobs: Jobs) -> None:
        self.own_log = LogName(config.name, incarnation)
        self._members = config.team
        self._jobs = jobs
        self.journal = Journal()
        self.gossip = Gossip(config.name, self.journal, config.radio.bytes_per_tick)
        self.graph = JointGraph()
        self.heard: dict[str, Heard] = {}
        self.solution: Solution = {}
        self.malformed: dict[str, int] = {}
        self._decoded: dict[LogName, int] = {}
        self._records: list[bytes] = []
        self._unsolved = False
        self.write_hello(Hello.of(config))

    # -- what this robot learns by itself

    def write_hello(self, hello: Hello) -> None:
        self._remember(EntryName(self.own_log, 0), encode_entry(hello))

    def write(self, entries: Sequence[Entry | Link]) -> None:
        """Append what this robot found to its own log."""
        for entry in entries:
            name = EntryName(self.own_log, self.journal.prefix(self.own_log))
            self._remember(name, encode_entry(entry))

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
                self.malformed[error.kind] = self.malformed.get(error.kind, 0) + 1

    def _hear_frame(self, tick: int, frame: HeardFrame) -> None:
        if frame.sender not in self._members or frame.sender == self.own_log.robot:
            raise MalformedMessageError("sender", f"{frame.sender} is not of the team")
        if frame.kind == BEACON:
            beacon = decode_beacon(frame.payload)
            self.heard[frame.sender] = Heard(frame.sent_tick, beacon)
            self.gossip.hear_vector(tick, frame.sender, beacon.vector, beacon.hears)
        elif frame.kind in (ENTRIES, PART):
            for name, body in self.gossip.hear_entries(frame.sender, frame.kind, frame.payload):
                if name.log == self.own_log:
                    continue  # nobody knows this life of ours better than we do
                self._remember(name, body)
        else:
            raise MalformedMessageError("kind", f"unknown kind of frame {frame.kind!r}")

    def _remember(self, name: EntryName, body: bytes) -> None:
        if not self.journal.add(name, body):
            return
        self._records.append(encode_record(name, body))
        # Later entries build on earlier ones, so a log is read only as far as it has no gap.
        for sequence in range(self._decoded.get(name.log, 0), self.journal.prefix(name.log)):
            self._read(EntryName(name.log, sequence))
            self._decoded[name.log] = sequence + 1

    def _read(self, name: EntryName) -> None:
        try:
            entry = decode_entry(self.journal.body(name), name.sequence)
        except MalformedMessageError as error:
            self.malformed[error.kind] = self.malformed.get(error.kind, 0) + 1
            return
        if not self.graph.add(name.log, entry):
            self.malformed["order"] = self.malformed.get("order", 0) + 1
        self._unsolved = True

    # -- what it says

    def speak(self, tick: int, live: LiveState) -> list[RadioFrame]:
        """The frames of this tick: a beacon now and then, and what teammates in range lack."""
        frames: list[RadioFrame] = []
        spent = 0
        if tick % BEACON_EVERY_TICKS == 0:
            payload = encode_beacon(self._beacon(tick, live))
            frames.append(RadioFrame(kind=BEACON, payload=payload))
            spent = len(payload) + FRAME_OVERHEAD_BYTES
        return frames + self.gossip.speak(tick, spent)

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
        )

    # -- what follows from all of it

    def solve(self, tick: int) -> bool:
        """Keep the joint solution up to date, by a job; True when a new one landed."""
        landed = self._jobs.landed("joint", tick)
        if landed:
            self.solution = landed[-1]
        if self._unsolved and not self._jobs.pending("joint") and tick % SOLVE_EVERY_TICKS == 0:
            self._jobs.start("joint", tick, SOLVE_DELAY_TICKS, solve, self.graph.problem())
            self._unsolved = False
        return bool(landed)

    def teammate_pose(self, name: str) -> tuple[Pose2, Pose2 | None] | None:
        """Pose and goal of a teammate by its last beacon, in the team's frame, if that is known."""
        heard = self.heard.get(name)
        if heard is None:
            return None
        log = LogName(name, heard.beacon.incarnation)
        anchor = anchor_pose(self.graph.log(log), self.solution.get(log), heard.beacon.anchor)
        if anchor is None:
            return None
        goal = heard.beacon.T_anchor_goal
        return anchor @ heard.beacon.T_anchor_base, None if goal is None else anchor @ goal
