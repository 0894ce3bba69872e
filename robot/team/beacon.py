"""Beacons: live state, heard by whoever is in range, superseded by the next one, never stored.

A beacon is a msgpack list:

    [incarnation, anchor, pose and sigma, goal or None, finished, hears, vector, sees]

`pose` is relative to the sender's own anchor `anchor`, as is the goal, so that it means something
to everyone who holds that anchor, whatever frame they map in; `robot.team.packing` says how they
are packed. `hears` names the robots that the sender heard lately; `vector` is its version vector,
[[robot, incarnation, count], …]. With `hears`, others know which entries they need not relay.
`sees` is whom the sender sees at that tick, [[robot, range and bearing (2 float32)], …].
"""

from dataclasses import dataclass
from typing import Any

import msgpack
import numpy as np

from protocol.errors import MalformedMessageError
from protocol.messages import Sighting
from protocol.pose import FloatArray, Pose2
from robot.team.journal import MAX_SEQUENCE, LogName
from robot.team.packing import (
    POSE_BYTES,
    pack_pose,
    pack_sigma,
    split,
    unpack_pose,
    unpack_sigma,
)

BEACON = "beacon"
MAX_TEAM = 256


@dataclass(frozen=True, slots=True)
class Beacon:
    """Live state. `sigma` (3): standard deviations of the pose, tangent space, x, y, θ."""

    incarnation: int
    anchor: int
    T_anchor_base: Pose2
    sigma: FloatArray
    T_anchor_goal: Pose2 | None
    finished: bool
    hears: tuple[str, ...]
    vector: dict[LogName, int]
    sightings: tuple[Sighting, ...] = ()


def encode_beacon(beacon: Beacon) -> bytes:
    goal = beacon.T_anchor_goal
    fields = [
        beacon.incarnation,
        beacon.anchor,
        pack_pose(beacon.T_anchor_base) + pack_sigma(beacon.sigma),
        None if goal is None else pack_pose(goal),
        beacon.finished,
        list(beacon.hears),
        [[log.robot, log.incarnation, count] for log, count in beacon.vector.items()],
        [
            [seen.robot, np.array([seen.range_m, seen.bearing_rad], dtype="<f4").tobytes()]
            for seen in beacon.sightings
        ],
    ]
    packed: bytes = msgpack.packb(fields, use_bin_type=True)
    return packed


def decode_beacon(data: bytes) -> Beacon:
    """Raises MalformedMessageError on anything that `encode_beacon` does not write."""
    try:
        fields = msgpack.unpackb(data, raw=False, max_map_len=0, max_ext_len=0)
        incarnation, anchor, where, goal, finished, hears, vector, sees = fields
        pose, sigma = split(where, POSE_BYTES)
        return Beacon(
            _number(incarnation),
            _number(anchor),
            unpack_pose(pose),
            unpack_sigma(sigma),
            None if goal is None else unpack_pose(goal),
            bool(finished),
            tuple(_name(robot) for robot in _list(hears)),
            {
                LogName(_name(robot), _number(life)): _number(count)
                for robot, life, count in _list(vector)
            },
            tuple(_sighting(robot, where) for robot, where in _list(sees)),
        )
    except Exception as error:  # a stranger's bytes fail in many ways that mean the same here
        raise MalformedMessageError("beacon", str(error)[:100]) from error


def _sighting(robot: Any, where: Any) -> Sighting:
    range_m, bearing = _floats(where, 2).tolist()
    return Sighting(robot=_name(robot), range_m=range_m, bearing_rad=bearing)


def _floats(data: Any, count: int) -> FloatArray:
    values = np.frombuffer(data, dtype="<f4").astype(np.float64)
    if values.shape != (count,) or not np.isfinite(values).all() or np.abs(values).max() > 1e6:
        raise ValueError(f"expected {count} finite numbers")
    return values


def _number(value: Any) -> int:
    if type(value) is not int or not 0 <= value < MAX_SEQUENCE:
        raise ValueError("a number is out of bounds")
    return value


def _name(value: Any) -> str:
    if not isinstance(value, str) or not 0 < len(value) <= 32:
        raise ValueError("a name is missing")
    return value


def _list(value: Any) -> list[Any]:
    if not isinstance(value, list) or len(value) > MAX_TEAM:
        raise ValueError("expected a short list")
    return value
