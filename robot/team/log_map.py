"""A whole log as a map that another can be laid over: the last test of an alignment.

Matches look at a few metres. Where two logs are wrongly aligned, most of what they have in common
by that alignment was never matched, and there rays of one run through walls of the other.
"""

import math
from dataclasses import dataclass

import numpy as np

from protocol.pose import IDENTITY, FloatArray, Pose2
from robot.perception.field import CorrelationField, Overlay
from robot.perception.matching import match_facing
from robot.perception.returns import Returns, describe_returns
from robot.perception.scan import LaserScan
from robot.perception.walls import Walls
from robot.team.joint import keyframe_poses
from robot.team.log_graph import LogGraph
from robot.team.place import USABLE_RANGE_M, draw, spread, together

# Keyframes nearer than this to the last one used show little that is new.
APART_M = 0.8
REACH_M = 12.0
WALL_SPACING_M, SIDE_SPACING_M = 0.25, 0.08
# A map that would lie better elsewhere by more than this lies where it is for another reason.
MAX_SHIFT_M, MAX_TURN_RAD = 0.5, 0.05
# A wall with another one nearer than this has drifted rather than gone.
DRIFTED_M = 0.2


@dataclass(frozen=True, slots=True)
class LogScans:
    """Some of the keyframes of a log, by number, and what their scans say."""

    chosen: tuple[int, ...]
    scans: tuple[Returns, ...]


@dataclass(frozen=True, slots=True)
class LogMap:
    """Scans at poses (k×3), what they drew, and the walls, spread evenly, with normals towards the
    robot, and which way they face, all in one frame; `solid` (n×2): points of walls that the robot
    never saw through."""

    poses: FloatArray
    scans: tuple[Returns, ...]
    field: CorrelationField
    walls: Returns
    sides: Walls
    solid: FloatArray


@dataclass(frozen=True, slots=True)
class Overlap:
    """How two maps lie on each other; shares as in Evidence, `walls_m` the length of wall that
    both have seen and agree on, each stretch counted once, `crossing_mean` that of both ways;
    `faced` the share of those walls that both have seen from the same side; `gone_m` the length of
    walls of one that the other saw through, with none near them."""

    overlap: float
    hits: float
    crossing: float
    walls_m: float
    crossing_mean: float
    faced: float
    gone_m: float


def choose_scans(log: LogGraph, anchors: FloatArray, noise: FloatArray) -> LogScans:
    """Keyframes spread over the way of a log with its anchors (m×3); `noise` as in
    `describe_returns`."""
    assert log.hello is not None
    chosen = _apart(keyframe_poses(log, anchors))
    angles, max_range = log.hello.angles, log.hello.max_range_m
    reach = min(max_range, USABLE_RANGE_M)
    return LogScans(
        tuple(chosen),
        tuple(
            describe_returns(LaserScan(log.keyframes[k].ranges, angles, max_range), noise, reach)
            for k in chosen
        ),
    )


def draw_log(log: LogGraph, scans: LogScans, anchors: FloatArray) -> LogMap:
    """The map of a log with its anchors (m×3) placed."""
    poses = keyframe_poses(log, anchors)[list(scans.chosen)]
    low, high = poses[:, :2].min(axis=0), poses[:, :2].max(axis=0)
    field = CorrelationField.around(0.5 * float((high - low).max()) + REACH_M)
    field.origin = field.origin + 0.5 * (low + high)
    draw(field, poses, scans.scans)
    surfaces = together(poses, scans.scans)
    walls = spread(surfaces, WALL_SPACING_M)
    solid = walls.points[~field.passed(walls.points)]
    return LogMap(poses, scans.scans, field, walls, Walls(spread(surfaces, SIDE_SPACING_M)), solid)


def _apart(poses: FloatArray) -> list[int]:
    chosen: list[int] = []
    for k in range(len(poses)):
        last = poses[chosen[-1]] if chosen else np.full(3, np.inf)
        if math.hypot(poses[k, 0] - last[0], poses[k, 1] - last[1]) >= APART_M:
            chosen.append(k)
    return chosen


def closest(a: LogMap, b: LogMap) -> Pose2:
    """The shift `T_a_b` of a whole map that makes it lie best on another, near to where both are:
    what a hypothesis errs by that rests on one match at one end of them."""
    shift = match_facing(a.field, a.sides, b.walls, IDENTITY).T_field_base
    near = math.hypot(shift.x, shift.y) <= MAX_SHIFT_M and abs(shift.theta) <= MAX_TURN_RAD
    return shift if near else IDENTITY


def lay_over(a: LogMap, b: LogMap, T_a_b: Pose2 = IDENTITY) -> Overlap:
    """How two maps lie on each other, the second one shifted; the worse of both ways counts."""
    on_a, walls_a, faced_a = _one_way(a, b, T_a_b)
    on_b, walls_b, faced_b = _one_way(b, a, T_a_b.inverse())
    return Overlap(
        max(on_a.overlap, on_b.overlap),
        min(on_a.hits, on_b.hits),
        max(on_a.crossing, on_b.crossing),
        min(walls_a, walls_b),
        0.5 * (on_a.crossing + on_b.crossing),
        min(faced_a, faced_b),
        _gone(a, b, T_a_b) + _gone(b, a, T_a_b.inverse()),
    )


def _one_way(a: LogMap, b: LogMap, T_a_b: Pose2) -> tuple[Overlay, float, float]:
    total, weight = np.zeros(4), 0.0
    for pose, scan in zip(b.poses, b.scans, strict=True):
        total += a.field.compare(T_a_b @ Pose2.from_array(pose), scan)
        weight += float(scan.values[:, 4].sum())
    walls = T_a_b.apply(b.walls.points.copy())
    faced = a.sides.faced(T_a_b, b.walls)
    return Overlay.of(total, weight), WALL_SPACING_M * a.field.on_walls(walls), faced


def _gone(a: LogMap, b: LogMap, T_a_b: Pose2) -> float:
    """The length (m) of the walls of b that a saw through and knows nothing like near them."""
    solid = T_a_b.apply(b.solid.copy())
    through = solid[a.field.passed(solid)]
    return WALL_SPACING_M * int((~a.field.is_wall_near(through, DRIFTED_M)).sum())
