"""What is written of a log that was played: numbers, the files of other tools, and a picture."""

from pathlib import Path

import numpy as np
from pydantic import Field

from maps.grid import OccupancyGrid, write_map
from maps.pixels import write_whole
from protocol.model import Model
from protocol.pose import IDENTITY, FloatArray
from robot.mapping.occupancy import OccupancyMap
from robot.perception.scan import LaserScan
from robot.slam.engine import GraphSnapshot
from station.formats import PoseGraph, Trajectory, write_g2o, write_text, write_tum
from station.memory_use import peak_rss_mb
from station.pictures import (
    FREE_COLOUR,
    UNKNOWN_COLOUR,
    WALL_COLOUR,
    WIDTH_PX,
    free_box,
    headline,
    new_figure,
    robot_colour,
    save_figure,
    show_cells,
)
from station.relations import ReferenceErrors, RelationErrors
from station.replay import Found, Replay, ReplaySettings
from station.report_folder import SAVED_MAP
from station.wording import clock_time

PICTURE = "map.png"
RESOLUTION_M = 0.05
MARGIN_M = 0.6
HEAD_PX = 100
MAX_MAP_PX = 1500
UPPER = np.triu_indices(3)


class LocalisationMetrics(Model):
    """How localisation in a known map went, see `station.replay.Found`."""

    settled: bool
    first_settled_scan: int | None
    first_settled_m: float | None
    losses: int


class ReplayMetrics(Model):
    """metrics.json. Times are those of one core, in `ms_per_scan` with all that a scan needs."""

    log: str
    settings: ReplaySettings
    scans: int
    log_s: float
    driven_m: float
    relations: RelationErrors | None
    reference: ReferenceErrors | None
    ate_rmse_m: float | None
    rpe_m: float | None
    ms_per_scan: float
    ms_p999: float
    ms_max: float
    peak_rss_mb: float | None
    loop_closures: int
    anchors: int
    map_hash: str | None = Field(description="of the saved map; None where none was made")
    localisation: LocalisationMetrics | None = None


def measure_replay(
    log: Path,
    settings: ReplaySettings,
    replay: Replay,
    relations: RelationErrors | None,
    reference: ReferenceErrors | None,
) -> ReplayMetrics:
    steps = np.diff(replay.poses[:, :2], axis=0)
    return ReplayMetrics(
        log=log.name,
        settings=settings,
        scans=len(replay.played),
        log_s=float(replay.stamps[-1] - replay.stamps[0]),
        driven_m=float(np.hypot(steps[:, 0], steps[:, 1]).sum()),
        relations=relations,
        reference=reference,
        ate_rmse_m=None if reference is None else reference.ate_rmse_m,
        rpe_m=None if reference is None else reference.rpe_m,
        ms_per_scan=1e3 * replay.wall_s / len(replay.played),
        ms_p999=1e3 * float(np.quantile(replay.step_s, 0.999)),
        ms_max=1e3 * float(replay.step_s.max()),
        peak_rss_mb=peak_rss_mb(),
        loop_closures=replay.loop_closures,
        anchors=len(replay.graph.nodes),
        map_hash=replay.saved.digest() if replay.saved else None,
        localisation=_localisation(replay.found) if replay.found else None,
    )


def _localisation(found: Found) -> LocalisationMetrics:
    return LocalisationMetrics(
        settled=found.settled,
        first_settled_scan=found.scan,
        first_settled_m=None if found.scan is None else found.driven_m,
        losses=found.losses,
    )


def replay_table(metrics: ReplayMetrics) -> str:
    """metrics.txt, for people."""
    rows = [
        ("log", f"{metrics.log}, {clock_time(metrics.log_s)} (min:s), {metrics.driven_m:.0f} m"),
        ("played", _played(metrics.settings)),
        ("scans", str(metrics.scans)),
        ("loop closures", str(metrics.loop_closures)),
        ("anchors", str(metrics.anchors)),
        ("a scan takes", f"{metrics.ms_per_scan:.2f} ms"),
        ("slowest scans", f"p99.9 {metrics.ms_p999:.1f} ms, worst {metrics.ms_max:.1f} ms"),
    ]
    if (place := metrics.localisation) is not None:
        known = "undecided where it is"
        if place.first_settled_m is not None:
            known = f"known from {place.first_settled_m:.1f} m on, lost {place.losses} times"
        rows.append(("place", known))
    if metrics.peak_rss_mb is not None:
        rows.append(("peak memory", f"{metrics.peak_rss_mb:.0f} MB"))
    if (found := metrics.relations) is not None:
        rows += [
            ("relations", f"{found.used} of {found.given}"),
            (
                "  translation",
                f"{found.translation_mean_m:.4f} ± {found.translation_std_m:.4f} m",
            ),
            ("  rotation", f"{found.rotation_mean_deg:.3f} ± {found.rotation_std_deg:.3f}°"),
        ]
    if (found_at := metrics.reference) is not None:
        rpe = "" if found_at.rpe_m is None else f", RPE over 1 m {found_at.rpe_m:.4f} m"
        rows.append(("reference", f"{found_at.used} poses, ATE {found_at.ate_rmse_m:.4f} m{rpe}"))
    width = max(len(what) for what, _ in rows)
    return "".join(f"{what:<{width}}  {value}\n" for what, value in rows)


