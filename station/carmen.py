"""Reader of CARMEN logs: laser scans and wheel odometry, plain or gzipped.

Three kinds of lines are read, everything else in a log is skipped, as are scans of no beams and a
last line that was cut while it was written:

    FLASER n r1 … rn x y θ odom_x odom_y odom_θ ipc_time host logger_time
    ROBOTLASERk type first fov resolution max_range accuracy remission_mode n r1 … rn m e1 … em
        laser_x laser_y laser_θ x y θ tv rv forward side turn_axis ipc_time host logger_time
    ODOM x y θ v ω a ipc_time host logger_time

The poses of a ROBOTLASER line are the odometry's, of the laser and of the robot: so it says where
on the robot the laser is. A log with several lasers is read for one of them. Ranges may be NaN or
infinite, all other numbers must be finite.
"""

import gzip
import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import numpy as np

from protocol.pose import FloatArray, Pose2
from station.no_return import without_codes
from station.scan_log import (
    LoggedScan,
    ScanLog,
    ScanLogError,
    Scanner,
    check_scanner,
    check_scans,
)

FLASER, ROBOTLASER, ODOM = "FLASER", "ROBOTLASER", "ODOM"
FLASER_TAIL = 9
GZIP = b"\x1f\x8b"
ODOM_FIELDS = 10
# Before the number of ranges, and after the remissions.
ROBOTLASER_HEAD, ROBOTLASER_TAIL = 7, 14
# Mounts that differ by this over a log are one that is rounded.
SAME_MOUNT_M, SAME_MOUNT_RAD = 0.02, math.radians(1.0)


class CarmenError(ScanLogError):
    """A log that cannot be read; the message names file and line and says what was expected."""


@dataclass(frozen=True, slots=True)
class CarmenOdometry:
    """The wheel odometry's own idea of where the robot is, `T_odom_base`, at `stamp` (s)."""

    stamp: float
    odometry: Pose2


@dataclass(frozen=True, slots=True)
class CarmenScan:
    """A scan, the keyword of its line, and what the line says of the scanner."""

    laser: str
    scan: LoggedScan
    scanner: Scanner | None = None


def read_carmen(path: Path, odometry: bool = True) -> Iterator[CarmenScan | CarmenOdometry]:
    """The scans and odometry readings of a log, in the order of the file, one at a time; without
    `odometry` its lines are not looked at.

    Raises CarmenError when the file is missing, no text, or has a line that is cut or no number.
    """
    try:
        with _open(path) as lines:
            for number, line in enumerate(lines, start=1):
                if "\0" in line:
                    raise CarmenError(
                        f"{path}: not a readable CARMEN log (line {number} is no text)"
                    )
                record = _record(line, path, number, odometry)
                if record is not None:
                    yield record
    except (OSError, EOFError, zlib.error) as error:
        raise CarmenError(f"{path}: not a readable CARMEN log ({error})") from error


def _record(
    line: str, path: Path, number: int, odometry: bool
) -> CarmenScan | CarmenOdometry | None:
    """What a line says, None if nothing that is read."""
    keyword = next(iter(line[:64].split(None, 1)), "")
    try:
        if keyword == FLASER:
            return _scan(line.split(), path, number)
        if keyword.startswith(ROBOTLASER) and keyword[len(ROBOTLASER) :].isdecimal():
            return _robot_laser(keyword, line.split(), path, number)
        if keyword == ODOM and odometry:
            return _odometry(line.split(), path, number)
    except CarmenError:
        # Only the last line has no end: the logger was stopped, or ran out of disk, in the midst.
        if line.endswith("\n"):
            raise
    return None


def read_carmen_log(path: Path, laser: str | None = None) -> ScanLog:
    """All scans of one laser of a log: the one asked for, or FLASER, or the ROBOTLASER of the least
    number.

    Raises CarmenError also when there are none, ScanLogError when their sizes differ.
    """
    found: dict[str, list[CarmenScan]] = {}
    for record in read_carmen(path, odometry=False):
        if isinstance(record, CarmenScan):
            found.setdefault(record.laser, []).append(record)
    if laser is not None and laser not in found:
        there = ", ".join(sorted(found)) or "none"
        raise CarmenError(f"{path}: no {laser} line; the lasers of this log: {there}")
    # By length and then by letters: numbers of any size in their order.
    chosen = laser or min(found, key=lambda name: (name != FLASER, len(name), name), default=FLASER)
    records = found.get(chosen, [])
    scans = [record.scan for record in records]
    check_scans(
        path, scans, f"no {FLASER} or {ROBOTLASER} line; expected a CARMEN log with laser scans"
    )
    scanner = _one_scanner(path, records)
    return ScanLog(scans, scanner) if scanner else without_codes(scans)


