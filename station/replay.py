"""Playing a log to a SLAM engine, offline and as fast as the engine takes it.

A log may be played backwards, decimated, with odometry that is wrong by a factor and with more
noise on its ranges: what an engine must also stand.
"""

import bisect
import gc
import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from protocol.config import BodyConfig, LidarConfig
from protocol.errors import EarshotError
from protocol.model import Model
from protocol.pose import IDENTITY, FloatArray, Pose2, compose, invert
from robot.jobs import Jobs
from robot.localisation.known_map import KnownMap
from robot.localisation.localiser import Localiser
from robot.perception.scan import LaserScan, beam_angles, perceive
from robot.slam.engine import Engine, Entry, GraphSnapshot, Keyframe
from robot.slam.engines import make_engine
from robot.slam.saved_map import SavedMap
from station.along_odometry import follow_odometry
from station.raw_odometry import raw_motions
from station.scan_log import LoggedScan, ScanLog, Scanner

# An engine of its own first drives there and back along some of the scans, until it has closed a
# loop, so that no scan of the log waits for a kernel to be read from disk.
REHEARSAL_SCANS = 40
REHEARSAL_STEP_M = 0.2
REHEARSAL_TURNS = 6
MAX_BEAMS = 4096

Progress = Callable[[int, int], None]


class ReplayError(EarshotError):
    """A log that cannot be played as asked; the message says why and what to change."""


class ReplaySettings(Model):
    """How a log is played. The defaults play it as it is."""

    engine: str = "graph"
    reverse: bool = Field(False, description="from its end to its beginning")
    every: int = Field(1, ge=1, description="only every n-th scan")
    odometry_scale: float = Field(1.0, gt=0.0, le=10.0, description="factor on driven distances")
    turn_error: float = Field(0.0, gt=-1.0, le=10.0, description="share that turns are too far")
    range_noise_m: float = Field(0.0, ge=0.0, le=10.0, description="σ added to every range")
    seed: int = Field(0, ge=0, description="what that noise is drawn from")
    max_range_m: float = Field(40.0, gt=0.0, le=1000.0, description="longer ranges are no return")
    field_of_view_deg: float | None = Field(None, gt=0.0, le=360.0)


@dataclass(frozen=True, slots=True)
class Whereabouts:
    """To be localised in a known map instead of mapping: where the robot starts (`T_map_base`), or
    None when nobody knows."""

    known: KnownMap
    start: Pose2 | None = IDENTITY


@dataclass(frozen=True, slots=True)
class Found:
    """How localisation went: the played scan from which on the place was known first (None: never),
    the way to there (m), and how often it was lost again. `settled` at the end."""

    settled: bool
    scan: int | None
    driven_m: float
    losses: int


@dataclass(frozen=True, slots=True)
class Replay:
    """What came of a log: n scans in the order of their stamps, of which m were played.

    `odometry` and `poses` (n×3): the wheels' and the final estimate of every scan; poses of scans
    that were not played follow the odometry between those that were. `online` (m×3) is what the
    engine said at once. `keyframes` are (pose, scan). `step_s` (m): time for each played scan.
    `saved` is the map as it can be kept, `found` how it went in a known one.
    """

    stamps: FloatArray
    logger_stamps: FloatArray
    odometry: FloatArray
    poses: FloatArray
    played: FloatArray
    online: FloatArray
    keyframes: list[tuple[Pose2, LaserScan]]
    graph: GraphSnapshot
    loop_closures: int
    step_s: FloatArray
    wall_s: float
    lidar: LidarConfig
    saved: SavedMap | None
    found: Found | None