def write_replay(replay: Replay, metrics: ReplayMetrics, folder: Path) -> None:
    """Write metrics.json and .txt, trajectory.tum, odometry.tum, graph.g2o, map.yaml with map.pgm,
    the picture, and the map as it can be loaded again."""
    write_text(folder / "metrics.json", metrics.model_dump_json(indent=2) + "\n")
    write_text(folder / "metrics.txt", replay_table(metrics))
    write_tum(Trajectory(replay.stamps, replay.poses), folder / "trajectory.tum")
    write_tum(Trajectory(replay.stamps, replay.odometry), folder / "odometry.tum")
    write_g2o(_pose_graph(replay.graph), folder / "graph.g2o")
    if replay.saved is not None:
        write_whole(folder / SAVED_MAP, replay.saved.encode())
    grid = draw_map(replay)
    if grid.cells.size:
        write_map(grid, folder / "map.yaml")
        _draw(grid, replay.poses, metrics, folder / PICTURE)


def draw_map(replay: Replay) -> OccupancyGrid:
    """The occupancy map of the keyframes. Beams without return say nothing here: a real scanner
    also answers so where glass or a dark wall stands."""
    occupancy = OccupancyMap(RESOLUTION_M, replay.lidar)
    for pose, scan in replay.keyframes:
        ranges = np.where(np.isfinite(scan.ranges), scan.ranges, np.nan)
        occupancy.add(pose, LaserScan(ranges, scan.angles, scan.max_range_m))
    return occupancy.grid()


def _pose_graph(graph: GraphSnapshot) -> PoseGraph:
    upper = graph.information[:, UPPER[0], UPPER[1]]
    values = np.hstack([graph.measurements, upper])
    return PoseGraph(graph.nodes, graph.edge_nodes.astype(np.int32), values)


def _played(settings: ReplaySettings) -> str:
    changes = [
        (settings.reverse, "backwards"),
        (settings.every > 1, f"every {settings.every}th scan"),
        (settings.odometry_scale != 1.0, f"odometry × {settings.odometry_scale:g}"),
        (settings.turn_error != 0.0, f"turns {100 * settings.turn_error:+g} %"),
        (
            settings.range_noise_m > 0.0,
            f"range noise {settings.range_noise_m:g} m (seed {settings.seed})",
        ),
    ]
    told = ", ".join(what for is_so, what in changes if is_so) or "as it is"
    return f"{told}, by {settings.engine}"


def _draw(grid: OccupancyGrid, poses: FloatArray, metrics: ReplayMetrics, path: Path) -> None:
    left, right, bottom, top = free_box(grid, MARGIN_M)
    map_px = min(MAX_MAP_PX, 0.94 * WIDTH_PX * (top - bottom) / (right - left))
    height_px = round(HEAD_PX + map_px + 30)
    figure = new_figure(height_px)
    headline(
        figure,
        f"{metrics.log}: {metrics.scans} scans, {metrics.driven_m:.0f} m",
        f"{_played(metrics.settings)} · {metrics.loop_closures} loop closures · "
        f"{metrics.ms_per_scan:.2f} ms a scan",
    )
    axes = figure.add_axes((0.03, 30 / height_px, 0.94, map_px / height_px))
    for mask, colour, order in ((grid.free, FREE_COLOUR, 1), (grid.occupied, WALL_COLOUR, 2)):
        show_cells(axes, grid, mask, colour=colour, T_world_map=IDENTITY, order=order)
    axes.plot(poses[:, 0], poses[:, 1], color=robot_colour(0), lw=0.8, zorder=3)
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    axes.set(xticks=[], yticks=[], facecolor=UNKNOWN_COLOUR)
    save_figure(figure, path)