def _one_scanner(path: Path, records: list[CarmenScan]) -> Scanner | None:
    first = records[0].scanner
    if first is None:
        return None
    for record in records:
        scanner = record.scanner
        assert scanner is not None  # as all lines of one keyword
        shift = first.T_base_laser.inverse() @ scanner.T_base_laser
        moved = math.hypot(shift.x, shift.y) > SAME_MOUNT_M or abs(shift.theta) > SAME_MOUNT_RAD
        if moved or (first.first_rad, first.field_of_view_rad, first.max_range_m) != (
            scanner.first_rad,
            scanner.field_of_view_rad,
            scanner.max_range_m,
        ):
            raise CarmenError(f"{path}: {record.laser} lines of different lasers; expected one")
    return check_scanner(path, first)


def _open(path: Path) -> TextIO:
    # Names in comments may be in any encoding.
    with path.open("rb") as file:
        zipped = file.read(len(GZIP)) == GZIP
    return gzip.open(path, "rt", encoding="latin-1") if zipped else path.open(encoding="latin-1")


def _scan(fields: list[str], path: Path, number: int) -> CarmenScan | None:
    beams = _count(fields, 1)
    if beams == 0:
        return None
    if beams < 0 or len(fields) != 2 + beams + FLASER_TAIL:
        raise CarmenError(
            f"{path}:{number}: expected FLASER, a number n, n ranges and {FLASER_TAIL} more; "
            f"got {len(fields)} fields for n = {beams}"
        )
    tail = fields[2 + beams :]
    ranges = _numbers(fields[2 : 2 + beams], path, number, finite=False)
    rest = _numbers([*tail[:7], tail[8]], path, number)
    return CarmenScan(
        FLASER,
        LoggedScan(
            stamp=float(rest[6]),
            logger_stamp=float(rest[7]),
            odometry=Pose2.from_array(rest[3:6]),
            pose=Pose2.from_array(rest[:3]),
            ranges=ranges,
        ),
    )


def _robot_laser(keyword: str, fields: list[str], path: Path, number: int) -> CarmenScan | None:
    beams = _count(fields, 1 + ROBOTLASER_HEAD)
    if beams == 0:
        return None
    after = 2 + ROBOTLASER_HEAD + beams
    remissions = _count(fields, after)
    if beams < 0 or remissions < 0 or len(fields) != after + 1 + remissions + ROBOTLASER_TAIL:
        raise CarmenError(
            f"{path}:{number}: expected {keyword}, {ROBOTLASER_HEAD} numbers, n, n ranges, m, m "
            f"remissions and {ROBOTLASER_TAIL} more; got {len(fields)} fields for n = {beams} and "
            f"m = {remissions}"
        )
    tail = fields[after + 1 + remissions :]
    head = _numbers(fields[1 : 1 + ROBOTLASER_HEAD], path, number)
    ranges = _numbers(fields[2 + ROBOTLASER_HEAD : after], path, number, finite=False)
    rest = _numbers([*tail[:12], tail[13]], path, number)
    T_odom_laser, T_odom_base = Pose2.from_array(rest[:3]), Pose2.from_array(rest[3:6])
    max_range = float(head[4])
    scan = LoggedScan(
        stamp=float(rest[11]),
        logger_stamp=float(rest[12]),
        odometry=T_odom_base,
        pose=T_odom_base,
        ranges=np.where(ranges >= max_range, np.inf, ranges),
    )
    mount = T_odom_base.inverse() @ T_odom_laser
    return CarmenScan(keyword, scan, Scanner(float(head[1]), float(head[2]), max_range, mount))


def _odometry(fields: list[str], path: Path, number: int) -> CarmenOdometry:
    if len(fields) != ODOM_FIELDS:
        raise CarmenError(
            f"{path}:{number}: expected ODOM and {ODOM_FIELDS - 1} fields, got {len(fields) - 1}"
        )
    values = _numbers(fields[1:8], path, number)
    return CarmenOdometry(stamp=float(values[6]), odometry=Pose2.from_array(values[:3]))


def _count(fields: list[str], at: int) -> int:
    """The number in a field; −1 where there is none."""
    return int(fields[at]) if at < len(fields) and fields[at].isdecimal() else -1


def _numbers(fields: list[str], path: Path, number: int, finite: bool = True) -> FloatArray:
    try:
        values = np.array(fields, dtype=np.float64)
    except ValueError as error:
        raise CarmenError(f"{path}:{number}: {error}; expected numbers") from error
    if finite and not np.isfinite(values).all():
        raise CarmenError(f"{path}:{number}: a value is not finite; expected plain numbers")
    return values
