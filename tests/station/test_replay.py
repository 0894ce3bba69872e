"""`earshot slam` and `earshot optimise`: what they measure, write and refuse."""

import dataclasses
import gzip
import json
import math
from pathlib import Path

import numpy as np
import pytest

from protocol.pose import IDENTITY, FloatArray, Pose2, compose, invert
from robot.slam.saved_map import SavedMap
from station.along_odometry import follow_odometry
from station.formats import FormatError, Trajectory, read_g2o, read_tum
from station.main import main
from station.relations import (
    ReferenceErrors,
    Relations,
    read_relations,
    reference_errors,
    relation_errors,
)
from station.replay import Replay, ReplayError, ReplaySettings, in_order, lidar_of, play
from station.scan_log import LoggedScan, ScanLog, Scanner

BEAMS = 181


def room_scan(pose: Pose2) -> FloatArray:
    """Ranges in an empty room of 8 × 6 m around the origin."""
    angles = pose.theta + np.linspace(-0.5 * np.pi, 0.5 * np.pi, BEAMS)
    c, s = np.cos(angles), np.sin(angles)
    with np.errstate(divide="ignore"):
        along = np.where(c > 0, (4.0 - pose.x) / c, (-4.0 - pose.x) / c)
        across = np.where(s > 0, (3.0 - pose.y) / s, (-3.0 - pose.y) / s)
    return np.asarray(np.minimum(along, across), dtype=np.float64)


def drive(count: int = 40) -> tuple[list[LoggedScan], FloatArray]:
    """An arc through the room, with odometry that is 5 % too long."""
    true, odometry = Pose2(-2.0, -1.0, 0.2), IDENTITY
    step = Pose2.exp(np.array([0.08, 0.0, 0.02]))
    wrong = Pose2(1.05 * step.x, 1.05 * step.y, step.theta)
    scans, poses = [], []
    for k in range(count):
        scans.append(LoggedScan(0.2 * k, 50.0 + 0.2 * k, odometry, odometry, room_scan(true)))
        poses.append(true.to_array())
        true, odometry = true @ step, odometry @ wrong
    return scans, np.array(poses)


@pytest.fixture(scope="module")
def driven() -> tuple[Replay, FloatArray]:
    scans, truth = drive()
    return play(ScanLog(scans), ReplaySettings()), truth


def test_a_laser_that_is_not_at_the_robots_centre_maps_for_the_robot() -> None:
    scans, truth = drive()
    mount = Pose2(0.3, 0.1, 0.5)
    seen = [
        LoggedScan(
            s.stamp, s.logger_stamp, s.odometry, s.pose, room_scan(Pose2.from_array(t) @ mount)
        )
        for s, t in zip(scans, truth, strict=True)
    ]
    scanner = Scanner(-0.5 * math.pi, math.pi, 20.0, mount)
    replay = play(ScanLog(seen, scanner), ReplaySettings())
    assert replay.lidar.max_range_m == 20.0
    errors = reference_errors(replay, Trajectory(replay.stamps, truth))
    assert errors.ate_rmse_m < 0.02


def test_slam_is_better_than_its_odometry(driven: tuple[Replay, FloatArray]) -> None:
    replay, truth = driven
    errors = reference_errors(replay, Trajectory(replay.stamps, truth))
    assert errors.used == 40
    assert errors.ate_rmse_m < 0.02
    assert errors.rpe_m is not None
    assert errors.rpe_m < 0.02
    by_wheels = play(ScanLog(drive()[0]), ReplaySettings(engine="dead-reckoning"))
    worse = reference_errors(by_wheels, Trajectory(replay.stamps, truth))
    assert worse.ate_rmse_m > 2.0 * errors.ate_rmse_m


def test_relations_are_found_on_the_loggers_clock(driven: tuple[Replay, FloatArray]) -> None:
    replay, truth = driven
    motion = compose(invert(truth[5]), truth[30])[None]
    on_scans = Relations(np.array([[51.0, 56.0], [51.1, 56.0]]), np.vstack([motion, motion]))
    errors = relation_errors(replay, on_scans, interpolate=False)
    assert (errors.used, errors.given) == (1, 2)
    assert errors.translation_mean_m < 0.03
    assert relation_errors(replay, on_scans, interpolate=True).used == 2
    elsewhere = Relations(on_scans.stamps + 1e6, on_scans.motions)
    with pytest.raises(ReplayError, match="none of 2 relations"):
        relation_errors(replay, elsewhere, interpolate=True)
    with pytest.raises(ReplayError, match="0 of 40 poses of the reference"):
        reference_errors(replay, Trajectory(replay.stamps + 1e6, truth))


