"""Places: stretches of a log's travel as small maps that can be found again in another's.

A place is made of the keyframes of some metres of travel, tied by the front end's own chain alone,
in the frame of the anchor of its middle keyframe. So it is a function of entries that never change:
every robot that holds the log makes the same places of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from protocol.pose import IDENTITY, FloatArray, Pose2, compose, invert
from robot.perception.field import CorrelationField
from robot.perception.returns import Returns, describe_returns
from robot.perception.scan import LaserScan
from robot.perception.walls import Walls
from robot.team.log_graph import LogGraph

TRAVEL_M = 6.0
EVERY_M = 4.0
# What was seen so far back is drawn too: a place that is looked for lies seldom within one stretch.
CONTEXT_M = 12.0
# So much overlaps then that every so many places hold it all.
SEARCHED_EVERY = 3
# Turning on the spot is no travel, but so many keyframes are a place all the same.
MAX_KEYFRAMES = 40
USABLE_RANGE_M = 20.0
# Room round the keyframes for what they see; farther returns are cut off.
REACH_M = 12.0
MATCH_SPACING_M, SEARCH_SPACING_M = 0.08, 0.25
SEARCH_POINTS = 120
DIRECTION_BINS = 180


@dataclass(frozen=True, slots=True)
class Place:
    """A stretch of travel. Poses are `T_place_…`; the frame of the place is that of `anchor`.

    `keyframes` (k×3) with their `scans`, `centre` (2,) their mean position, `field` what they saw,
    `surfaces` the same as points, `landmarks` few of them, spread evenly, for a search;
    `surroundings`: what was seen just before is drawn there too, with what the chain drifted;
    `walls` which way all of it faces.
    `directions` (180,): how much wall faces each direction, by degree, without the sign.
    """

    number: int
    anchor: int
    keyframes: FloatArray
    scans: tuple[Returns, ...]
    centre: FloatArray
    field: CorrelationField
    surroundings: CorrelationField
    walls: Walls
    surfaces: Returns
    landmarks: Returns
    directions: FloatArray


@dataclass(frozen=True, slots=True)
class Stretch:
    """Which keyframes of a log make a place: from `first` up to, not including, `end`."""

    number: int
    first: int
    end: int


def stretches(log: LogGraph, whole: bool = False) -> list[Stretch]:
    """The stretches of a log that are complete, or with a `whole` log the unfinished last one too.

    They follow from the travel up to each keyframe, so later keyframes do not change them.
    """
    travelled = _travel(log)
    found: list[Stretch] = []
    first = 0
    while first < len(travelled):
        end = first + 1
        while end < len(travelled) and end - first < MAX_KEYFRAMES:
            if travelled[end] - travelled[first] >= TRAVEL_M:
                break
            end += 1
        complete = end < len(travelled)
        if complete or (whole and (end - first >= 3 or not found)):
            found.append(Stretch(len(found), first, end))
        if not complete:
            break
        following = int(np.searchsorted(travelled, travelled[first] + EVERY_M, side="left"))
        first = max(first + 1, min(following, first + (2 * MAX_KEYFRAMES) // 3))
    return found


Numbered = TypeVar("Numbered", Place, Stretch)


def searched(places: Sequence[Numbered]) -> list[Numbered]:
    """Those places of a log in which others are looked for: these and what was seen before them
    are all that was seen."""
    return [
        place
        for place in places
        if place.number % SEARCHED_EVERY == SEARCHED_EVERY - 1 or place is places[-1]
    ]


def _travel(log: LogGraph) -> FloatArray:
    """Metres (k) driven up to each keyframe, by the chain of anchors."""
    poses = chained_poses(log, 0, len(log.keyframes))
    steps = np.hypot(*np.diff(poses[:, :2], axis=0).T) if len(poses) else np.zeros(0)
    return np.asarray(np.concatenate([[0.0], np.cumsum(steps)])[: len(poses)], dtype=np.float64)


def chained_poses(log: LogGraph, first: int, end: int) -> FloatArray:
    """Poses (k×3) of keyframes from `first` up to `end`, in the frame of the first one's anchor,
    by the chain of anchors alone."""
    keyframes = log.keyframes[first:end]
    if not keyframes:
        return np.zeros((0, 3))
    anchors = [keyframe.anchor for keyframe in keyframes]
    low, high = min(anchors), max(anchors)
    chain = [IDENTITY]
    for anchor in log.anchors[low + 1 : high + 1]:
        chain.append(chain[-1] @ anchor.T_previous_anchor)
    poses = np.array([pose.to_array() for pose in chain])
    poses = compose(invert(poses[anchors[0] - low]), poses)
    relative = np.array([keyframe.T_anchor_keyframe.to_array() for keyframe in keyframes])
    return compose(poses[np.array(anchors) - low], relative)


def make_place(log: LogGraph, stretch: Stretch, noise: FloatArray) -> Place:
    """Draw the keyframes of a stretch; `noise` as in `describe_returns`."""
    assert log.hello is not None
    keyframes = log.keyframes[stretch.first : stretch.end]
    middle = keyframes[len(keyframes) // 2]
    begin = _context(log, stretch)
    poses = chained_poses(log, begin, stretch.end)
    # Into the frame of the middle keyframe's anchor.
    at = Pose2.from_array(poses[stretch.first - begin + len(keyframes) // 2])
    poses = compose((at @ middle.T_anchor_keyframe.inverse()).inverse().to_array(), poses)
    angles, max_range = log.hello.angles, log.hello.max_range_m
    scans = tuple(
        describe_returns(
            LaserScan(keyframe.ranges, angles, max_range), noise, min(max_range, USABLE_RANGE_M)
        )
        for keyframe in log.keyframes[begin : stretch.end]
    )
    surroundings = CorrelationField.around(float(np.abs(poses[:, :2]).max()) + REACH_M)
    before = stretch.first - begin
    draw(surroundings, poses[before:], scans[before:])
    field = surroundings.cropped()
    draw(surroundings, poses[:before], scans[:before])
    walls = Walls(spread(together(poses, scans), MATCH_SPACING_M))
    poses, scans = poses[before:], scans[before:]
    extent = float(np.abs(poses[:, :2]).max()) + REACH_M
    surfaces = spread(_within(together(poses, scans), extent), MATCH_SPACING_M)
    landmarks = spread(surfaces, SEARCH_SPACING_M)
    return Place(
        stretch.number,
        middle.anchor,
        poses,
        scans,
        poses[:, :2].mean(axis=0),
        field,
        surroundings.cropped(),
        walls,
        surfaces,
        landmarks.thinned(SEARCH_POINTS),
        _directions(surfaces),
    )


def draw(field: CorrelationField, poses: FloatArray, scans: tuple[Returns, ...]) -> None:
    """Draw scans at poses (k×3) into a field."""
    for pose, scan in zip(poses, scans, strict=True):
        field.draw(Pose2.from_array(pose), scan)


def _context(log: LogGraph, stretch: Stretch) -> int:
    """The first of the keyframes that are drawn with a stretch: what was seen just before."""
    travelled = _travel(log)
    wanted = travelled[stretch.first] - CONTEXT_M
    first = int(np.searchsorted(travelled, wanted, side="left"))
    return max(first, stretch.first - 2 * MAX_KEYFRAMES, 0)


def together(poses: FloatArray, scans: tuple[Returns, ...]) -> Returns:
    """All returns of scans at poses (k×3), in the frame of these, normals towards who saw them."""
    placed = [
        scan.facing().moved(Pose2.from_array(pose)).values
        for pose, scan in zip(poses, scans, strict=True)
    ]
    return Returns.unlinked(np.concatenate(placed))


def _within(returns: Returns, extent: float) -> Returns:
    return Returns.unlinked(returns.values[(np.abs(returns.points) < extent).all(axis=1)])


def spread(returns: Returns, spacing_m: float) -> Returns:
    """One return, the most precise, in each square of a grid; all with the same weight."""
    if len(returns) == 0:
        return returns
    order = np.argsort(returns.values[:, 5], kind="stable")
    cells = np.floor(returns.values[order, :2] / spacing_m).astype(np.int64)
    _, chosen = np.unique(cells, axis=0, return_index=True)
    values = returns.values[np.sort(order[chosen])]
    values[:, 4] = 1.0
    return Returns.unlinked(values)


def _directions(returns: Returns) -> FloatArray:
    normals = returns.values[:, 2:4]
    lined = normals[np.abs(normals).sum(axis=1) > 0.0]
    degrees = np.degrees(np.arctan2(lined[:, 1], lined[:, 0])) % 180.0
    histogram = np.bincount(degrees.astype(np.int64) % 180, minlength=DIRECTION_BINS)
    wide = histogram.astype(np.float64)
    smooth = np.zeros(DIRECTION_BINS)
    for shift in range(-3, 4):
        smooth += np.roll(wide, shift) * (4 - abs(shift))
    norm = float(np.sqrt((smooth**2).sum()))
    return np.asarray(smooth / norm if norm > 0.0 else smooth, dtype=np.float64)
