"""How far estimated trajectories are from the true ones, under one alignment for the whole team."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from protocol.messages import TrajectoryReply
from protocol.pose import IDENTITY, FloatArray, Pose2


@dataclass(frozen=True, slots=True)
class Track:
    """One robot's trajectory beside the truth at the same ticks (each n×3)."""

    true: FloatArray
    final: FloatArray
    online: FloatArray
    dead_reckoned: FloatArray
    frame: str = ""
    """What the estimated poses are relative to."""


def match(reply: TrajectoryReply, truth: FloatArray) -> Track | None:
    """A reply beside the true poses (T×3, row k of tick k), matched by tick.

    None where there is nothing to compare: no common tick.
    """
    known = reply.ticks < len(truth)
    if not known.any():
        return None
    final, online, dead_reckoned = (
        np.array(poses[known]) for poses in (reply.final, reply.online, reply.dead_reckoned)
    )
    return Track(truth[reply.ticks[known]], final, online, dead_reckoned, reply.frame)


def align(estimated: FloatArray, true: FloatArray) -> Pose2:
    """`T_world_map` that brings estimated poses (n×3) closest to the true ones.

    Umeyama, "Least-squares estimation of transformation parameters between two point patterns",
    1991, in the plane and without scale. Positions that all coincide leave the rotation open:
    then the headings decide.
    """
    if len(estimated) == 0:
        return IDENTITY
    from_centre = estimated[:, :2] - estimated[:, :2].mean(axis=0)
    to_centre = true[:, :2] - true[:, :2].mean(axis=0)
    cross = from_centre.T @ to_centre
    theta = np.arctan2(cross[0, 1] - cross[1, 0], cross[0, 0] + cross[1, 1])
    if np.mean(np.sum(to_centre**2, axis=1)) < 1e-4:
        turned = true[:, 2] - estimated[:, 2]
        theta = np.arctan2(np.sin(turned).mean(), np.cos(turned).mean())
    rotated = Pose2(0.0, 0.0, float(theta)).apply(estimated[:, :2])
    x, y = (true[:, :2] - rotated).mean(axis=0)
    return Pose2(float(x), float(y), float(theta))


def align_team(pairs: Iterable[tuple[FloatArray, FloatArray]]) -> Pose2:
    """`align` over (estimated, true) of all robots together: errors between robots stay in."""
    estimated, true = zip(*pairs, strict=True) if (pairs := list(pairs)) else ((), ())
    empty = np.zeros((0, 3))
    return align(np.concatenate([empty, *estimated]), np.concatenate([empty, *true]))


def by_frame(frames: Mapping[str, str]) -> dict[str, tuple[str, ...]]:
    """The robots in each frame, from the frame that each robot's poses are relative to; frames and
    robots in the order given."""
    return {
        frame: tuple(name for name in frames if frames[name] == frame)
        for frame in dict.fromkeys(frames.values())
    }


def align_frames(tracks: Mapping[str, Track]) -> dict[str, Pose2]:
    """`T_world_map` of each robot's estimates: one for all that share a frame. Robots that are not
    aligned with each other are no worse for where their frames happen to lie."""
    found: dict[str, Pose2] = {}
    for members in _frames(tracks).values():
        T_world_map = align_team((tracks[name].final, tracks[name].true) for name in members)
        found.update(dict.fromkeys(members, T_world_map))
    return {name: found[name] for name in tracks}


def largest_frame(tracks: Mapping[str, Track]) -> tuple[str, ...]:
    """The robots that share a frame with most others; of equally many, those of the first robot."""
    return max(_frames(tracks).values(), key=len, default=())


def _frames(tracks: Mapping[str, Track]) -> dict[str, tuple[str, ...]]:
    return by_frame({name: track.frame for name, track in tracks.items()})


def distances(T_world_map: Pose2, estimated: FloatArray, true: FloatArray) -> FloatArray:
    """How far each aligned position is from the true one (n, m)."""
    apart = T_world_map.apply(np.ascontiguousarray(estimated[:, :2])) - true[:, :2]
    return np.asarray(np.hypot(apart[:, 0], apart[:, 1]), dtype=np.float64)


def rmse(errors: Iterable[npt.NDArray[np.float64]]) -> float | None:
    """The root of the mean square over all of them; None of nothing."""
    together = np.concatenate([np.zeros(0), *errors])
    return float(np.sqrt(np.mean(together**2))) if len(together) else None
