"""Gossip: robots in range send each other what the other lacks.

Every beacon carries the sender's version vector, so whoever hears it knows what to send. What
was sent is not sent again until the answer, a newer vector, has had time to come. Entries of
third robots travel too, unless the receiver hears their owner itself: then the owner sends them.
Loss, repetition and reordering can delay this but not corrupt it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import msgpack

from protocol.config import MAX_FRAME_BYTES
from protocol.errors import MalformedMessageError
from protocol.messages import FRAME_HEADER_BYTES, RadioFrame
from robot.team.journal import (
    MAX_BODY_BYTES,
    EntryName,
    Journal,
    LogName,
    check_record,
    decode_record,
    encode_record,
)

# Kinds of frames. Entries: a msgpack list of records. Part: [number, of, piece] of one record
# that is too long for a frame.
ENTRIES, PART = "entries", "part"

IN_RANGE_TICKS = 15  # three beacons missed: out of range
RESEND_TICKS = 15  # a newer vector would have come by now
RELAY_TICKS = 30  # the owner had its chance
PIECE_BYTES = MAX_FRAME_BYTES - 64
FRAME_OVERHEAD_BYTES = FRAME_HEADER_BYTES + 8  # what a frame costs the link beside its records


@dataclass(slots=True)
class Peer:
    """A robot that was heard: what it holds, whom it hears, and what it was sent when."""

    heard: int
    vector: dict[LogName, int] = field(default_factory=dict)
    hears: tuple[str, ...] = ()
    sent: dict[EntryName, int] = field(default_factory=dict)
    behind: dict[LogName, int] = field(default_factory=dict)
    """Since when it has lacked entries of a log that it could have had from the owner."""
    pieces: dict[EntryName, dict[int, bytes]] = field(default_factory=dict)
    """Parts of long records that came from it."""


class Gossip:
    """The exchange of journals between one robot and those it hears."""

    def __init__(self, name: str, journal: Journal, bytes_per_tick: int) -> None:
        self._name = name
        self._journal = journal
        self._bytes_per_tick = bytes_per_tick
        self.peers: dict[str, Peer] = {}

    def in_range(self, tick: int) -> tuple[str, ...]:
        """Who was heard lately, in order of names."""
        return tuple(
            name for name in sorted(self.peers) if tick - self.peers[name].heard <= IN_RANGE_TICKS
        )

    def hear_vector(
        self, tick: int, sender: str, vector: dict[LogName, int], hears: tuple[str, ...]
    ) -> None:
        """Take in what a beacon says of its sender."""
        peer = self.peers.setdefault(sender, Peer(tick))
        peer.heard, peer.hears, peer.vector = tick, hears, vector
        peer.sent = {
            name: when
            for name, when in peer.sent.items()
            if name.sequence >= vector.get(name.log, 0)
        }
        lacking = {log for log in self._journal.logs() if self._lacks(peer, log)}
        peer.behind = {log: peer.behind.get(log, tick) for log in sorted(lacking)}

    def _lacks(self, peer: Peer, log: LogName) -> bool:
        return peer.vector.get(log, 0) < self._journal.prefix(log)

    def hear_entries(self, sender: str, kind: str, payload: bytes) -> list[tuple[EntryName, bytes]]:
        """The records in a frame. Raises MalformedMessageError on one that is none of ours."""
        try:
            fields = msgpack.unpackb(payload, raw=False, max_map_len=0, max_ext_len=0)
        except Exception as error:  # msgpack raises many types, all of which mean the same here
            raise MalformedMessageError(kind, str(error)[:100]) from error
        if not isinstance(fields, list):
            raise MalformedMessageError(kind, "expected a list")
        if kind == ENTRIES:
            return [check_record(record) for record in fields]
        return self._hear_part(sender, fields)

    def _hear_part(self, sender: str, fields: list[object]) -> list[tuple[EntryName, bytes]]:
        if len(fields) != 4:
            raise MalformedMessageError(PART, "a part is [name, number, of, piece]")
        name_fields, number, of, piece = fields
        if not isinstance(name_fields, list):
            raise MalformedMessageError(PART, "the name is missing")
        name, _ = check_record([*name_fields, b""])
        limit = MAX_BODY_BYTES // PIECE_BYTES + 2
        if (
            type(number) is not int
            or type(of) is not int
            or not isinstance(piece, bytes)
            or not 0 <= number < of <= limit
        ):
            raise MalformedMessageError(PART, "a number is out of bounds")
        peer = self.peers.get(sender)
        if peer is None:  # its beacon has not come yet; the part will come again
            return []
        pieces = peer.pieces.setdefault(name, {})
        pieces[number] = piece
        if any(part not in pieces for part in range(of)):
            return []
        del peer.pieces[name]
        return [decode_record(b"".join(pieces[part] for part in range(of)))]

    def speak(self, tick: int, spent_bytes: int = 0) -> list[RadioFrame]:
        """Frames for everyone in range, within what the link carries in one tick.

        `spent_bytes` go to each of them this tick already.
        """
        frames: list[RadioFrame] = []
        for name in self.in_range(tick):
            frames += self._speak_to(name, tick, self._bytes_per_tick - spent_bytes)
        return frames

    def _speak_to(self, receiver: str, tick: int, budget: int) -> list[RadioFrame]:
        peer = self.peers[receiver]
        frames: list[RadioFrame] = []
        batch: list[bytes] = []
        size = 0
        for name in self._wanted(peer, tick):
            record = encode_record(name, self._journal.body(name))
            cost = len(record) + FRAME_OVERHEAD_BYTES * (1 + len(record) // PIECE_BYTES)
            if cost > budget:
                break
            budget -= cost
            peer.sent[name] = tick
            if len(record) > PIECE_BYTES:
                frames += _parts(receiver, name, record)
                continue
            if size + len(record) > PIECE_BYTES:
                frames.append(_entries(receiver, batch))
                batch, size = [], 0
            batch.append(record)
            size += len(record)
        if batch:
            frames.append(_entries(receiver, batch))
        return frames

    def _wanted(self, peer: Peer, tick: int) -> list[EntryName]:
        """What to send, own entries first, then those of others, oldest first in each log."""
        wanted = [
            name
            for name in self._journal.beyond(peer.vector)
            if tick - peer.sent.get(name, -RESEND_TICKS) >= RESEND_TICKS
            if self._is_mine_to_send(peer, name.log, tick)
        ]
        return sorted(wanted, key=lambda name: name.log.robot != self._name)

    def _is_mine_to_send(self, peer: Peer, log: LogName, tick: int) -> bool:
        if log.robot == self._name or log.robot not in peer.hears:
            return True
        return tick - peer.behind.get(log, tick) >= RELAY_TICKS


def _entries(receiver: str, records: Sequence[bytes]) -> RadioFrame:
    header: bytes = msgpack.Packer().pack_array_header(len(records))
    return RadioFrame(to=receiver, kind=ENTRIES, payload=header + b"".join(records))


def _parts(receiver: str, name: EntryName, record: bytes) -> list[RadioFrame]:
    pieces = [record[at : at + PIECE_BYTES] for at in range(0, len(record), PIECE_BYTES)]
    label = [name.log.robot, name.log.incarnation, name.sequence]
    return [
        RadioFrame(
            to=receiver, kind=PART, payload=msgpack.packb([label, number, len(pieces), piece])
        )
        for number, piece in enumerate(pieces)
    ]
