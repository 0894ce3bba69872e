"""A robot's journal on disk: append-only and checksummed, one file per incarnation.

A record is its length and CRC-32 (both little-endian, four bytes each) and then its bytes. A
robot that was killed while it wrote leaves a torn record at the end, which reading stops at; it
starts again in a new file under a new incarnation, so that no entry name is ever used twice.
"""

import os
import struct
import zlib
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import Self

from protocol.errors import EarshotError

HEADER = struct.Struct("<II")
MAX_RECORD_BYTES = 1 << 24


class JournalFileError(EarshotError):
    """The journal's folder cannot be written to."""


class JournalFile:
    """The file of this incarnation, open for appending. Use in `with`."""

    def __init__(self, folder: Path, robot: str) -> None:
        """Open the next free incarnation of a robot in a folder, which is made if need be."""
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self.incarnation = next_incarnation(folder, robot)
            path = journal_path(folder, robot, self.incarnation)
            self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND)
        except OSError as error:
            raise JournalFileError(f"cannot keep a journal in {folder}: {error.strerror}") from None

    def append(self, records: Iterable[bytes]) -> None:
        """Write records; they survive the death of this process from here on."""
        data = b"".join(HEADER.pack(len(r), zlib.crc32(r)) + r for r in records)
        while data:
            data = data[os.write(self._descriptor, data) :]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        os.fsync(self._descriptor)
        os.close(self._descriptor)


def journal_path(folder: Path, robot: str, incarnation: int) -> Path:
    return folder / f"{robot}.{incarnation}.journal"


def next_incarnation(folder: Path, robot: str) -> int:
    """The first number under which a robot has no journal in a folder."""
    incarnation = 0
    while journal_path(folder, robot, incarnation).exists():
        incarnation += 1
    return incarnation


def remove_journals(folder: Path) -> None:
    """Remove every robot's journals from a folder, if there is one: for the start of a new run."""
    for path in folder.glob("*.journal"):
        path.unlink()


def read_records(path: Path) -> list[bytes]:
    """The whole records of a journal file, up to the first that is torn or damaged."""
    data = path.read_bytes()
    records, offset = [], 0
    while offset + HEADER.size <= len(data):
        length, checksum = HEADER.unpack_from(data, offset)
        offset += HEADER.size
        record = data[offset : offset + length]
        if len(record) != length or length > MAX_RECORD_BYTES or zlib.crc32(record) != checksum:
            break
        records.append(record)
        offset += length
    return records