def lidar_of(
    beams: int,
    settings: ReplaySettings,
    scanner: Scanner | None = None,
    reach_m: float = math.inf,
) -> LidarConfig:
    """The scanner as the log has it, or else one that looks forward. Of those an even number of
    beams over a half turn lacks the last one: 180 stand at −90…+89°, 361 at −90…+90°."""
    if not 3 <= beams <= MAX_BEAMS:
        raise ReplayError(f"scans of {beams} beams; expected 3 to {MAX_BEAMS}")
    if scanner is not None and settings.field_of_view_deg is None:
        return LidarConfig(
            beams=beams,
            field_of_view_rad=min(scanner.field_of_view_rad, math.tau),
            angle_min_rad=scanner.first_rad,
            max_range_m=min(settings.max_range_m, scanner.max_range_m),
            noise="none",
        )
    if settings.field_of_view_deg is None:
        span = math.pi * (1.0 if beams % 2 else (beams - 1) / beams)
        first = -0.5 * math.pi
    else:
        span = math.radians(settings.field_of_view_deg)
        first = -0.5 * span
    return LidarConfig(
        beams=beams,
        field_of_view_rad=span,
        angle_min_rad=first,
        max_range_m=min(settings.max_range_m, reach_m),
        noise="none",
    )


def play(
    log: ScanLog,
    settings: ReplaySettings,
    progress: Progress | None = None,
    whereabouts: Whereabouts | None = None,
) -> Replay:
    """Play a log to an engine that starts with the robot at the origin, or in a known map.

    The engine maps from where the laser is; poses that come back are the robot's.

    `progress` is told (scans played, of how many). Scans whose stamp is not after the one before
    are left out. Raises ReplayError when nothing is left to play, UnknownEngineError.
    """
    scans = in_order(log.scans)
    lidar = lidar_of(len(scans[0].ranges), settings, log.scanner, log.reach_m)
    T_base_laser = log.scanner.T_base_laser if log.scanner else IDENTITY
    wheels = _wrong(np.array([scan.odometry.to_array() for scan in scans]), settings)
    odometry = moved(wheels, T_base_laser)
    ranges = _noisy(scans, settings)
    order = np.arange(len(scans))[:: -1 if settings.reverse else 1][:: settings.every]
    _rehearse(ranges, odometry, order, lidar, settings)
    # Or a scan of the log waits until all that was made before it has been looked through.
    gc.collect()
    gc.freeze()

    engine = _engine(lidar, settings, T_base_laser, whereabouts)
    first_settled: int | None = None
    step_s, estimates = np.empty(len(order)), []
    start = time.perf_counter()
    motions = raw_motions(odometry[order])
    for tick, (index, motion) in enumerate(zip(order.tolist(), motions, strict=True)):
        began = time.perf_counter()
        estimate = engine.step(tick, motion, perceive(ranges[index], lidar))
        step_s[tick] = time.perf_counter() - began
        estimates.append(estimate.pose)
        if isinstance(engine, Localiser) and engine.settled and first_settled is None:
            first_settled = tick
        if progress is not None:
            progress(tick + 1, len(order))
    wall_s = time.perf_counter() - start
    gc.unfreeze()

    online = np.array([(pose.x, pose.y, pose.theta) for pose in estimates])
    stamps = np.array([scan.stamp for scan in scans])
    by_stamp = np.argsort(order)
    played = order[by_stamp]
    T_laser_base = T_base_laser.inverse()
    poses = moved(engine.trajectory()[by_stamp], T_laser_base)
    return Replay(
        stamps=stamps,
        logger_stamps=np.array([scan.logger_stamp for scan in scans]),
        odometry=wheels,
        poses=follow_odometry(stamps[played], wheels[played], poses, stamps, wheels),
        played=stamps[played],
        online=moved(online[by_stamp], T_laser_base),
        keyframes=_keyframes(engine.take_entries(), engine.anchors, lidar),
        graph=engine.graph(),
        loop_closures=engine.loop_closures,
        step_s=step_s,
        wall_s=wall_s,
        lidar=lidar,
        saved=None if isinstance(engine, Localiser) else SavedMap.of(engine),
        found=_found(engine, first_settled, wheels[order]),
    )


def _engine(
    lidar: LidarConfig,
    settings: ReplaySettings,
    T_base_laser: Pose2,
    whereabouts: Whereabouts | None,
) -> Engine:
    if whereabouts is None:
        return make_engine(settings.engine, lidar, BodyConfig(), T_base_laser, Jobs())
    start = whereabouts.start
    return Localiser(whereabouts.known, lidar, None if start is None else start @ T_base_laser)


