"""Where the parts of a split log were placed, against the same log as one robot."""

import math

import numpy as np

from protocol.model import Model
from protocol.pose import FloatArray
from robot.team.joint import JointGraph, Solution, keyframe_poses
from robot.team.journal import LogName
from station.merge import Merge
from station.merge_sources import Source, Whole
from world.accuracy import align, align_team, distances


class PartMetrics(Model):
    """Where a part lies after one alignment for all parts: the shift of its middle and the turn
    that would bring its keyframes closest, and their root mean square before that."""

    name: str
    placed_m: float
    placed_rad: float
    rmse_m: float


def measure_parts(
    merge: Merge, names: dict[LogName, Source], wholes: dict[str, Whole]
) -> tuple[PartMetrics, ...]:
    """The parts of all logs whose parts share a frame, in order."""
    found: list[PartMetrics] = []
    for label, whole in wholes.items():
        members = [name for name, source in names.items() if source.part[0] == label]
        solution = next(s for s in merge.solutions if members[0] in s)
        if any(name not in solution for name in members):
            continue
        tracks = [_track(merge.graph, name, solution, names[name], whole) for name in members]
        T_whole_merged = align_team(tracks)
        for name, (merged, alone) in zip(members, tracks, strict=True):
            T_whole_part = align(merged, alone)
            middle = merged[:, :2].mean(axis=0, keepdims=True)
            shift = T_whole_part.apply(middle) - T_whole_merged.apply(middle)
            found.append(
                PartMetrics(
                    name=names[name].name,
                    placed_m=float(np.hypot(*shift[0])),
                    placed_rad=abs((T_whole_part @ T_whole_merged.inverse()).theta),
                    rmse_m=math.sqrt(float(np.mean(distances(T_whole_merged, merged, alone) ** 2))),
                )
            )
    return tuple(found)


def _track(
    graph: JointGraph, name: LogName, solution: Solution, source: Source, whole: Whole
) -> tuple[FloatArray, FloatArray]:
    """The keyframes (k×3) of a part as merged, and the same scans in the log as one robot."""
    log = graph.log(name)
    assert log is not None
    scans = [source.part[1] + keyframe.tick for keyframe in log.keyframes]
    return keyframe_poses(log, solution[name]), whole.poses[scans]
