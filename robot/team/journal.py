"""What a robot knows: a set of append-only logs, one for each robot and incarnation of it.

An entry is named (robot, incarnation, sequence number), never changes and is never renamed, so
journals can only grow towards each other: the union of two is always well defined, whatever was
lost, repeated or reordered on the way.
"""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import msgpack

from protocol.errors import MalformedMessageError

MAX_BODY_BYTES = 1 << 16
MAX_SEQUENCE = 1 << 32


class LogName(NamedTuple):
    """One life of one robot. A robot that lost its tail restarts under a new incarnation."""

    robot: str
    incarnation: int


class EntryName(NamedTuple):
    """The name of an entry; names sort by robot, incarnation and sequence number."""

    log: LogName
    sequence: int


@dataclass(slots=True)
class Log:
    """The entries of one log by sequence number. `prefix` counts those held without a gap."""

    bodies: dict[int, bytes] = field(default_factory=dict)
    prefix: int = 0


class Journal:
    """All logs that a robot holds, its own among them."""

    def __init__(self) -> None:
        self._logs: dict[LogName, Log] = {}
        self.conflicts = 0
        """Entries that came under a name already held, with another body: somebody's mistake."""

    def __len__(self) -> int:
        return sum(len(log.bodies) for log in self._logs.values())

    def logs(self) -> list[LogName]:
        return sorted(self._logs)

    def prefix(self, log: LogName) -> int:
        """How many entries of a log are held from its beginning without a gap."""
        return self._logs[log].prefix if log in self._logs else 0

    def count_of(self, robot: str) -> int:
        """How many entries of a robot are held, over all its incarnations."""
        return sum(len(log.bodies) for name, log in self._logs.items() if name.robot == robot)

    def body(self, name: EntryName) -> bytes:
        return self._logs[name.log].bodies[name.sequence]

    def add(self, name: EntryName, body: bytes) -> bool:
        """Take an entry in; False if it was here already. The first body under a name stays."""
        log = self._logs.setdefault(name.log, Log())
        held = log.bodies.get(name.sequence)
        if held is not None:
            self.conflicts += held != body
            return False
        log.bodies[name.sequence] = body
        while log.prefix in log.bodies:
            log.prefix += 1
        return True

    def vector(self) -> dict[LogName, int]:
        """The version vector: the gapless prefix of every log, in order of names."""
        return {name: self._logs[name].prefix for name in self.logs() if self._logs[name].prefix}

    def beyond(self, vector: dict[LogName, int]) -> Iterator[EntryName]:
        """Names of entries held here which a holder of `vector` lacks, in order of names."""
        for name in self.logs():
            log = self._logs[name]
            for sequence in range(vector.get(name, 0), log.prefix):
                yield EntryName(name, sequence)

    def digest(self) -> str:
        """A hash of the sorted set of entries: equal journals have equal digests."""
        total = hashlib.sha256()
        for name in self.logs():
            log = self._logs[name]
            for sequence in sorted(log.bodies):
                total.update(encode_record(EntryName(name, sequence), log.bodies[sequence]))
        return total.hexdigest()


def encode_record(name: EntryName, body: bytes) -> bytes:
    """An entry with its name, as it is stored and sent."""
    fields = [name.log.robot, name.log.incarnation, name.sequence, body]
    packed: bytes = msgpack.packb(fields, use_bin_type=True)
    return packed


def decode_record(data: bytes) -> tuple[EntryName, bytes]:
    """The entry and its name. Raises MalformedMessageError on anything else."""
    try:
        fields = msgpack.unpackb(data, raw=False, max_array_len=4, max_map_len=0, max_ext_len=0)
    except Exception as error:  # msgpack raises many types, all of which mean the same here
        raise MalformedMessageError("record", str(error)[:100]) from error
    return check_record(fields)


def check_record(fields: Any) -> tuple[EntryName, bytes]:
    """The entry in a list as `encode_record` packs it, checked. Raises MalformedMessageError."""
    if not isinstance(fields, list) or len(fields) != 4:
        raise MalformedMessageError("record", "a record is [robot, incarnation, sequence, body]")
    robot, incarnation, sequence, body = fields
    if not isinstance(robot, str) or not 0 < len(robot) <= 32:
        raise MalformedMessageError("record", "the robot's name is missing")
    for number in (incarnation, sequence):
        if type(number) is not int or not 0 <= number < MAX_SEQUENCE:
            raise MalformedMessageError("record", "a number is out of bounds")
    if not isinstance(body, bytes) or len(body) > MAX_BODY_BYTES:
        raise MalformedMessageError("record", "the body is missing or too large")
    return EntryName(LogName(robot, incarnation), sequence), body
