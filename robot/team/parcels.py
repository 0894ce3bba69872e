"""Journal entries in radio frames.

Frames of kind `entries` hold a msgpack list of runs, [robot, incarnation, first, bodies]: entries
`first`, `first + 1`, … of one log. An entry that is too long for a frame travels in frames of kind
`part`, [[robot, incarnation, sequence], number, of, piece]; the pieces together are its record.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import msgpack

from protocol.config import MAX_FRAME_BYTES
from protocol.errors import MalformedMessageError
from protocol.messages import FRAME_HEADER_BYTES, RadioFrame
from robot.team.journal import MAX_BODY_BYTES, EntryName, check_record, encode_record

ENTRIES, PART = "entries", "part"

PIECE_BYTES = MAX_FRAME_BYTES - 64
MAX_PARTS = MAX_BODY_BYTES // PIECE_BYTES + 2
# What a run of one log takes beside its bodies, a body beside its bytes, a frame beside its runs.
RUN_BYTES, BODY_BYTES = 48, 3
FRAME_OVERHEAD_BYTES = FRAME_HEADER_BYTES + 8

Named = tuple[EntryName, bytes]


class Part(NamedTuple):
    """Piece `number` of `of` of the record of an entry."""

    name: EntryName
    number: int
    of: int
    piece: bytes


def cost_of(body: bytes) -> int:
    """What an entry takes of a link at most (bytes)."""
    parts = 1 + len(body) // PIECE_BYTES
    return len(body) + BODY_BYTES + parts * (RUN_BYTES + FRAME_OVERHEAD_BYTES)


def pack(receiver: str, entries: Iterable[Named]) -> list[RadioFrame]:
    """Entries as frames, those that follow each other in one log as one run."""
    frames: list[RadioFrame] = []
    runs: list[list[Any]] = []
    size = 0
    expected: EntryName | None = None
    for name, body in entries:
        if len(body) + RUN_BYTES > PIECE_BYTES:
            frames += _parts(receiver, name, body)
            continue
        cost = len(body) + BODY_BYTES + (RUN_BYTES if name != expected else 0)
        if size + cost > PIECE_BYTES:
            frames.append(_frame(receiver, ENTRIES, runs))
            runs, size, expected = [], 0, None
        if name != expected:
            runs.append([*name.log, name.sequence, []])
        runs[-1][3].append(body)
        size += cost
        expected = EntryName(name.log, name.sequence + 1)
    if runs:
        frames.append(_frame(receiver, ENTRIES, runs))
    return frames


def unpack_entries(payload: bytes) -> list[Named]:
    """The entries in a frame. Raises MalformedMessageError on what `pack` does not write."""
    found: list[Named] = []
    for run in _fields(ENTRIES, payload):
        if not isinstance(run, list) or len(run) != 4 or not isinstance(run[3], list):
            raise MalformedMessageError(ENTRIES, "a run is [robot, incarnation, first, bodies]")
        robot, incarnation, first, bodies = run
        check_record([robot, incarnation, first, b""])
        for number, body in enumerate(bodies):
            found.append(check_record([robot, incarnation, first + number, body]))
    return found


def unpack_part(payload: bytes) -> Part:
    """The part in a frame, likewise."""
    fields = _fields(PART, payload)
    if len(fields) != 4 or not isinstance(fields[0], list):
        raise MalformedMessageError(PART, "a part is [name, number, of, piece]")
    label, number, of, piece = fields
    name, _ = check_record([*label, b""])
    if (
        type(number) is not int
        or type(of) is not int
        or not isinstance(piece, bytes)
        or not 0 <= number < of <= MAX_PARTS
    ):
        raise MalformedMessageError(PART, "a number is out of bounds")
    return Part(name, number, of, piece)


def _fields(kind: str, payload: bytes) -> list[Any]:
    try:
        fields = msgpack.unpackb(payload, raw=False, max_map_len=0, max_ext_len=0)
    except Exception as error:  # msgpack raises many types, all of which mean the same here
        raise MalformedMessageError(kind, str(error)[:100]) from error
    if not isinstance(fields, list):
        raise MalformedMessageError(kind, "expected a list")
    return fields


def _parts(receiver: str, name: EntryName, body: bytes) -> list[RadioFrame]:
    record = encode_record(name, body)
    pieces = [record[at : at + PIECE_BYTES] for at in range(0, len(record), PIECE_BYTES)]
    label = [*name.log, name.sequence]
    return [
        _frame(receiver, PART, [label, number, len(pieces), piece])
        for number, piece in enumerate(pieces)
    ]


def _frame(receiver: str, kind: str, fields: list[Any]) -> RadioFrame:
    return RadioFrame(to=receiver, kind=kind, payload=msgpack.packb(fields, use_bin_type=True))
