"""Reader of ROS bags: sensor_msgs/LaserScan with nav_msgs/Odometry, from rosbag2 or MCAP.

It needs the package `rosbags` (no ROS): the extra `rosbag` of this project. The odometry at a scan
is that between the readings around its stamp; a scan outside of them is left out. How the laser is
mounted comes from /tf_static where the bag has it, else it is taken to be at the robot's centre.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from protocol.pose import IDENTITY, FloatArray, Pose2, wrap_angle
from station.along_odometry import blend
from station.scan_log import (
    LoggedScan,
    ScanLog,
    ScanLogError,
    Scanner,
    check_scanner,
    check_scans,
)

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

SCAN, ODOMETRY, TRANSFORMS = (
    "sensor_msgs/msg/LaserScan",
    "nav_msgs/msg/Odometry",
    "tf2_msgs/msg/TFMessage",
)
STATIC_TOPIC = "/tf_static"
MAX_BEAMS = 4096
# A rotation that is farther from one about z is another mount than the plane has.
UPRIGHT = 1e-2


class RosbagError(ScanLogError):
    """A bag that cannot be read; the message says what was expected."""


@dataclass(frozen=True, slots=True)
class _Bag:
    """What is read: messages in the order of their stamps, with the recorder's clock (s)."""

    scans: list[tuple[float, Any]]
    odometry: list[Any]
    mounts: dict[str, tuple[str, Any]]
    """By child frame: its parent and the transform."""


def read_bag(
    path: Path, scan_topic: str | None = None, odometry_topic: str | None = None
) -> ScanLog:
    """The scans of a bag: a rosbag2 folder, or an .mcap, .db3 or ROS 1 .bag file.

    Raises RosbagError when the package is missing, the bag is damaged, or which topics are meant is
    not clear; ScanLogError when scans do not fit together.
    """
    try:
        from rosbags.highlevel import AnyReader
    except ImportError:
        raise RosbagError(
            f"{path}: reading a ROS bag needs the package rosbags: "
            'pip install "earshot-slam[rosbag]" (or pip install rosbags)'
        ) from None
    try:
        with AnyReader([path], default_typestore=_typestore()) as reader:
            bag = _read(path, reader, scan_topic, odometry_topic)
    except ScanLogError:
        raise
    except Exception as error:  # a damaged bag shows as many types: of sqlite, struct, the decoder
        reason = " ".join(str(error).split()) or type(error).__name__
        raise RosbagError(f"{path}: not a readable ROS bag ({reason[:200]})") from error
    return _log(path, bag)


def _typestore() -> Any:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE)


def _read(
    path: Path, reader: "AnyReader", scan_topic: str | None, odometry_topic: str | None
) -> _Bag:
    topics = {connection.topic: connection.msgtype for connection in reader.connections}
    scan_topic = _one_topic(path, topics, SCAN, scan_topic, "--scan-topic")
    odometry_topic = _one_topic(path, topics, ODOMETRY, odometry_topic, "--odom-topic")
    wanted = {scan_topic, odometry_topic}
    if topics.get(STATIC_TOPIC) == TRANSFORMS:
        wanted.add(STATIC_TOPIC)
    bag = _Bag([], [], {})
    connections = [c for c in reader.connections if c.topic in wanted]
    for connection, logged_ns, data in reader.messages(connections=connections):
        message: Any = reader.deserialize(data, connection.msgtype)
        if connection.topic == scan_topic:
            bag.scans.append((1e-9 * logged_ns, message))
        elif connection.topic == odometry_topic:
            bag.odometry.append(message)
        else:
            for stamped in message.transforms:
                bag.mounts[stamped.child_frame_id] = stamped.header.frame_id, stamped.transform
    bag.scans.sort(key=lambda logged: _stamp(logged[1]))
    bag.odometry.sort(key=_stamp)
    return bag


def _one_topic(
    path: Path, topics: dict[str, str], kind: str, asked: str | None, option: str
) -> str:
    found = sorted(topic for topic, msgtype in topics.items() if msgtype == kind)
    if asked is None and len(found) == 1:
        return found[0]
    if asked in found:
        return str(asked)
    there = ", ".join(found) or "none"
    wrong = f"{asked} is no topic of {kind}" if asked else f"{len(found)} topics of {kind}"
    raise RosbagError(f"{path}: {wrong}; name one by {option} (there are: {there})")


