"""What a merge came to, in numbers: metrics.json of `earshot merge`."""

import math
from itertools import combinations, pairwise

import numpy as np

from maps.grid import OccupancyGrid
from protocol.config import LidarConfig, PoseModel
from protocol.model import Model
from protocol.pose import FloatArray, Pose2
from robot.mapping.occupancy import OccupancyMap
from robot.perception.scan import LaserScan
from robot.team.alignment import Alignment
from robot.team.joint import JointGraph, keyframe_poses
from robot.team.journal import LogName
from robot.team.log_map import LogMap, choose_scans, draw_log, lay_over
from robot.team.pair_judge import PairView, State
from station.merge import Merge
from station.merge_parts import PartMetrics, measure_parts
from station.merge_sources import Source, Whole

RESOLUTION_M = 0.05


class PairEvidence(Model):
    """What the alignment of a pair rests on, by the matches between the two alone."""

    matches: int
    places: int
    worth: float
    sightings: int
    rival: float
    hits: float | None
    crossing: float | None
    walls_m: float | None


class PairMetrics(Model):
    """Two robots: how they stand and why; how well their maps agree if they share a frame.

    `overlap`: free cells in both by those of the smaller; `agreement`: of the cells known to both,
    how many both hold for wall or both for free; `contradictions`: rays of each through walls of
    the other. `transform` is `T_a_b` between the first anchors.
    """

    a: str
    b: str
    state: str
    reason: str
    evidence: PairEvidence
    inliers: int
    overlap: float | None = None
    agreement: float | None = None
    contradictions: float | None = None
    transform: PoseModel | None = None


class MergeMetrics(Model):
    """metrics.json. `aligned` is the number of robots in the largest group that shares a frame;
    `agreement` and `contradictions` are means over aligned pairs, cycles the worst of three aligned
    pairs, each of these by its own matches alone."""

    robots: tuple[str, ...]
    aligned: int
    groups: tuple[tuple[str, ...], ...]
    pairs: tuple[PairMetrics, ...]
    agreement: float | None
    contradictions: float | None
    cycle_error_m: float | None
    cycle_error_rad: float | None
    parts: tuple[PartMetrics, ...]
    compared_places: int
    seconds: float


def measure_merge(
    merge: Merge,
    names: dict[LogName, Source],
    wholes: dict[str, Whole],
    lidar: LidarConfig,
    seconds: float,
) -> tuple[MergeMetrics, dict[LogName, OccupancyGrid]]:
    """The metrics, and the map of each log in the frame of its group."""
    grids: dict[LogName, OccupancyGrid] = {}
    maps: dict[LogName, LogMap] = {}
    for solution in merge.solutions:
        for name, anchors in solution.items():
            log = merge.graph.log(name)
            assert log is not None
            grids[name] = draw_grid(merge.graph, name, anchors, lidar)
            maps[name] = draw_log(log, choose_scans(log, anchors, merge.noise), anchors)
    pairs = tuple(_pair(merge, view, names, grids, maps) for view in merge.alignment.pairs)
    agreeing = [pair.agreement for pair in pairs if pair.agreement is not None]
    crossing = [pair.contradictions for pair in pairs if pair.contradictions is not None]
    cycles = _cycles(merge.alignment, sorted(names))
    groups = tuple(
        tuple(names[name].name for name in group.logs) for group in merge.alignment.groups
    )
    return (
        MergeMetrics(
            robots=tuple(source.name for source in names.values()),
            aligned=max(len(group) for group in groups),
            groups=groups,
            pairs=pairs,
            agreement=float(np.mean(agreeing)) if agreeing else None,
            contradictions=float(np.mean(crossing)) if crossing else None,
            cycle_error_m=max((cycle[0] for cycle in cycles), default=None),
            cycle_error_rad=max((cycle[1] for cycle in cycles), default=None),
            parts=measure_parts(merge, names, wholes),
            compared_places=merge.compared,
            seconds=seconds,
        ),
        grids,
    )


