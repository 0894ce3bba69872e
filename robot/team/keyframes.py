"""Keyframes as journals have them, and as bytes.

    alone     [2, tick, anchor, beams, pose, sigma and scan]
    follower  [5, ticks, anchors, pose, sigma and scan]

A follower is told against the keyframe before it in its log (`robot.team.log_context`): so many
ticks later, so many anchors on, and as many beams.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from robot.slam.engine import Keyframe
from robot.team.packing import (
    POSE_BYTES,
    SIGMA_BYTES,
    checked_count,
    pack_pose,
    pack_sigma,
    split,
    unpack_pose,
    unpack_sigma,
)
from robot.team.scan_codec import (
    MAX_BEAMS,
    decode_scan,
    encode_scan,
    quantise,
    ranges_of,
    recall,
    store,
)

if TYPE_CHECKING:
    from protocol.pose import FloatArray, Pose2
    from robot.team.log_context import LogContext

ALONE, FOLLOWER = 2, 5


@dataclass(frozen=True, slots=True)
class StoredKeyframe:
    """A keyframe as journals have it: its scan stays compressed until somebody looks at it.

    Robots hold thousands of them, each scan ten times smaller so; the rest as in Keyframe. What
    follows needs the one before it to be read.
    """

    index: int
    tick: int
    anchor: int
    T_anchor_keyframe: "Pose2"
    covariance: "FloatArray"
    beams: int
    scan: bytes
    follows: bool = False

    @property
    def ranges(self) -> "FloatArray":
        """As in LaserScan (n)."""
        return ranges_of(recall(self.scan))


def keyframe_fields(keyframe: Keyframe, context: "LogContext | None") -> list[Any]:
    """A keyframe as its entry has it: a follower where something comes before it."""
    codes = quantise(keyframe.ranges)
    seen = pack_pose(keyframe.T_anchor_keyframe)
    sigma = pack_sigma(np.sqrt(np.diag(keyframe.covariance)))
    last = context.last if context is not None else None
    if (
        context is None
        or last is None
        or last.beams != len(codes)
        or last.tick > keyframe.tick
        or not context.may_follow(keyframe.anchor)
    ):
        seen += sigma + encode_scan(codes, np.full(len(codes), np.nan))
        return [ALONE, keyframe.tick, keyframe.anchor, len(codes), seen]
    foreseen = context.foresee(keyframe.anchor, unpack_pose(seen))
    seen += sigma + encode_scan(codes, foreseen)
    return [FOLLOWER, keyframe.tick - last.tick, keyframe.anchor - last.anchor, seen]


def read_alone(rest: list[Any], index: int, _: "LogContext | None") -> StoredKeyframe:
    """What follows the kind in the entry of a keyframe that stands alone."""
    tick, anchor, beams, seen = rest
    pose, sigma, scan = split(seen, POSE_BYTES, SIGMA_BYTES)
    codes = decode_scan(scan, np.full(checked_count(beams, MAX_BEAMS), np.nan))
    return StoredKeyframe(
        index,
        checked_count(tick),
        checked_count(anchor),
        unpack_pose(pose),
        np.diag(unpack_sigma(sigma) ** 2),
        beams,
        store(codes),
    )


def read_follower(rest: list[Any], index: int, context: "LogContext | None") -> StoredKeyframe:
    """Likewise, of one that follows."""
    ticks, anchors, seen = rest
    last = context.last if context is not None else None
    if context is None or last is None or type(anchors) is not int:
        raise ValueError("a keyframe follows what is not there")
    anchor = checked_count(last.anchor + anchors)
    if not context.may_follow(anchor):
        raise ValueError("a keyframe follows one that is too far away")
    pose, sigma, scan = split(seen, POSE_BYTES, SIGMA_BYTES)
    T_anchor_keyframe = unpack_pose(pose)
    codes = decode_scan(scan, context.foresee(anchor, T_anchor_keyframe))
    return StoredKeyframe(
        index,
        last.tick + checked_count(ticks),
        anchor,
        T_anchor_keyframe,
        np.diag(unpack_sigma(sigma) ** 2),
        last.beams,
        store(codes),
        follows=True,
    )