def _found(engine: Engine, first: int | None, odometry: FloatArray) -> Found | None:
    """How localisation went, if that is what the engine did; odometry (m×3) as played."""
    if not isinstance(engine, Localiser):
        return None
    steps = np.diff(odometry[: None if first is None else first + 1, :2], axis=0)
    driven_m = float(np.hypot(steps[:, 0], steps[:, 1]).sum())
    return Found(engine.settled, first, driven_m, engine.losses)


def moved(poses: FloatArray, T: Pose2) -> FloatArray:
    """Poses (n×3) of another frame of the same body, whose pose in the first one is T."""
    return poses if T == IDENTITY else compose(poses, T.to_array())


def in_order(scans: list[LoggedScan]) -> list[LoggedScan]:
    """The most scans of which each has a later stamp than the one before: one that is far off costs
    itself alone. Raises ReplayError if few are left."""
    # Least stamps that end a row of 1, 2, … scans, which scan that is, and the one before each.
    ends: list[float] = []
    last: list[int] = []
    before: list[int] = []
    for number, scan in enumerate(scans):
        place = bisect.bisect_left(ends, scan.stamp)
        before.append(last[place - 1] if place else -1)
        # Of scans with one stamp the first is kept.
        if place == len(ends):
            ends.append(scan.stamp)
            last.append(number)
        elif scan.stamp < ends[place]:
            ends[place], last[place] = scan.stamp, number
    if len(ends) < 2:
        raise ReplayError(f"{len(ends)} scans in the order of time; a log needs two at least")
    kept = [last[-1]]
    while before[kept[-1]] >= 0:
        kept.append(before[kept[-1]])
    return [scans[number] for number in reversed(kept)]


def _wrong(odometry: FloatArray, settings: ReplaySettings) -> FloatArray:
    """The odometry (n×3) of a robot whose wheels are not what it thinks."""
    if settings.odometry_scale == 1.0 and settings.turn_error == 0.0:
        return odometry
    steps = compose(invert(odometry[:-1]), odometry[1:])
    steps *= [settings.odometry_scale, settings.odometry_scale, 1.0 + settings.turn_error]
    wrong = [odometry[0]]
    for step in steps:
        wrong.append(compose(wrong[-1], step))
    return np.array(wrong)


def _noisy(scans: list[LoggedScan], settings: ReplaySettings) -> list[np.ndarray]:
    """The ranges (n) of every scan; noise is drawn for a scan whether it is played or not."""
    chance = np.random.default_rng(settings.seed)
    out = []
    for scan in scans:
        ranges = scan.ranges
        if settings.range_noise_m > 0.0:
            ranges = ranges + settings.range_noise_m * chance.standard_normal(len(ranges))
        out.append(ranges.astype(np.float32))
    return out


def _rehearse(
    ranges: list[np.ndarray],
    odometry: FloatArray,
    order: np.ndarray,
    lidar: LidarConfig,
    settings: ReplaySettings,
) -> None:
    engine = make_engine(settings.engine, lidar, BodyConfig(), IDENTITY, Jobs())
    way = _apart(odometry, order)
    there_and_back = (way + way[-2:0:-1]) * REHEARSAL_TURNS
    for tick, motion in enumerate(raw_motions(odometry[there_and_back])):
        engine.step(tick, motion, perceive(ranges[there_and_back[tick]], lidar))
        if engine.loop_closures > 0:
            break


def _apart(odometry: FloatArray, order: np.ndarray) -> list[int]:
    """The first scans of which each is some way from the one before."""
    chosen = [int(order[0])]
    for index in order:
        step = odometry[index, :2] - odometry[chosen[-1], :2]
        if math.hypot(*step) >= REHEARSAL_STEP_M:
            chosen.append(int(index))
        if len(chosen) == REHEARSAL_SCANS:
            break
    return chosen


def _keyframes(
    entries: list[Entry], anchors: FloatArray, lidar: LidarConfig
) -> list[tuple[Pose2, LaserScan]]:
    angles = beam_angles(lidar)
    return [
        (
            Pose2.from_array(anchors[entry.anchor]) @ entry.T_anchor_keyframe,
            LaserScan(np.array(entry.ranges), angles, lidar.max_range_m),
        )
        for entry in entries
        if isinstance(entry, Keyframe)
    ]
