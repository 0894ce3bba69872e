"""Beacons: live state, heard by whoever is in range, superseded by the next one, never stored.

A beacon is a msgpack list:

    [incarnation, anchor, pose and sigma, goal or None, finished, hears, counts, lives, sees]

`pose` is relative to the sender's own anchor `anchor`, as is the goal, so that it means something
to everyone who holds that anchor, whatever frame they map in; `robot.team.packing` says how they
are packed. Robots are told by their place in the roster, the names of the team in their order.
`hears` is whom the sender heard lately, a bit for each of the roster. The version vector is what
is held of the first life of each of the roster (`counts`; none beyond its end), and of all
other logs (`lives`, [[robot, incarnation, count], …]). With both, others know which entries they
need not relay. `sees` is whom the sender sees at that tick: of each its place in the roster (a
byte), range and bearing.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import msgpack
import numpy as np

from protocol.errors import MalformedMessageError
from protocol.messages import Sighting
from protocol.pose import FloatArray, Pose2
from robot.team.journal import MAX_SEQUENCE, LogName
from robot.team.packing import (
    DIRECTION_BYTES,
    POSE_BYTES,
    pack_direction,
    pack_pose,
    pack_sigma,
    split,
    unpack_direction,
    unpack_pose,
    unpack_sigma,
)

BEACON = "beacon"
MAX_TEAM = 256

Roster = tuple[str, ...]
"""All robots of the team, sorted: the same for each of them."""


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


def encode_beacon(beacon: Beacon, roster: Roster) -> bytes:
    goal = beacon.T_anchor_goal
    counts = [beacon.vector.get(LogName(robot, 0), 0) for robot in roster]
    while counts and not counts[-1]:
        counts.pop()
    lives = [
        [*log, count]
        for log, count in beacon.vector.items()
        if log.incarnation or log.robot not in roster
    ]
    fields = [
        beacon.incarnation,
        beacon.anchor,
        pack_pose(beacon.T_anchor_base) + pack_sigma(beacon.sigma),
        None if goal is None else pack_pose(goal),
        beacon.finished,
        np.packbits([robot in beacon.hears for robot in roster]).tobytes(),
        counts,
        lives,
        b"".join(
            bytes([roster.index(seen.robot)]) + pack_direction(seen.range_m, seen.bearing_rad)
            for seen in beacon.sightings
            if seen.robot in roster
        ),
    ]
    packed: bytes = msgpack.packb(fields, use_bin_type=True)
    return packed


def decode_beacon(data: bytes, roster: Roster) -> Beacon:
    """Raises MalformedMessageError on anything that `encode_beacon` does not write."""
    try:
        fields = msgpack.unpackb(data, raw=False, max_map_len=0, max_ext_len=0)
        incarnation, anchor, where, goal, finished, hears, counts, lives, sees = fields
        pose, sigma = split(where, POSE_BYTES)
        return Beacon(
            _number(incarnation),
            _number(anchor),
            unpack_pose(pose),
            unpack_sigma(sigma),
            None if goal is None else unpack_pose(goal),
            bool(finished),
            _heard(hears, roster),
            _vector(_list(counts), _list(lives), roster),
            tuple(_sightings(sees, roster)),
        )
    except Exception as error:  # a stranger's bytes fail in many ways that mean the same here
        raise MalformedMessageError("beacon", str(error)[:100]) from error


def _heard(data: bytes, roster: Roster) -> tuple[str, ...]:
    bits = np.unpackbits(np.frombuffer(data, dtype=np.uint8))
    if len(bits) != 8 * -(-len(roster) // 8):
        raise ValueError("expected a bit for each robot")
    return tuple(robot for robot, heard in zip(roster, bits, strict=False) if heard)


def _vector(counts: list[Any], lives: list[Any], roster: Roster) -> dict[LogName, int]:
    if len(counts) > len(roster):
        raise ValueError("more counts than robots")
    first = {
        LogName(robot, 0): _number(count)
        for robot, count in zip(roster, counts, strict=False)
        if count
    }
    others = {LogName(_name(robot), _number(life)): _number(count) for robot, life, count in lives}
    return first | others


def _sightings(data: bytes, roster: Roster) -> Iterator[Sighting]:
    size = 1 + DIRECTION_BYTES
    if len(data) % size:
        raise ValueError("expected whole sightings")
    for at in range(0, len(data), size):
        range_m, bearing = unpack_direction(data[at + 1 : at + size])
        yield Sighting(robot=roster[data[at]], range_m=range_m, bearing_rad=bearing)


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
