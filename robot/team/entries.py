"""Journal entries as bytes: what a robot knows, in a form that every robot can use.

An entry is msgpack: a list whose first item says what it is.

    hello     [0, start or None, beams, angle_min, increment, max_range, radius]
    anchor    [1, index, pose and information]
    keyframe  [2, …] or [5, …], as `robot.team.keyframes` says
    closure   [3, of, to, pose and information]
    link      [4, of, robot, incarnation, to, pose, information and evidence]

What stands together is one string of bytes, packed as `robot.team.packing` says. The pose of an
anchor, on whose chain a log hangs, is 3 float32 (x, y, θ). Evidence is 5 bytes: the kind, then
overlap, hits, crossing and ambiguity in 255ths.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import msgpack
import numpy as np

from protocol.config import RobotConfig
from protocol.errors import MalformedMessageError
from protocol.pose import FloatArray, Pose2
from robot.slam.engine import Anchor, Closure, Entry, Keyframe
from robot.team.evidence import ASSUMED, Evidence, Kind
from robot.team.journal import LogName
from robot.team.keyframes import (
    ALONE,
    FOLLOWER,
    StoredKeyframe,
    keyframe_fields,
    read_alone,
    read_follower,
)
from robot.team.packing import (
    MATRIX_BYTES,
    POSE_BYTES,
    checked_count,
    pack_matrix,
    pack_pose,
    sized,
    split,
    unpack_matrix,
    unpack_pose,
)
from robot.team.scan_codec import MAX_BEAMS

if TYPE_CHECKING:
    from robot.team.log_context import LogContext

HELLO, ANCHOR, CLOSURE, LINK = 0, 1, 3, 4
ANCHOR_POSE_BYTES, EVIDENCE_BYTES = 12, 5


@dataclass(frozen=True, slots=True)
class Hello:
    """The first entry of every log: what the later ones need to be understood.

    `start` is the pose of the robot's map frame's first anchor in the team's frame where that is
    known. `angles` of the range finder follow from angle_min and increment.
    """

    start: Pose2 | None
    beams: int
    angle_min: float
    increment: float
    max_range_m: float
    radius_m: float

    @property
    def angles(self) -> FloatArray:
        return self.angle_min + np.arange(self.beams, dtype=np.float64) * self.increment

    @staticmethod
    def of(config: RobotConfig) -> "Hello":
        lidar = config.lidar
        return Hello(
            config.start.to_pose() if config.start else None,
            lidar.beams,
            lidar.angle_min_rad,
            lidar.increment_rad,
            lidar.max_range_m,
            config.body.radius_m,
        )


@dataclass(frozen=True, slots=True)
class Link:
    """Anchor `to` of another log as seen from anchor `of` of the log that holds the entry, with
    information (3×3, tangent space at `to`) and what speaks for it."""

    of: int
    log: LogName
    to: int
    T_of_to: Pose2
    information: FloatArray
    evidence: Evidence = ASSUMED


Known = Anchor | StoredKeyframe | Closure | Hello | Link
"""What comes out of a journal."""


def encode_entry(entry: Entry | Hello | Link, context: "LogContext | None" = None) -> bytes:
    """The body of an entry. `context` is what its log says before it, if that is to be built on."""
    packed: bytes = msgpack.packb(_fields(entry, context), use_bin_type=True)
    return packed


def _fields(entry: Entry | Hello | Link, context: "LogContext | None") -> list[Any]:
    if isinstance(entry, Hello):
        start = None if entry.start is None else entry.start.to_array().astype("<f8").tobytes()
        lidar = [entry.beams, entry.angle_min, entry.increment, entry.max_range_m]
        return [HELLO, start, *lidar, entry.radius_m]
    if isinstance(entry, Anchor):
        pose = entry.T_previous_anchor.to_array().astype("<f4").tobytes()
        return [ANCHOR, entry.index, pose + pack_matrix(entry.information)]
    if isinstance(entry, Keyframe):
        return keyframe_fields(entry, context)
    if isinstance(entry, Link):
        measured = (
            pack_pose(entry.T_of_to) + pack_matrix(entry.information) + _shares(entry.evidence)
        )
        return [LINK, entry.of, *entry.log, entry.to, measured]
    return [CLOSURE, entry.of, entry.to, pack_pose(entry.T_of_to) + pack_matrix(entry.information)]


def decode_entry(body: bytes, index: int, context: "LogContext | None" = None) -> Known:
    """The entry in a body; `index` is what a keyframe is numbered with, `context` what its log says
    before it.

    Raises MalformedMessageError on anything that `encode_entry` does not write.
    """
    try:
        fields = msgpack.unpackb(body, raw=False, max_ext_len=0, max_map_len=0, max_array_len=8)
    except Exception as error:  # msgpack raises many types, all of which mean the same here
        raise MalformedMessageError("entry", str(error)[:100]) from error
    try:
        kind, *rest = fields
        return _DECODERS[kind](rest, index, context)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise MalformedMessageError("entry", str(error)[:100]) from error


def _decode_hello(rest: list[Any], _: int, __: "LogContext | None") -> Hello:
    start, beams, angle_min, increment, max_range, radius = rest
    if start is not None:
        values = np.frombuffer(sized(start, 24), dtype="<f8")
        if not np.isfinite(values).all():
            raise ValueError("the start is not finite")
        start = Pose2.from_array(values)
    numbers = [float(value) for value in (angle_min, increment, max_range, radius)]
    if not (all(map(math.isfinite, numbers)) and 0 < numbers[2] <= 1000 and 0 < numbers[3] <= 10):
        raise ValueError("a sensor value is out of bounds")
    return Hello(start, checked_count(beams, MAX_BEAMS), *numbers)


def _decode_anchor(rest: list[Any], _: int, __: "LogContext | None") -> Anchor:
    index, measured = rest
    pose, information = split(measured, ANCHOR_POSE_BYTES)
    values = np.frombuffer(sized(pose, ANCHOR_POSE_BYTES), dtype="<f4").astype(np.float64)
    if not np.isfinite(values).all() or np.abs(values).max() > 1e6:
        raise ValueError("a pose is out of bounds")
    return Anchor(checked_count(index), Pose2.from_array(values), unpack_matrix(information))


def _decode_closure(rest: list[Any], _: int, __: "LogContext | None") -> Closure:
    of, to, measured = rest
    pose, information = split(measured, POSE_BYTES)
    if of == to:
        raise ValueError("a closure joins an anchor with itself")
    T_of_to = unpack_pose(pose)
    return Closure(checked_count(of), checked_count(to), T_of_to, unpack_matrix(information))


def _decode_link(rest: list[Any], _: int, __: "LogContext | None") -> Link:
    of, robot, incarnation, to, measured = rest
    if not isinstance(robot, str) or not 0 < len(robot) <= 32:
        raise ValueError("the robot's name is missing")
    log = LogName(robot, checked_count(incarnation))
    pose, information, evidence = split(measured, POSE_BYTES, MATRIX_BYTES)
    return Link(
        checked_count(of),
        log,
        checked_count(to),
        unpack_pose(pose),
        unpack_matrix(information),
        _evidence(evidence),
    )


_DECODERS: dict[int, Callable[[list[Any], int, "LogContext | None"], Known]] = {
    HELLO: _decode_hello,
    ANCHOR: _decode_anchor,
    ALONE: read_alone,
    FOLLOWER: read_follower,
    CLOSURE: _decode_closure,
    LINK: _decode_link,
}


def _evidence(data: bytes) -> Evidence:
    if not data:
        return ASSUMED
    kind, *shares = sized(data, EVIDENCE_BYTES)
    return Evidence(Kind(kind), *(share / 255.0 for share in shares))


def _shares(evidence: Evidence) -> bytes:
    if evidence == ASSUMED:
        return b""
    shares = (evidence.overlap, evidence.hits, evidence.crossing, evidence.ambiguity)
    return bytes([evidence.kind, *(round(255.0 * min(max(s, 0.0), 1.0)) for s in shares)])
