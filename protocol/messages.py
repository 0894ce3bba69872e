"""The messages between the world, the robots and the station.

A `Sense` and an `Action` are the whole interface of a brain. On the wire their radio frames
travel on keys of their own, before the message that counts them, so `frames` is left out of the
encoding and `frame_count` says how many belong to it.
"""

import math
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import Field, field_validator, model_validator

from protocol.config import BROADCAST, MAX_FRAME_BYTES, PoseModel, RobotName
from protocol.model import (
    Covariance,
    EdgeNodes,
    EdgeValues,
    Float32Vector,
    Float64Vector,
    Int8Matrix,
    Int64Vector,
    Message,
    Model,
    Points,
    Poses,
)
from protocol.pose import Pose2

# Sender, recipient, kind and tick as a radio would pack them. One number for every frame, so that
# both ends count the same bytes without encoding the frame again.
FRAME_HEADER_BYTES = 24

MAX_PLACE_M = 1e6

Ranges = npt.NDArray[np.float32] | None
Tick = Annotated[int, Field(ge=0, le=2**53)]
Recipient = Annotated[str, Field(pattern=r"^(\*|[a-z][a-z0-9_-]{0,31})$")]
TopicName = Annotated[str, Field(pattern=r"^[a-z][a-z-]{0,31}$")]
MessageCount = Annotated[int, Field(ge=0, le=2**53)]
Usage = dict[TopicName, MessageCount]
FrameKind = Annotated[str, Field(pattern=r"^[a-z][a-z0-9-]{0,15}$")]


class RadioFrame(Message):
    """What one robot hands to its radio: at most `MAX_FRAME_BYTES` of payload."""

    SCHEMA: ClassVar[str] = "radio-frame"

    to: Recipient = BROADCAST
    kind: FrameKind
    payload: Annotated[bytes, Field(max_length=MAX_FRAME_BYTES)]

    @property
    def size_bytes(self) -> int:
        """What the frame takes on the air, and in every count of bytes."""
        return FRAME_HEADER_BYTES + len(self.payload)


class HeardFrame(Message):
    """A frame that passed the gate."""

    SCHEMA: ClassVar[str] = "heard-frame"

    sender: RobotName
    sent_tick: Tick
    to: Recipient
    kind: FrameKind
    payload: Annotated[bytes, Field(max_length=MAX_FRAME_BYTES)]

    @property
    def size_bytes(self) -> int:
        """As `RadioFrame.size_bytes` of the frame that was sent."""
        return FRAME_HEADER_BYTES + len(self.payload)


class Sighting(Model):
    """A teammate in line of sight: range (m) and bearing (rad) to its centre, robot frame."""

    robot: RobotName
    range_m: float = Field(ge=0.0)
    bearing_rad: float

    @property
    def place(self) -> Pose2:
        """Where that is in the robot's frame; which way the other looks is not seen."""
        x = self.range_m * math.cos(self.bearing_rad)
        return Pose2(x, self.range_m * math.sin(self.bearing_rad), 0.0)


class Sense(Message):
    """What a robot perceives at one tick.

    `encoders` count cumulatively (left, right for a differential drive), so that a lost sense
    loses no motion. `ranges` is one scan in metres, +inf where nothing was hit, NaN nowhere, or
    none when no scan is due. `stamp` is simulated time in seconds; gaps are legal.
    """

    SCHEMA: ClassVar[str] = "sense"

    tick: Tick
    stamp: float
    encoders: tuple[int, ...]
    ranges: Float32Vector | None = None
    sightings: tuple[Sighting, ...] = ()
    frame_count: int = Field(0, ge=0)
    frames: tuple[HeardFrame, ...] = Field((), exclude=True)

    @field_validator("ranges")
    @classmethod
    def _are_distances(cls, ranges: Ranges) -> Ranges:
        if ranges is not None and not np.all(ranges >= 0.0):
            raise ValueError("a range is a distance or +inf")
        return ranges


class DriveCommand(Model):
    """Body velocity: forward and to the left (m/s; the latter 0 on a differential drive), turn
    rate (rad/s, counter-clockwise). The drive clips it to what the body can do."""

    forward_mps: float = 0.0
    left_mps: float = 0.0
    turn_rps: float = 0.0


STOP = DriveCommand()


class Action(Message):
    """A robot's answer to the sense of the same tick."""

    SCHEMA: ClassVar[str] = "action"

    tick: Tick
    drive: DriveCommand = STOP
    finished: bool = False
    frame_count: int = Field(0, ge=0)
    frames: tuple[RadioFrame, ...] = Field((), exclude=True)


class GridPatch(Model):
    """A rectangle of an occupancy grid: −1 unknown, 0…100 occupied in percent.

    Row 0 is the lowest y; `origin` is the pose of the lower left corner of cell (0, 0) in the
    robot's map frame.
    """

    resolution_m: float = Field(ge=0.005, le=10.0)
    origin_x_m: float = Field(ge=-MAX_PLACE_M, le=MAX_PLACE_M)
    origin_y_m: float = Field(ge=-MAX_PLACE_M, le=MAX_PLACE_M)
    cells: Int8Matrix

    @field_validator("cells")
    @classmethod
    def _are_percent(cls, cells: npt.NDArray[np.int8]) -> npt.NDArray[np.int8]:
        if np.any((cells < -1) | (cells > 100)):
            raise ValueError("a cell is −1 or 0…100")
        return cells


class TeammateView(Model):
    """What a robot knows of one teammate."""

    robot: RobotName
    in_range: bool
    last_heard_tick: int = Field(ge=-1)
    entries: int = Field(ge=0, description="journal entries of that robot held here")
    pose: PoseModel | None = None
    alignment: Literal["unknown", "tentative", "aligned", "contradictory"] = "unknown"
    alignment_reason: str = Field("", max_length=200)


