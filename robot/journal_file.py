"""A robot's journal on disk: append-only and checksummed, one file for each life of the robot.

A record is its length and CRC-32 (both little-endian, four bytes each) and then its bytes, of which
there is at least one. The first record says of whose life in which run the file is. What a file
holds after its robot was killed, or its disk was damaged, is read by `robot.recollection`.
"""

import os
import struct
import zlib
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

import msgpack

from protocol.errors import EarshotError, MalformedMessageError

HEADER = struct.Struct("<II")
MAX_RECORD_BYTES = 1 << 18
FORMAT = "earshot-journal 3"


class JournalFileError(EarshotError):
    """There is no folder for a journal, or it cannot be written to."""


class Life(NamedTuple):
    """Whose journal a file is: one life of a robot, in one run."""

    robot: str
    incarnation: int
    run: str


class JournalFile:
    """The file of one life, open for appending. Use in `with`."""

    def __init__(self, folder: Path, life: Life) -> None:
        """Begin the file of a life in a folder, which is made if need be."""
        try:
            folder.mkdir(parents=True, exist_ok=True)
            path = journal_path(folder, life.robot, life.incarnation)
            self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND)
        except OSError as error:
            raise JournalFileError(
                f"cannot keep a journal in {folder}: {error.strerror}; is another {life.robot} "
                "running there?"
            ) from None
        self.append([encode_life(life)])

    def append(self, records: Iterable[bytes]) -> None:
        """Write records; they survive the death of this process from here on."""
        data = b"".join(frame_record(record) for record in records)
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


def frame_record(record: bytes) -> bytes:
    """A record as it stands in the file."""
    return HEADER.pack(len(record), zlib.crc32(record)) + record


def encode_life(life: Life) -> bytes:
    packed: bytes = msgpack.packb([FORMAT, *life], use_bin_type=True)
    return packed


def decode_life(record: bytes) -> Life:
    """Raises MalformedMessageError on anything that `encode_life` does not write."""
    try:
        form, robot, incarnation, run = msgpack.unpackb(record, raw=False)
    except Exception as error:  # msgpack raises many types, all of which mean the same here
        raise MalformedMessageError("journal", str(error)[:100]) from error
    if form != FORMAT or not isinstance(robot, str) or not isinstance(run, str):
        raise MalformedMessageError("journal", f"not the beginning of {FORMAT!r}")
    if type(incarnation) is not int or incarnation < 0:
        raise MalformedMessageError("journal", "the incarnation is missing")
    return Life(robot, incarnation, run)


def journal_path(folder: Path, robot: str, incarnation: int) -> Path:
    return folder / f"{robot}.{incarnation}.journal"


def next_incarnation(folder: Path, robot: str) -> int:
    """The number after the greatest under which a robot has a journal in a folder."""
    taken = [-1]
    for path in folder.glob(f"{robot}.*.journal"):
        number = path.name.removeprefix(f"{robot}.").removesuffix(".journal")
        if number.isdecimal():
            taken.append(int(number))
    return max(taken) + 1


def remove_journals(folder: Path) -> None:
    """Remove every robot's journals from a folder, if there is one: for the start of a new run."""
    for path in folder.glob("*.journal"):
        path.unlink()
