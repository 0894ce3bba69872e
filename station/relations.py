"""How far a trajectory is from what is known of it: relations between places, or a reference.

Relations: Kümmerle, Steder, Dornhege, Ruhnke, Grisetti, Stachniss, Kleiner, "On measuring the
accuracy of SLAM algorithms", 2009: the relative pose of two moments, as a person who looked at
both scans found it. Errors of relations do not depend on where a map is placed, and one wrong turn
does not spoil all that comes after it.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from protocol.model import Model
from protocol.pose import FloatArray, compose, invert
from station.along_odometry import follow_odometry
from station.formats import FormatError, Trajectory, read_text
from station.replay import Replay, ReplayError
from world.accuracy import align, distances, rmse

FIELDS = "t1 t2 dx dy dz roll pitch yaw"
# An end of a relation belongs to a scan that is no farther from it than this.
SAME_TIME_S = 0.02
# Poses between scans farther apart than this are not trusted: the robot may have turned there.
MAX_GAP_S = 6.0
# References are on clocks of their own making: their stamps are rounded.
SAME_PLACE_S = 0.05
RPE_TRAVEL_M = 1.0


@dataclass(frozen=True, slots=True)
class Relations:
    """`stamps` k×2 (s) of both ends; `motions` k×3, the second end in the frame of the first."""

    stamps: FloatArray
    motions: FloatArray


class RelationErrors(Model):
    """Mean and standard deviation over the relations that could be used."""

    translation_mean_m: float
    translation_std_m: float
    rotation_mean_deg: float
    rotation_std_deg: float
    used: int
    given: int


class ReferenceErrors(Model):
    """ATE: RMSE of positions after the best alignment in SE(2). RPE: RMSE of the translation
    error of motions over a metre of travel, None for a reference that travels less."""

    ate_rmse_m: float
    rpe_m: float | None
    used: int


def read_relations(path: Path) -> Relations:
    """Raises FormatError on a line without eight finite numbers, or when there is none."""
    rows = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            row = [float(word) for word in words]
        except ValueError:
            row = []
        if len(row) != 8 or not all(map(math.isfinite, row)):
            raise FormatError(f"{path}:{number}: expected eight finite numbers: {FIELDS}")
        rows.append(row)
    if not rows:
        raise FormatError(f"{path}: no relation in it; expected lines of {FIELDS}")
    table = np.array(rows)
    return Relations(table[:, :2], table[:, [2, 3, 7]])


def relation_errors(replay: Replay, relations: Relations, interpolate: bool) -> RelationErrors:
    """The metric over the relations whose ends lie on scans, or with `interpolate` between scans.

    Raises ReplayError when no relation can be used.
    """
    clock = _clock(replay, relations.stamps.ravel(), SAME_TIME_S, interpolate)
    first, second = relations.stamps.T
    near = np.ones(len(first), dtype=bool)
    ends = []
    for wanted in (first, second):
        closest = _nearest(clock, wanted)
        on_scan = np.abs(clock[closest] - wanted) < SAME_TIME_S
        poses = replay.poses[closest]
        if interpolate:
            between = follow_odometry(clock, replay.odometry, replay.poses, wanted)
            poses = np.where(on_scan[:, None], poses, between)
            on_scan |= _between(clock, wanted)
        near &= on_scan
        ends.append(poses)
    if not near.any():
        raise ReplayError(
            f"none of {len(near)} relations has both ends on a scan of the log; are they of it? "
            "--interpolate also uses those between scans"
        )
    measured = compose(invert(ends[0][near]), ends[1][near])
    off = compose(invert(relations.motions[near]), measured)
    metres, degrees = np.hypot(off[:, 0], off[:, 1]), np.degrees(np.abs(off[:, 2]))
    return RelationErrors(
        translation_mean_m=float(metres.mean()),
        translation_std_m=float(metres.std()),
        rotation_mean_deg=float(degrees.mean()),
        rotation_std_deg=float(degrees.std()),
        used=int(near.sum()),
        given=len(near),
    )


def reference_errors(replay: Replay, reference: Trajectory) -> ReferenceErrors:
    """Against the poses of a reference that lie on scans of the log.

    Raises ReplayError when fewer than two do.
    """
    clock = _clock(replay, reference.stamps, SAME_PLACE_S, False)
    closest = _nearest(clock, reference.stamps)
    near = np.abs(clock[closest] - reference.stamps) < SAME_PLACE_S
    if near.sum() < 2:
        raise ReplayError(
            f"{near.sum()} of {len(near)} poses of the reference lie within {SAME_PLACE_S} s of "
            "a scan; is it of this log?"
        )
    poses, truth = replay.poses[closest[near]], reference.poses[near]
    error = rmse([distances(align(poses, truth), poses, truth)])
    assert error is not None
    return ReferenceErrors(ate_rmse_m=error, rpe_m=_rpe(poses, truth), used=int(near.sum()))


def _rpe(poses: FloatArray, truth: FloatArray) -> float | None:
    travelled = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(truth[:, :2], axis=0).T))])
    ends = np.searchsorted(travelled, travelled + RPE_TRAVEL_M)
    starts = np.flatnonzero(ends < len(truth))
    if len(starts) == 0:
        return None
    i, j = starts, ends[starts]
    wanted = compose(invert(truth[i]), truth[j])
    off = compose(invert(wanted), compose(invert(poses[i]), poses[j]))
    return float(np.sqrt(np.mean(off[:, 0] ** 2 + off[:, 1] ** 2)))


def _clock(replay: Replay, wanted: FloatArray, within_s: float, interpolate: bool) -> FloatArray:
    """A log has two clocks; what belongs to it was stamped by that one which fits more of it."""

    def fitting(clock: FloatArray) -> int:
        if interpolate:
            return int(_between(clock, wanted).sum())
        return int((np.abs(clock[_nearest(clock, wanted)] - wanted) < within_s).sum())

    usable = [c for c in (replay.logger_stamps, replay.stamps) if (np.diff(c) > 0.0).all()]
    return max(usable, key=fitting)


def _nearest(clock: FloatArray, wanted: FloatArray) -> np.ndarray:
    after = np.clip(np.searchsorted(clock, wanted), 1, len(clock) - 1)
    return np.where(clock[after] - wanted < wanted - clock[after - 1], after, after - 1)


def _between(clock: FloatArray, wanted: FloatArray) -> np.ndarray:
    after = np.clip(np.searchsorted(clock, wanted), 1, len(clock) - 1)
    inside = (wanted >= clock[0]) & (wanted <= clock[-1])
    return np.asarray(inside & (clock[after] - clock[after - 1] <= MAX_GAP_S))
