"""What a robot that starts again remembers: the journals of its earlier lives, as far as they are
whole.

A robot that was killed while it wrote leaves a torn record at the end of its file: that is cut off.
Where bytes were damaged, reading goes on at the next record that its checksum vouches for; what
lies between is lost here, but teammates may still have it. Both are told with the place.
"""

import logging
import os
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from protocol.errors import MalformedMessageError
from robot.journal_file import HEADER, MAX_RECORD_BYTES, decode_life

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Contents:
    """What a journal file holds: its whole records (the one that says whose it is first), the
    stretches of bytes (from, to) between them that are damaged, and where a torn end begins."""

    records: tuple[bytes, ...]
    damaged: tuple[tuple[int, int], ...]
    end: int
    size: int

    @property
    def torn(self) -> bool:
        return self.end < self.size


def read_contents(path: Path) -> Contents:
    """The whole records of a journal file, whatever became of the others."""
    data = path.read_bytes()
    records: list[bytes] = []
    damaged: list[tuple[int, int]] = []
    end = 0
    for begin, record in _whole_records(data):
        if begin > end:
            damaged.append((end, begin))
        records.append(record)
        end = begin + HEADER.size + len(record)
    return Contents(tuple(records), tuple(damaged), end, len(data))


def read_records(path: Path) -> list[bytes]:
    """The journal entries in a file, as far as they are whole."""
    records = read_contents(path).records
    try:
        decode_life(records[0])
    except (IndexError, MalformedMessageError):
        return list(records)
    return list(records[1:])


def recall(folder: Path, robot: str, run: str) -> list[bytes]:
    """The entries that a robot's earlier lives in this run left in a folder. Torn ends are cut off;
    damage and journals that are none of its own are told and passed over."""
    entries: list[bytes] = []
    for path in sorted(folder.glob(f"{robot}.*.journal")):
        contents = read_contents(path)
        objection = _objection(contents, robot, run)
        if objection:
            log.warning("%s: %s; passed over", path, objection)
            continue
        for begin, end in contents.damaged:
            log.warning("%s: bytes %d to %d are damaged and passed over", path, begin, end)
        if contents.torn:
            log.warning(
                "%s: torn off at byte %d of %d; the rest is cut off",
                path,
                contents.end,
                contents.size,
            )
            os.truncate(path, contents.end)
        entries += contents.records[1:]
    return entries


def _objection(contents: Contents, robot: str, run: str) -> str:
    """Why a journal is no memory of this robot in this run; empty if it is."""
    try:
        life = decode_life(contents.records[0])
    except (IndexError, MalformedMessageError):
        return "does not say whose it is"
    if life.robot != robot:
        return f"the journal of another robot, {life.robot}"
    return "" if life.run == run else "the journal of another run"


def _whole_records(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Where each whole record begins, and its bytes."""
    at = 0
    while at + HEADER.size < len(data):
        record = _record_at(data, at)
        if record is None:
            at += 1
            continue
        yield at, record
        at += HEADER.size + len(record)


def _record_at(data: bytes, at: int) -> bytes | None:
    length, checksum = HEADER.unpack_from(data, at)
    first = at + HEADER.size
    if not 0 < length <= min(MAX_RECORD_BYTES, len(data) - first):
        return None
    record = data[first : first + length]
    return record if zlib.crc32(record) == checksum else None
