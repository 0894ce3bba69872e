"""CARMEN logs: what is read, and what is refused with which words."""

import gzip
from pathlib import Path

import numpy as np
import pytest

from protocol.pose import Pose2
from station.carmen import (
    CarmenError,
    CarmenOdometry,
    CarmenScan,
    read_carmen,
    read_carmen_log,
)
from station.scan_log import ScanLogError, Scanner

SCAN = "FLASER 3 1.5 2.5 81.91 1 2 0.5 1.1 2.1 0.6 100.25 host 0.75\n"
LASER = (
    "ROBOTLASER1 0 -1.57 3.14 1.57 30.0 0.01 0 3 1.5 30.0 2.5 0 1.5 2.5 0.5 1.2 2 0.5 "
    "0 0 0.3 0.3 1e6 100.25 host 0.75\n"
)
ODOM = "ODOM 1.0 2.0 0.5 0.3 0.1 0.0 100.5 host 1.0\n"


def write(tmp_path: Path, text: str, name: str = "log.clf") -> Path:
    path = tmp_path / name
    path.write_text(text)
    return path


def scan_line(ranges: np.ndarray) -> str:
    said = " ".join(f"{value:g}" for value in ranges)
    return f"FLASER {len(ranges)} {said} 1 2 0.5 1.1 2.1 0.6 100.25 host 0.75\n"


def test_scans_and_odometry_come_in_the_order_of_the_file(tmp_path: Path) -> None:
    path = write(tmp_path, "# comment\nPARAM a b\n" + ODOM + SCAN + ODOM)
    records = list(read_carmen(path))
    assert [type(r) for r in records] == [CarmenOdometry, CarmenScan, CarmenOdometry]
    assert isinstance(records[1], CarmenScan)
    scan = records[1].scan
    assert np.array_equal(scan.ranges, [1.5, 2.5, 81.91])
    assert scan.pose == Pose2(1.0, 2.0, 0.5)
    assert scan.odometry == Pose2(1.1, 2.1, 0.6)
    assert (scan.stamp, scan.logger_stamp) == (100.25, 0.75)
    assert records[0] == CarmenOdometry(100.5, Pose2(1.0, 2.0, 0.5))


def test_an_odd_reading_of_the_odometry_matters_where_it_is_asked_for(tmp_path: Path) -> None:
    path = write(tmp_path, SCAN + "ODOM 1 2 3\n")
    assert len(read_carmen_log(path).scans) == 1
    with pytest.raises(CarmenError, match=r"log.clf:2: expected ODOM and 9 fields, got 3"):
        list(read_carmen(path))


def test_what_logs_are_in_practice_is_read(tmp_path: Path) -> None:
    path = tmp_path / "log.clf"
    odd = [
        "# by D. Hähnel\r\n".encode("latin-1"),
        "# by D. Hähnel\n".encode(),
        b"\r\n",
        SCAN.replace("\n", "\r\n").encode(),
        SCAN.replace(" ", "\t").encode(),
        SCAN.replace("2.5", "nan").replace("1.5", "inf").encode(),
        SCAN.replace("3 1.5 2.5 81.91", "0").encode(),
        LASER.replace("3 1.5 30.0 2.5", "0").encode(),
        SCAN[:30].encode(),
    ]
    path.write_bytes(b"".join(odd))
    scans = read_carmen_log(path).scans
    assert len(scans) == 3
    assert np.array_equal(scans[2].ranges, [np.inf, np.nan, 81.91], equal_nan=True)
    nan = LASER.replace("3 1.5 30.0", "3 nan 30.0")
    assert np.array_equal(
        read_carmen_log(write(tmp_path, nan)).scans[0].ranges, [np.nan, np.inf, 2.5], equal_nan=True
    )


@pytest.mark.parametrize("codes", [(8.19,), (8.183, 8.187, 8.191, 8.191, 8.191), (81.91,)])
def test_what_is_logged_where_nothing_was_met_is_found(
    tmp_path: Path, codes: tuple[float, ...]
) -> None:
    rng = np.random.default_rng(0)
    ranges = np.round(8.0 * rng.random((100, 50)) ** 0.7, 2)
    nothing = rng.random(ranges.shape) < 0.03
    ranges[nothing] = rng.choice(codes, nothing.sum())
    path = write(tmp_path, "".join(scan_line(row) for row in ranges))
    log = read_carmen_log(path)
    assert 0.98 * min(codes) < log.reach_m < min(codes)
    seen = np.array([scan.ranges for scan in log.scans])
    assert np.array_equal(np.isinf(seen), ranges > log.reach_m)
    assert (np.isinf(seen) & ~nothing).sum() < 80