@pytest.mark.parametrize(
    "changes",
    [
        {"reverse": True},
        {"every": 3},
        {"odometry_scale": 1.1, "turn_error": 0.05},
        {"range_noise_m": 0.01, "seed": 4},
    ],
)
def test_however_a_log_is_played_poses_are_in_its_order(changes: dict[str, float]) -> None:
    scans, truth = drive()
    replay = play(ScanLog(scans), ReplaySettings.model_validate(changes))
    assert replay.poses.shape == (40, 3)
    errors = reference_errors(replay, Trajectory(replay.stamps, truth))
    assert errors.ate_rmse_m < 0.06
    assert len(replay.played) == math.ceil(40 / changes.get("every", 1))


def test_replays_are_the_same_to_the_last_bit() -> None:
    settings = ReplaySettings(range_noise_m=0.02, seed=7)
    first, second = (play(ScanLog(drive()[0]), settings) for _ in range(2))
    np.testing.assert_array_equal(first.poses, second.poses)
    other = play(ScanLog(drive()[0]), settings.model_copy(update={"seed": 8}))
    assert not np.array_equal(first.poses, other.poses)


def test_poses_between_known_ones_follow_the_odometry() -> None:
    """The odometry turns a corner between two poses that it gets right but for its length."""
    odometry = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]])
    stamps = np.array([0.0, 1.0, 2.0])
    known = np.array([[0.0, 0.0, 0.0], [1.2, 1.0, 0.0]])
    out = follow_odometry(stamps[[0, 2]], odometry[[0, 2]], known, stamps, odometry)
    corner = [[0.0, 0.0, 0.0], [1.1, 0.0, 0.0], [1.2, 1.0, 0.0]]
    np.testing.assert_allclose(out, corner, atol=1e-12)
    straight = follow_odometry(stamps[[0, 2]], odometry[[0, 2]], known, np.array([1.0]))
    np.testing.assert_allclose(straight, [[0.6, 0.5, 0.0]], atol=1e-12)


def test_what_cannot_be_played_is_refused() -> None:
    scans, _ = drive(2)
    with pytest.raises(ReplayError, match="a log needs two"):
        play(ScanLog([scans[0], scans[0]]), ReplaySettings())
    with pytest.raises(ReplayError, match="expected 3 to 4096"):
        lidar_of(2, ReplaySettings())


def test_a_stamp_that_is_far_off_costs_its_scan_alone() -> None:
    scans, _ = drive()
    odd = [dataclasses.replace(scans[5], stamp=1e9), dataclasses.replace(scans[30], stamp=-1.0)]
    mixed = [*scans[:5], odd[0], *scans[6:30], odd[1], *scans[31:], scans[-1]]
    assert in_order(mixed) == [*scans[:5], *scans[6:30], *scans[31:]]


def test_a_half_turn_of_an_even_number_of_beams_lacks_the_last() -> None:
    assert lidar_of(180, ReplaySettings()).increment_rad == pytest.approx(math.radians(1.0))
    assert lidar_of(361, ReplaySettings()).increment_rad == pytest.approx(math.radians(0.5))
    wide = lidar_of(271, ReplaySettings(field_of_view_deg=270.0))
    assert wide.angle_min_rad == pytest.approx(math.radians(-135.0))


@pytest.mark.parametrize(
    "text", ["1 2 3\n", "1 2 3 4 5 6 7 nan\n", "# none\n", "a b c d e f g h\n"]
)
def test_malformed_relations_are_named(tmp_path: Path, text: str) -> None:
    (tmp_path / "x").write_text(text)
    with pytest.raises(FormatError, match="t1 t2 dx dy dz roll pitch yaw"):
        read_relations(tmp_path / "x")


def as_log(scans: list[LoggedScan]) -> str:
    lines = []
    for scan in scans:
        at = f"{scan.odometry.x} {scan.odometry.y} {scan.odometry.theta}"
        ranges = " ".join(f"{r:.4f}" for r in scan.ranges)
        lines.append(
            f"FLASER {len(scan.ranges)} {ranges} {at} {at} {scan.stamp} host {scan.logger_stamp}\n"
        )
    return "".join(lines)