class Report(Message):
    """What the operator may see of a robot, each second or so."""

    SCHEMA: ClassVar[str] = "report"

    tick: Tick
    pose: PoseModel
    covariance: Covariance
    activity: str = Field(max_length=200, description="one line: what the robot is doing and why")
    goal: PoseModel | None = None
    path: Points
    known_m2: float = Field(ge=0.0, description="area of the joint map that is known")
    frontier_m: float = Field(ge=0.0, description="length of frontier that is left")
    finished: bool
    team: tuple[TeammateView, ...]
    loop_closures: int = Field(ge=0)
    journal_entries: int = Field(ge=0)
    malformed: int = Field(0, ge=0, description="messages counted and dropped")


class MapReply(Message):
    """Answer of `robot/<name>/map`: from the robot's own scans alone, and the joint map.

    `saved` goes with exact maps: the robot's submaps and pose graph in the frame of its group
    (docs/map-format.md); nothing of an engine that makes none.
    """

    SCHEMA: ClassVar[str] = "map-reply"

    own: GridPatch
    joint: GridPatch
    saved: bytes = b""


class TrajectoryReply(Message):
    """Answer of `robot/<name>/trajectory`: poses n×3 (x, y, θ) in the frame that `frame` names,
    that of the robots it is aligned with.

    `online` is each estimate as it was at its own tick, `final` the same ticks as the joint
    solution places them now. `nodes` (m×3) and `edges` are the robot's own pose graph:
    `edge_nodes` k×2, and `edge_values` k×9 with the measured (x, y, θ) and I11 I12 I13 I22 I23
    I33. The counts are of radio frames and bytes, to be held against the world's ledger; `sent_for`
    and `heard_for` (by sender) are the same bytes by what they were for.
    """

    SCHEMA: ClassVar[str] = "trajectory-reply"

    ticks: Int64Vector
    stamps: Float64Vector
    online: Poses
    final: Poses
    dead_reckoned: Poses
    nodes: Poses
    edge_nodes: EdgeNodes
    edge_values: EdgeValues
    journal_digest: str
    frame: str = Field("", max_length=64)
    frames_sent: int = Field(ge=0)
    bytes_sent: int = Field(ge=0)
    frames_heard: int = Field(ge=0)
    bytes_heard: int = Field(ge=0)
    sent_for: Usage = Field(default_factory=dict)
    heard_for: dict[RobotName, Usage] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        n = len(self.ticks)
        if any(len(rows) != n for rows in (self.stamps, self.online, self.final)):
            raise ValueError("each tick needs a stamp and a pose")
        if len(self.dead_reckoned) != n:
            raise ValueError("each tick needs a dead-reckoned pose")
        if n and (self.ticks[0] < 0 or np.any(np.diff(self.ticks) <= 0)):
            raise ValueError("ticks only rise, from 0 on")
        if len(self.edge_values) != len(self.edge_nodes):
            raise ValueError("each edge needs its nodes and its values")
        if np.any((self.edge_nodes < 0) | (self.edge_nodes >= len(self.nodes))):
            raise ValueError("an edge ends at a node that is not there")
        return self


class Tally(Message):
    """Answer of `robot/<name>/tally`: how many messages this robot has put on the wire and taken
    from it, by topic. What was refused as malformed is not among the received."""

    SCHEMA: ClassVar[str] = "tally"

    sent: dict[TopicName, MessageCount]
    received: dict[TopicName, MessageCount]
    malformed: MessageCount


class Ended(Message):
    """The world's last word to a robot: the run is over, and why."""

    SCHEMA: ClassVar[str] = "ended"

    tick: Tick
    reason: str = Field(max_length=200)


class Truth(Message):
    """Ground truth for the operator alone: true poses n×3 (x, y, θ) in the world frame, in the
    order of `robots`, and which of them can hear each other (n×n, 0 or 1)."""

    SCHEMA: ClassVar[str] = "truth"

    tick: Tick
    stamp: float
    robots: tuple[RobotName, ...]
    poses: Poses
    links: Int8Matrix

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if len(self.poses) != len(self.robots):
            raise ValueError("each robot needs a pose")
        _check_links(self.robots, self.links)
        return self


class FrameCount(Model):
    """Radio frames, and the bytes that they take on the air."""

    frames: int = Field(ge=0)
    bytes: int = Field(ge=0)


class LiveRadio(Message):
    """The radio for the operator alone: who can hear whom now (n×n, 0 or 1, in the order of
    `robots`), and the ledger so far: offered = delivered + dropped by reason + in flight."""

    SCHEMA: ClassVar[str] = "live-radio"

    tick: Tick
    stamp: float
    robots: tuple[RobotName, ...]
    links: Int8Matrix
    offered: FrameCount
    delivered: FrameCount
    dropped: dict[str, FrameCount]
    in_flight: FrameCount

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        _check_links(self.robots, self.links)
        return self


class LiveScore(Message):
    """How the team is doing by the referee's word, for the operator alone."""

    SCHEMA: ClassVar[str] = "live-score"

    tick: Tick
    stamp: float
    coverage: float | None = Field(None, description="by the newest maps; none before the first")
    collisions: int = Field(ge=0)
    alive: tuple[RobotName, ...]
    finished: tuple[RobotName, ...]


def _check_links(robots: tuple[str, ...], links: npt.NDArray[np.int8]) -> None:
    if links.shape != (len(robots), len(robots)):
        raise ValueError("each pair of robots needs a link, or none")
