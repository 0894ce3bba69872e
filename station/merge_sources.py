"""What `earshot merge` takes: logs of real robots, journals of recorded runs.

Either becomes a journal's entries without what would give the answer away: start poses and links.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from protocol.config import BodyConfig
from protocol.errors import EarshotError, MalformedMessageError
from protocol.pose import IDENTITY, FloatArray
from robot.jobs import Jobs
from robot.perception.scan import perceive
from robot.recollection import read_records
from robot.slam.engine import Entry
from robot.slam.engines import make_engine
from robot.team.entries import Hello, Known, Link, decode_entry, encode_entry
from robot.team.journal import decode_record
from robot.team.log_reading import read_in_order
from station.raw_odometry import raw_motions
from station.replay import ReplaySettings, in_order, lidar_of, moved
from station.scan_log import LoggedScan, ScanLog, read_log

JOURNAL = ".journal"


class MergeError(EarshotError):
    """Something that cannot be merged; the message says what was expected."""


@dataclass(frozen=True, slots=True)
class Source:
    """One robot: its entries, and whether its ranges are simulated (with noise) or a real log's.

    `part`: the name of the whole log, and which of its scans is the first here.
    """

    name: str
    entries: tuple[Known, ...]
    simulated: bool
    part: tuple[str, int]


@dataclass(frozen=True, slots=True)
class Whole:
    """A log that was split, as one robot: the pose (n×3) of every scan."""

    poses: FloatArray


def read_sources(paths: list[Path], split: int) -> tuple[list[Source], dict[str, Whole]]:
    """The robots in logs, journal files and run folders; logs in `split` parts.

    Raises MergeError when there are fewer than two, ScanLogError when a log cannot be read.
    """
    sources: list[Source] = []
    wholes: dict[str, Whole] = {}
    for path in paths:
        if path.is_dir() or path.suffix == JOURNAL:
            sources += _recorded(path)
            continue
        log = read_log(path)
        scans = in_order(log.scans)
        name = _free_name(path.name.partition(".")[0], sources)
        if split > 1:
            wholes[name] = Whole(_drive(scans, log)[1])
        for number in range(split):
            first, end = (len(scans) * k // split for k in (number, number + 1))
            entries, _ = _drive(scans[first:end], log)
            label = f"{name}.{number + 1}" if split > 1 else name
            sources.append(Source(label, entries, False, (name, first)))
    if len(sources) < 2:
        raise MergeError(f"{len(sources)} robot in all: name two logs, or one with --split 2")
    return sources, wholes


def _drive(scans: list[LoggedScan], log: ScanLog) -> tuple[tuple[Known, ...], FloatArray]:
    """Scans of a log as the journal of its robot, and the laser's pose (n×3) at each."""
    scanner = log.scanner
    lidar = lidar_of(len(scans[0].ranges), ReplaySettings(), scanner, log.reach_m)
    wheels = np.array([scan.odometry.to_array() for scan in scans])
    odometry = moved(wheels, scanner.T_base_laser if scanner else IDENTITY)
    engine = make_engine("graph", lidar, BodyConfig(), IDENTITY, Jobs())
    found: list[Entry] = []
    for tick, motion in enumerate(raw_motions(odometry)):
        ranges = perceive(scans[tick].ranges.astype(np.float32), lidar)
        engine.step(tick, motion, ranges)
        found += engine.take_entries()
    hello = Hello(
        None, lidar.beams, lidar.angle_min_rad, lidar.increment_rad, lidar.max_range_m, 0.2
    )
    # As they come out of a journal: rounded.
    bodies = [encode_entry(entry) for entry in (hello, *found)]
    entries = tuple(decode_entry(body, number) for number, body in enumerate(bodies))
    return entries, engine.trajectory()


def _recorded(path: Path) -> Iterator[Source]:
    """The robots of a run: of every journal file the log of the robot whose file it is."""
    files = sorted(path.rglob(f"*{JOURNAL}")) if path.is_dir() else [path]
    if not files:
        raise MergeError(f"{path}: no {JOURNAL} file in it; expected the folder of a run")
    for file in files:
        robot, _, life = file.name.removesuffix(JOURNAL).rpartition(".")
        try:
            named = [decode_record(record) for record in read_records(file)]
            entries = [
                entry
                for _, entry in read_in_order(
                    (name, body)
                    for name, body in named
                    if (name.log.robot, str(name.log.incarnation)) == (robot, life)
                )
            ]
        except MalformedMessageError as error:
            raise MergeError(f"{file}: {error}") from error
        label = f"{robot}.{life}"
        yield Source(label, tuple(_without_answers(entries)), True, (label, 0))


def _without_answers(entries: list[Known]) -> Iterator[Known]:
    for entry in entries:
        if isinstance(entry, Hello):
            yield Hello(
                None,
                entry.beams,
                entry.angle_min,
                entry.increment,
                entry.max_range_m,
                entry.radius_m,
            )
        elif not isinstance(entry, Link):
            yield entry


def _free_name(wanted: str, sources: list[Source]) -> str:
    """A name of up to 24 characters that no source has."""
    taken = {source.name.partition(".")[0] for source in sources}
    name, number = wanted[:24], 2
    while name in taken:
        name, number = f"{wanted[:20]}-{number}", number + 1
    return name