def test_the_command_writes_its_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scans, truth = drive()
    log = tmp_path / "room.clf.gz"
    with gzip.open(log, "wt") as file:
        file.write(as_log(scans))
    relation = compose(invert(truth[5]), truth[30])
    relations = tmp_path / "room.relations"
    relations.write_text(f"51.0 56.0 {relation[0]} {relation[1]} 0 0 0 {relation[2]}\n")
    out, metrics = tmp_path / "out", tmp_path / "metrics.json"
    asked = ["slam", str(log), "--relations", str(relations), "--out", str(out)]
    assert main([*asked, "--json", str(metrics)]) == 0
    assert "relations      1 of 1" in capsys.readouterr().out
    told = json.loads(metrics.read_text())
    assert told == json.loads((out / "metrics.json").read_text())
    wanted = {"translation_mean_m", "translation_std_m", "rotation_mean_deg", "rotation_std_deg"}
    assert wanted < set(told["relations"])
    keys = {"ate_rmse_m", "rpe_m", "ms_per_scan", "ms_p999", "ms_max", "peak_rss_mb"}
    assert keys | {"loop_closures"} < set(told)
    assert len(read_tum(out / "trajectory.tum").stamps) == 40
    assert len(read_g2o(out / "graph.g2o").nodes) >= 1
    assert {"map.yaml", "map.pgm", "map.png", "metrics.txt", "odometry.tum"} <= {
        file.name for file in out.iterdir()
    }
    reference = ["--reference", str(out / "trajectory.tum"), "--every", "2"]
    assert main(["slam", str(log), "--out", str(out), *reference]) == 0
    again = ReferenceErrors.model_validate(
        json.loads((out / "metrics.json").read_text())["reference"]
    )
    assert again.ate_rmse_m < 0.05


def test_a_saved_map_is_one_to_be_localised_in(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scans, _ = drive()
    log, first, second = tmp_path / "room.clf", tmp_path / "first", tmp_path / "second"
    log.write_text(as_log(scans))
    assert main(["slam", str(log), "--out", str(first)]) == 0
    saved = SavedMap.decode((first / "map.earshot").read_bytes())
    assert json.loads((first / "metrics.json").read_text())["map_hash"] == saved.digest()
    for known, start in (("map.earshot", "0,0,0"), ("map.yaml", "0,0,0"), ("map.earshot", None)):
        asked = ["--map", str(first / known), "--localise"]
        asked += ["--start", start] if start else []
        reference = ["--reference", str(first / "trajectory.tum")]
        assert main(["slam", str(log), *asked, *reference, "--out", str(second)]) == 0
        told = json.loads((second / "metrics.json").read_text())
        assert told["map_hash"] is None
        assert told["anchors"] == 1
        assert told["localisation"]["settled"]
        assert told["localisation"]["losses"] == 0
        assert told["ate_rmse_m"] < 0.03
    # A bare room is its own twin.
    unknown = ["--map", str(first / "map.earshot"), "--localise", "--start", "unknown"]
    assert main(["slam", str(log), *unknown, "--out", str(second)]) == 0
    assert "undecided where it is" in capsys.readouterr().out


def test_what_is_no_known_map_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, other = tmp_path / "room.clf", tmp_path / "other.earshot"
    log.write_text(as_log(drive(5)[0]))
    other.write_bytes(b"anything")
    for extra, says in (
        (["--map", str(other), "--localise"], "other.earshot: no saved map"),
        (["--map", str(tmp_path / "none.earshot"), "--localise"], "cannot be read"),
        (["--map", str(other)], "--localise and --start go together"),
        (["--localise"], "--localise and --start go together"),
        (["--map", str(other), "--localise", "--start", "here"], "--start: expected X,Y,DEG"),
    ):
        assert main(["slam", str(log), *extra, "--out", str(tmp_path / "out")]) == 2
        said = capsys.readouterr().err.strip()
        assert says in said
        assert said.count("\n") == 0


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["slam", "nowhere.clf"], "nowhere.clf: not a readable CARMEN log"),
        (["slam", "nowhere.clf", "--every", "0"], "--every: "),
        (["optimise", "nowhere.g2o"], "nowhere.g2o: cannot be read"),
    ],
)
def test_errors_are_one_line(
    arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    assert capsys.readouterr().err.startswith(f"earshot: {says}")


@pytest.mark.parametrize("extra", [[], ["--robust"], ["--start", "odometry"]])
def test_a_graph_of_edges_alone_is_optimised(tmp_path: Path, extra: list[str]) -> None:
    """A square with a closure; and, to be refused, an edge that is far off."""
    lines = [f"EDGE_SE2 {k} {k + 1} 1 0 {math.pi / 2} 100 0 0 100 0 100\n" for k in range(4)]
    lines.append("EDGE_SE2 4 0 0.02 0 0 100 0 0 100 0 100\n")
    if extra == ["--robust"]:
        lines.append("EDGE_SE2 1 3 9 9 0 100 0 0 100 0 100\n")
    graph, out = tmp_path / "square.g2o", tmp_path / "out"
    graph.write_text("".join(lines))
    assert main(["optimise", str(graph), "--out", str(out), *extra]) == 0
    told = json.loads((out / "metrics.json").read_text())
    assert told["converged"]
    assert told["chi2"] < 0.05
    assert told["refused"] == (1 if extra == ["--robust"] else 0)
    assert (out / "graph.png").exists()
    assert len(read_g2o(out / "graph.g2o").nodes) == 5