def _log(path: Path, bag: _Bag) -> ScanLog:
    if not bag.scans or len(bag.odometry) < 2:
        raise RosbagError(
            f"{path}: {len(bag.scans)} messages of {SCAN} and {len(bag.odometry)} of {ODOMETRY}; "
            "expected many"
        )
    first = bag.scans[0][1]
    scanner, beams = _scanner(path, first, _mount(path, bag, first))
    stamps = np.array([_stamp(message) for message in bag.odometry])
    poses = np.array([_planar(path, message.pose.pose) for message in bag.odometry])
    scans = list(_between(bag.scans, stamps, poses, first.angle_increment, beams))
    check_scans(path, scans, "no scan has odometry before and after it")
    return ScanLog(scans, scanner)


def _scanner(path: Path, scan: Any, mount: Pose2) -> tuple[Scanner, int]:
    """The scanner by one of its messages, and how many of its beams lie within a turn."""
    count, step = len(scan.ranges), abs(float(scan.angle_increment))
    if not 3 <= count <= MAX_BEAMS or not 0.0 < step < math.pi:
        raise RosbagError(f"{path}: scans of {count} beams {step:g} rad apart; expected 3 to 4096")
    beams = min(count, math.floor(math.tau / step + 0.25))
    # Beams all around have a gap more than others.
    around = abs(beams * step - math.tau) < 0.5 * step
    field = math.tau if around else (beams - 1) * step
    last = float(scan.angle_min) + (count - 1) * float(scan.angle_increment)
    first_rad = min(float(scan.angle_min), last)
    return check_scanner(path, Scanner(first_rad, field, float(scan.range_max), mount)), beams


def _between(
    logged: list[tuple[float, Any]],
    stamps: FloatArray,
    poses: FloatArray,
    increment: float,
    beams: int,
) -> Iterator[LoggedScan]:
    """The scans that have odometry (poses n×3 at stamps n) before and after them."""
    times = np.array([_stamp(scan) for _, scan in logged])
    after = np.clip(np.searchsorted(stamps, times, side="left"), 1, len(stamps) - 1)
    span = np.maximum(stamps[after] - stamps[after - 1], 1e-9)
    share = (times - stamps[after - 1]) / span
    at = blend(poses[after - 1], poses[after], np.clip(share, 0.0, 1.0))
    for k, (logged_s, scan) in enumerate(logged):
        if not 0.0 <= share[k] <= 1.0:
            continue
        ranges = np.array(scan.ranges, dtype=np.float64)
        ranges[ranges < float(scan.range_min)] = np.nan
        ranges[ranges >= float(scan.range_max)] = np.inf
        ranges = (ranges if increment > 0.0 else ranges[::-1])[:beams].copy()
        odometry = Pose2.from_array(at[k])
        yield LoggedScan(float(times[k]), logged_s, odometry, odometry, ranges)


def _mount(path: Path, bag: _Bag, scan: Any) -> Pose2:
    """`T_base_laser` by the static transforms; the identity where they do not tie the two."""
    base = bag.odometry[0].child_frame_id
    frame, mount = scan.header.frame_id, IDENTITY
    for _ in range(len(bag.mounts)):
        if frame == base or frame not in bag.mounts:
            break
        frame, transform = bag.mounts[frame]
        mount = _pose(path, transform.translation, transform.rotation) @ mount
    return mount if frame == base else IDENTITY


def _planar(path: Path, pose: Any) -> FloatArray:
    return _pose(path, pose.position, pose.orientation).to_array()


def _pose(path: Path, position: Any, rotation: Any) -> Pose2:
    x, y, qx, qy, qz, qw = (
        float(value)
        for value in (position.x, position.y, rotation.x, rotation.y, rotation.z, rotation.w)
    )
    length = math.sqrt(qx * qx + qy * qy + qz * qz + qw * qw)
    if not (math.isfinite(x) and math.isfinite(y)) or not 0.5 < length < 2.0:
        raise RosbagError(f"{path}: a pose that is none: ({x}, {y}), ({qx}, {qy}, {qz}, {qw})")
    if math.hypot(qx, qy) > UPRIGHT * length:
        raise RosbagError(f"{path}: a pose that is tilted; expected rotations about z alone")
    return Pose2(x, y, wrap_angle(2.0 * math.atan2(qz, qw)))


def _stamp(message: Any) -> float:
    """Seconds of a message's header."""
    stamp = message.header.stamp
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)
