"""What `earshot slam` plays: scans with the odometry at each, whatever file they come from."""

import math
from dataclasses import dataclass
from pathlib import Path

from protocol.errors import EarshotError
from protocol.pose import IDENTITY, FloatArray, Pose2

# No wheels have come so far: numbers beyond are damage, and would overflow.
MAX_POSE_M = 1e8
BAG_SUFFIXES = (".mcap", ".db3", ".bag")


class ScanLogError(EarshotError):
    """A log that cannot be read; the message names file and place and says what was expected."""


@dataclass(frozen=True, slots=True)
class LoggedScan:
    """One scan: ranges (n, m) as logged, `T_odom_base` of the wheels, and the two clocks (s).

    `pose` is whatever the logging machine believed (raw logs repeat the odometry there). Of ranges,
    +inf and NaN mean what they do in `LaserScan`.
    """

    stamp: float
    logger_stamp: float
    odometry: Pose2
    pose: Pose2
    ranges: FloatArray


@dataclass(frozen=True, slots=True)
class Scanner:
    """What a log says of its range finder: where its beams point, from the first on (rad), how far
    it measures (m), and how it is mounted."""

    first_rad: float
    field_of_view_rad: float
    max_range_m: float
    T_base_laser: Pose2 = IDENTITY


@dataclass(frozen=True, slots=True)
class ScanLog:
    """All scans of one range finder, in the order of the file. Without a `scanner` the log does not
    say more of it than its number of beams; up to where it measures, `reach_m`, may show then."""

    scans: list[LoggedScan]
    scanner: Scanner | None = None
    reach_m: float = math.inf


@dataclass(frozen=True, slots=True)
class Channels:
    """What to read of a log that holds more: by default what there is only one of, or the first.

    `laser` is a CARMEN keyword (FLASER, ROBOTLASER1, …); the topics are those of a ROS bag.
    """

    laser: str | None = None
    scan_topic: str | None = None
    odometry_topic: str | None = None


def read_log(path: Path, channels: Channels | None = None) -> ScanLog:
    """The scans of a CARMEN log, or of a ROS bag (a folder, or a file that is named like one).

    Raises ScanLogError.
    """
    from station.carmen import read_carmen_log
    from station.rosbag import read_bag

    channels = channels or Channels()
    if path.is_dir() or path.suffix in BAG_SUFFIXES:
        return read_bag(path, channels.scan_topic, channels.odometry_topic)
    return read_carmen_log(path, channels.laser)


def check_scans(path: Path, scans: list[LoggedScan], expected: str) -> None:
    """Raise ScanLogError when there are none, their sizes differ, or they are nowhere on earth."""
    if not scans:
        raise ScanLogError(f"{path}: {expected}")
    sizes = sorted({len(scan.ranges) for scan in scans})
    if len(sizes) > 1:
        raise ScanLogError(f"{path}: scans of different sizes ({sizes}); expected one laser")
    for scan in scans:
        pose = scan.odometry
        if max(abs(pose.x), abs(pose.y), abs(pose.theta)) > MAX_POSE_M:
            raise ScanLogError(
                f"{path}: the odometry at {scan.stamp:.3f} s is ({pose.x:g}, {pose.y:g}, "
                f"{pose.theta:g}); expected metres and radians"
            )


def check_scanner(path: Path, scanner: Scanner) -> Scanner:
    """Raise ScanLogError for angles or a range that no range finder has."""
    angles = (scanner.first_rad, scanner.field_of_view_rad)
    if (
        not all(math.isfinite(value) for value in (*angles, scanner.max_range_m))
        or abs(scanner.first_rad) > math.tau
        or not 0.0 < scanner.field_of_view_rad <= math.tau + 1e-6
        or not 0.0 < scanner.max_range_m <= 1000.0
    ):
        raise ScanLogError(
            f"{path}: a range finder from {scanner.first_rad:g} rad over "
            f"{scanner.field_of_view_rad:g} rad and {scanner.max_range_m:g} m; expected at most a "
            "full turn and 1000 m"
        )
    return scanner
