"""Reader of CARMEN logs: laser scans (FLASER) and wheel odometry (ODOM), plain or gzipped.

A line is `FLASER n r1 … rn x y θ odom_x odom_y odom_θ ipc_time host logger_time`; an odometry line
is `ODOM x y θ v ω a ipc_time host logger_time`. Everything else in a log is skipped.
"""

import gzip
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import numpy as np

from protocol.errors import EarshotError
from protocol.pose import FloatArray, Pose2

FLASER_TAIL = 9
ODOM_FIELDS = 10


class CarmenError(EarshotError):
    """A log that cannot be read; the message names file and line and says what was expected."""


@dataclass(frozen=True, slots=True)
class CarmenOdometry:
    """The wheel odometry's own idea of where the robot is, `T_odom_base`, at `stamp` (s)."""

    stamp: float
    odometry: Pose2


@dataclass(frozen=True, slots=True)
class CarmenScan:
    """One scan: ranges (n, m) as logged, `T_odom_base` of the wheels, and the two clocks (s).

    `pose` is whatever the logging machine believed (raw logs repeat the odometry there).
    """

    stamp: float
    logger_stamp: float
    odometry: Pose2
    pose: Pose2
    ranges: FloatArray


def read_carmen(path: Path) -> Iterator[CarmenScan | CarmenOdometry]:
    """The scans and odometry readings of a log, in the order of the file, one at a time.

    Raises CarmenError when the file is missing, no text, or has a line that is cut or no number.
    """
    try:
        with _open(path) as lines:
            for number, line in enumerate(lines, start=1):
                keyword = line.partition(" ")[0].strip()
                if keyword == "FLASER":
                    yield _scan(line, path, number)
                elif keyword == "ODOM":
                    yield _odometry(line, path, number)
    except (OSError, EOFError, UnicodeDecodeError) as error:
        raise CarmenError(f"{path}: not a readable CARMEN log ({error})") from error


def read_scans(path: Path) -> list[CarmenScan]:
    """All scans of a log; raises CarmenError also when there are none or their sizes differ."""
    scans = [record for record in read_carmen(path) if isinstance(record, CarmenScan)]
    if not scans:
        raise CarmenError(f"{path}: no FLASER line; expected a CARMEN log with laser scans")
    sizes = sorted({len(scan.ranges) for scan in scans})
    if len(sizes) > 1:
        raise CarmenError(f"{path}: scans of different sizes ({sizes}); expected one laser")
    return scans


def _open(path: Path) -> TextIO:
    if path.suffix == ".gz":
        return gzip.open(path, "rt", encoding="ascii")
    return path.open(encoding="ascii")


def _scan(line: str, path: Path, number: int) -> CarmenScan:
    fields = line.split()
    beams = int(fields[1]) if len(fields) > 1 and fields[1].isdecimal() else 0
    if beams < 1 or len(fields) != 2 + beams + FLASER_TAIL:
        raise CarmenError(
            f"{path}:{number}: expected FLASER, a number n, n ranges and {FLASER_TAIL} more; "
            f"got {len(fields)} fields for n = {beams}"
        )
    tail = fields[2 + beams :]
    values = _numbers([*fields[2 : 2 + beams], *tail[:7], tail[8]], path, number)
    ranges, rest = values[:beams], values[beams:]
    return CarmenScan(
        stamp=float(rest[6]),
        logger_stamp=float(rest[7]),
        odometry=Pose2.from_array(rest[3:6]),
        pose=Pose2.from_array(rest[:3]),
        ranges=ranges,
    )


def _odometry(line: str, path: Path, number: int) -> CarmenOdometry:
    fields = line.split()
    if len(fields) != ODOM_FIELDS:
        raise CarmenError(
            f"{path}:{number}: expected ODOM and {ODOM_FIELDS - 1} fields, got {len(fields) - 1}"
        )
    values = _numbers(fields[1:8], path, number)
    return CarmenOdometry(stamp=float(values[6]), odometry=Pose2.from_array(values[:3]))


def _numbers(fields: list[str], path: Path, number: int) -> FloatArray:
    try:
        values = np.array(fields, dtype=np.float64)
    except ValueError as error:
        raise CarmenError(f"{path}:{number}: {error}; expected numbers") from error
    if not np.isfinite(values).all():
        raise CarmenError(f"{path}:{number}: a value is not finite; expected plain numbers")
    return values
