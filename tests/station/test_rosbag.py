"""ROS bags: what is read of them, and what is refused with which words."""

import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from protocol.pose import Pose2
from station.main import main
from station.rosbag import RosbagError, read_bag
from station.scan_log import ScanLogError, read_log

pytest.importorskip("rosbags", reason="the extra rosbag is not installed")

from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPES = STORE.types
BEAMS, STEP = 181, math.pi / 180.0
MOUNT = Pose2(0.2, -0.1, 0.3)


def header(stamp: float, frame: str) -> Any:
    time = TYPES["builtin_interfaces/msg/Time"](sec=int(stamp), nanosec=round(stamp % 1.0 * 1e9))
    return TYPES["std_msgs/msg/Header"](stamp=time, frame_id=frame)


def quaternion(theta: float) -> Any:
    turn = TYPES["geometry_msgs/msg/Quaternion"]
    return turn(x=0.0, y=0.0, z=math.sin(0.5 * theta), w=math.cos(0.5 * theta))


def odometry(stamp: float, pose: Pose2) -> Any:
    point = TYPES["geometry_msgs/msg/Point"](x=pose.x, y=pose.y, z=0.0)
    vector = TYPES["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
    return TYPES["nav_msgs/msg/Odometry"](
        header=header(stamp, "odom"),
        child_frame_id="base_link",
        pose=TYPES["geometry_msgs/msg/PoseWithCovariance"](
            pose=TYPES["geometry_msgs/msg/Pose"](
                position=point, orientation=quaternion(pose.theta)
            ),
            covariance=np.zeros(36),
        ),
        twist=TYPES["geometry_msgs/msg/TwistWithCovariance"](
            twist=TYPES["geometry_msgs/msg/Twist"](linear=vector, angular=vector),
            covariance=np.zeros(36),
        ),
    )


def scan(stamp: float, ranges: np.ndarray, first: float = -0.5 * math.pi) -> Any:
    return TYPES["sensor_msgs/msg/LaserScan"](
        header=header(stamp, "laser"),
        angle_min=first,
        angle_max=first + STEP * (len(ranges) - 1),
        angle_increment=STEP,
        time_increment=0.0,
        scan_time=0.1,
        range_min=0.1,
        range_max=20.0,
        ranges=ranges.astype(np.float32),
        intensities=np.zeros(0, dtype=np.float32),
    )


def mounted() -> Any:
    vector = TYPES["geometry_msgs/msg/Vector3"](x=MOUNT.x, y=MOUNT.y, z=0.4)
    transform = TYPES["geometry_msgs/msg/Transform"](
        translation=vector, rotation=quaternion(MOUNT.theta)
    )
    stamped = TYPES["geometry_msgs/msg/TransformStamped"](
        header=header(0.0, "base_link"), child_frame_id="laser", transform=transform
    )
    return TYPES["tf2_msgs/msg/TFMessage"](transforms=[stamped])


def room(pose: Pose2) -> np.ndarray:
    angles = pose.theta - 0.5 * math.pi + STEP * np.arange(BEAMS)
    c, s = np.cos(angles), np.sin(angles)
    with np.errstate(divide="ignore"):
        along = np.where(c > 0, (4.0 - pose.x) / c, (-4.0 - pose.x) / c)
        across = np.where(s > 0, (3.0 - pose.y) / s, (-3.0 - pose.y) / s)
    return np.asarray(np.minimum(along, across))


def write_bag(
    path: Path,
    plugin: StoragePlugin = StoragePlugin.MCAP,
    scan_topics: tuple[str, ...] = ("/scan",),
) -> Path:
    """Forty scans 0.1 s apart of a drive through a room, odometry half-way between them."""
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        links = {
            topic: writer.add_connection(topic, kind, typestore=STORE)
            for topic, kind in (
                ("/odom", "nav_msgs/msg/Odometry"),
                ("/tf_static", "tf2_msgs/msg/TFMessage"),
                *((topic, "sensor_msgs/msg/LaserScan") for topic in scan_topics),
            )
        }

        def write(topic: str, stamp: float, message: Any) -> None:
            kind = links[topic].msgtype
            writer.write(links[topic], round(stamp * 1e9), STORE.serialize_cdr(message, kind))

        write("/tf_static", 99.0, mounted())
        for k in range(40):
            at, later = (
                Pose2.exp(np.array([0.8 * t, 0.0, 0.2 * t])) for t in (0.1 * k, 0.1 * k + 0.05)
            )
            for topic in scan_topics:
                write(topic, 100.0 + 0.1 * k, scan(100.0 + 0.1 * k, room(at @ MOUNT)))
            write("/odom", 100.05 + 0.1 * k, odometry(100.05 + 0.1 * k, later))
    return path


@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_scans_come_with_the_odometry_at_their_stamps(
    tmp_path: Path, plugin: StoragePlugin
) -> None:
    log = read_log(write_bag(tmp_path / "bag", plugin))
    # The first scan has no odometry before it.
    assert len(log.scans) == 39
    first = log.scans[0]
    assert (first.stamp, first.logger_stamp) == pytest.approx((100.1, 100.1))
    assert first.odometry.distance_to(Pose2.exp(np.array([0.08, 0.0, 0.02]))) < 1e-3
    assert log.scanner is not None
    assert log.scanner.T_base_laser.distance_to(MOUNT) < 1e-6
    assert (log.scanner.first_rad, log.scanner.max_range_m) == pytest.approx((-0.5 * math.pi, 20.0))
    assert log.scanner.field_of_view_rad == pytest.approx(math.pi, abs=1e-5)


def test_a_file_of_a_bag_is_read_by_itself(tmp_path: Path) -> None:
    (file,) = write_bag(tmp_path / "bag").glob("*.mcap")
    assert len(read_log(file).scans) == 39


def test_earshot_slam_maps_from_a_bag(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = write_bag(tmp_path / "bag")
    assert main(["slam", str(bag), "--out", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "map.yaml").is_file()
    capsys.readouterr()
    assert main(["slam", str(bag), "--scan-topic", "/lidar", "--out", str(tmp_path / "no")]) == 2
    said = capsys.readouterr().err.strip()
    assert "/lidar is no topic of sensor_msgs/msg/LaserScan" in said
    assert said.count("\n") == 0


def test_which_topic_must_be_clear(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", scan_topics=("/front", "/rear"))
    with pytest.raises(RosbagError, match=r"2 topics of .*--scan-topic .*/front, /rear"):
        read_bag(bag)
    assert len(read_bag(bag, "/rear").scans) == 39


def test_damaged_bags_are_refused_in_a_line(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    (file,) = write_bag(tmp_path / "bag").glob("*.mcap")
    whole = file.read_bytes()
    for number in range(20):
        data = bytearray(whole)
        for at in rng.integers(0, len(data), 40):
            data[at] = rng.integers(256)
        file.write_bytes(data[: len(data) // 2] if number % 2 else data)
        try:
            read_bag(file)
        except ScanLogError as error:
            assert "\n" not in str(error)
    with pytest.raises(RosbagError, match="not a readable ROS bag"):
        read_bag(tmp_path / "missing.mcap")


def test_without_the_package_it_is_said_how_to_get_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(RosbagError, match=r"pip install .*rosbag"):
        read_bag(tmp_path / "bag.mcap")