def test_a_log_that_shows_nothing_is_read(tmp_path: Path) -> None:
    for ranges in ([0.0, 0.0, 0.0], [-1.0, 0.0, np.nan], [81.91, 81.91, 81.91]):
        assert len(read_carmen_log(write(tmp_path, scan_line(np.array(ranges)) * 30)).scans) == 30


def test_the_farthest_of_true_distances_stay(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    spread = np.round(27.0 * rng.random((100, 50)), 2)
    log = read_carmen_log(write(tmp_path, "".join(scan_line(row) for row in spread)))
    assert log.reach_m == np.inf
    assert np.array_equal([scan.ranges for scan in log.scans], spread)


def test_gzipped_logs_are_read_alike(tmp_path: Path) -> None:
    path = tmp_path / "log.clf.gz"
    with gzip.open(path, "wt") as file:
        file.write(SCAN * 2)
    assert len(read_carmen_log(path).scans) == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("FLASER\n", "log.clf:1: expected FLASER"),
        ("FLASER x 1 2\n", "log.clf:1: expected FLASER"),
        (ODOM + SCAN[:30] + "\n", "log.clf:2: expected FLASER"),
        (SCAN.replace("2.5", "two"), "log.clf:1: .*expected numbers"),
        (SCAN.replace("0.5", "nan"), "log.clf:1: a value is not finite"),
        (SCAN.replace("FLASER 3", "FLASER 0"), "no FLASER or ROBOTLASER line"),
        (SCAN.replace("1.1 2.1", "1e200 2.1"), "expected metres and radians"),
        ("hello\n", "no FLASER or ROBOTLASER line"),
        (LASER[:-20] + "\n", "log.clf:1: expected ROBOTLASER1, 7 numbers"),
        (LASER.replace(" 0 1.5 2.5 0.5", " 1 1.5 2.5 0.5"), "log.clf:1: expected ROBOTLASER1"),
        (LASER.replace("-1.57 3.14", "-1.57 7.14"), "at most a full turn"),
        (LASER + LASER.replace("-1.57", "-1.50"), "different lasers"),
        (LASER + LASER.replace("0.5 1.2 2 0.5", "0.5 1.9 2 0.5"), "different lasers"),
        (SCAN + "FLASER 1 1.5 1 2 0.5 1.1 2.1 0.6 100.25 host 0.75\n", "different sizes"),
    ],
)
def test_bad_logs_are_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ScanLogError, match=message):
        read_carmen_log(write(tmp_path, text))


def test_what_is_no_log_at_all_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CarmenError, match="not a readable CARMEN log"):
        read_carmen_log(tmp_path / "missing.clf")
    (tmp_path / "binary.clf").write_bytes(bytes(range(256)))
    with pytest.raises(CarmenError, match="not a readable CARMEN log"):
        read_carmen_log(tmp_path / "binary.clf")
    (tmp_path / "log.clf.gz").write_bytes(gzip.compress(SCAN.encode() * 100)[:-20])
    with pytest.raises(CarmenError, match="not a readable CARMEN log"):
        read_carmen_log(tmp_path / "log.clf.gz")


def test_a_robot_laser_says_what_it_is_and_where_it_is_mounted(tmp_path: Path) -> None:
    log = read_carmen_log(write(tmp_path, LASER * 2 + LASER.replace("LASER1", "LASER2")))
    assert len(log.scans) == 2
    scan = log.scans[0]
    assert (scan.stamp, scan.logger_stamp) == (100.25, 0.75)
    assert scan.odometry == Pose2(1.2, 2.0, 0.5)
    assert np.array_equal(scan.ranges, [1.5, np.inf, 2.5])
    mount = Pose2(1.2, 2.0, 0.5).inverse() @ Pose2(1.5, 2.5, 0.5)
    assert log.scanner == Scanner(-1.57, 3.14, 30.0, mount)


def test_one_of_several_lasers_is_read(tmp_path: Path) -> None:
    path = write(tmp_path, LASER.replace("LASER1", "LASER2") + LASER * 2 + SCAN * 3)
    assert len(read_carmen_log(path).scans) == 3
    assert len(read_carmen_log(path, "ROBOTLASER2").scans) == 1
    with pytest.raises(CarmenError, match=r"no ROBOTLASER3 line; .* FLASER, ROBOTLASER1, ROBOTL"):
        read_carmen_log(path, "ROBOTLASER3")