def draw_grid(
    graph: JointGraph, name: LogName, anchors: FloatArray, lidar: LidarConfig
) -> OccupancyGrid:
    """The occupancy map of a log. As in `earshot slam`, beams without return say nothing where a
    real scanner may have met glass."""
    log = graph.log(name)
    assert log is not None
    drawn = OccupancyMap(RESOLUTION_M, lidar)
    for number, pose in enumerate(keyframe_poses(log, anchors)):
        scan = log.scan(number)
        if lidar.noise == "none":
            ranges = np.where(scan.hits, scan.ranges, np.nan)
            scan = LaserScan(ranges, scan.angles, scan.max_range_m)
        drawn.add(Pose2.from_array(pose), scan)
    return drawn.grid()


def _pair(
    merge: Merge,
    view: PairView,
    names: dict[LogName, Source],
    grids: dict[LogName, OccupancyGrid],
    maps: dict[LogName, LogMap],
) -> PairMetrics:
    laid = view.overlap
    evidence = PairEvidence(
        matches=len(view.links),
        places=view.places,
        worth=view.worth,
        sightings=view.sightings,
        rival=view.rival,
        hits=laid.hits if laid else None,
        crossing=laid.crossing if laid else None,
        walls_m=laid.walls_m if laid else None,
    )
    found = PairMetrics(
        a=names[view.a].name,
        b=names[view.b].name,
        state=view.state.value,
        reason=view.reason,
        evidence=evidence,
        inliers=len(view.links),
    )
    solution = next(s for s in merge.solutions if view.a in s)
    if view.b not in solution:
        return found
    overlap, agreement = compare_grids(grids[view.a], grids[view.b])
    first = Pose2.from_array(solution[view.a][0])
    return found.model_copy(
        update={
            "overlap": overlap,
            "agreement": agreement,
            "contradictions": lay_over(maps[view.a], maps[view.b]).crossing_mean,
            "transform": PoseModel.of(first.inverse() @ Pose2.from_array(solution[view.b][0])),
        }
    )


def compare_grids(a: OccupancyGrid, b: OccupancyGrid) -> tuple[float | None, float | None]:
    """Overlap and agreement of two maps in one frame, whose cells fall on each other."""
    down = round((b.origin_y - a.origin_y) / a.resolution)
    right = round((b.origin_x - a.origin_x) / a.resolution)
    (height_a, width_a), (height_b, width_b) = a.cells.shape, b.cells.shape
    rows = slice(max(0, down), min(height_a, down + height_b))
    columns = slice(max(0, right), min(width_a, right + width_b))
    if rows.start >= rows.stop or columns.start >= columns.stop:
        return 0.0, None
    ours = a.cells[rows, columns]
    theirs = b.cells[
        rows.start - down : rows.stop - down, columns.start - right : columns.stop - right
    ]
    known = (ours >= 0) & (theirs >= 0)
    same = (ours >= 50) == (theirs >= 50)
    free = known & (ours < 50) & (theirs < 50)
    smaller = min(int(a.free.sum()), int(b.free.sum()))
    return (
        float(free.sum()) / smaller if smaller else None,
        float(same[known].mean()) if known.any() else None,
    )


def _cycles(alignment: Alignment, names: list[LogName]) -> list[tuple[float, float]]:
    """What going round three aligned pairs misses by (m, rad)."""
    missed = []
    for trio in combinations(names, 3):
        views = [alignment.pair(*pair) for pair in pairwise((*trio, trio[0]))]
        round_trip = Pose2(0.0, 0.0, 0.0)
        for view, a in zip(views, trio, strict=True):
            if view is None or view.state is not State.ALIGNED or view.T_a_b is None:
                break
            round_trip = round_trip @ (view.T_a_b if view.a == a else view.T_a_b.inverse())
        else:
            missed.append((math.hypot(round_trip.x, round_trip.y), abs(round_trip.theta)))
    return missed
