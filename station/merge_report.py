"""What `earshot merge` writes: numbers, a table for people, maps, trajectories, and a picture."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.lines import Line2D

from maps.grid import OccupancyGrid, write_map
from protocol.pose import IDENTITY
from robot.team.joint import keyframe_poses
from robot.team.journal import LogName
from robot.team.pair_judge import State
from station.formats import Trajectory, write_text, write_tum
from station.merge import Merge
from station.merge_metrics import MergeMetrics, PairMetrics
from station.merge_sources import Source
from station.pictures import (
    FAINT_INK,
    FREE_COLOUR,
    INK,
    UNKNOWN_COLOUR,
    WIDTH_PX,
    free_box,
    headline,
    new_figure,
    robot_colour,
    save_figure,
    show_cells,
)
from station.wording import NOTHING, percent

PICTURE = "merged.png"
MARGIN_M = 0.6
HEAD_PX, ROW_PX = 100, 34
MAX_MAP_PX = 1500
MAX_ROWS = 20
STATE_COLOURS = {
    State.ALIGNED: "#009E73",
    State.TENTATIVE: "#E69F00",
    State.CONTRADICTORY: "#D55E00",
    State.UNKNOWN: FAINT_INK,
}


def merge_table(metrics: MergeMetrics) -> str:
    """metrics.txt, for people."""
    lines = [f"aligned  {metrics.aligned} of {len(metrics.robots)} robots"]
    lines += [f"  {_words(pair)}" for pair in metrics.pairs]
    if metrics.agreement is not None:
        lines.append(f"agreement  {metrics.agreement:.4f}")
        lines.append(f"contradictions  {percent(metrics.contradictions)}")
    if metrics.cycle_error_m is not None and metrics.cycle_error_rad is not None:
        degrees = np.degrees(metrics.cycle_error_rad)
        lines.append(f"cycles close to  {metrics.cycle_error_m:.4f} m, {degrees:.3f}°")
    for part in metrics.parts:
        degrees = np.degrees(part.placed_rad)
        lines.append(f"{part.name} placed to  {part.placed_m:.4f} m, {degrees:.3f}° of one run")
    lines.append(f"{metrics.compared_places} pairs of places compared, {metrics.seconds:.1f} s")
    return "\n".join(lines) + "\n"


def _words(pair: PairMetrics) -> str:
    agreement = NOTHING if pair.agreement is None else f"{pair.agreement:.3f}"
    return (
        f"{pair.a} – {pair.b}: {pair.state}, {pair.reason} · {pair.inliers} matches at "
        f"{pair.evidence.places} places, next alignment {pair.evidence.rival:.2f} of it · "
        f"overlap {percent(pair.overlap)}, agreement {agreement}, "
        f"contradictions {percent(pair.contradictions)}"
    )


def write_merge(
    merge: Merge,
    metrics: MergeMetrics,
    grids: dict[LogName, OccupancyGrid],
    names: dict[LogName, Source],
    folder: Path,
) -> None:
    """Write metrics.json and .txt, the picture, and of the largest group the map and the keyframes
    of every robot in one frame."""
    write_text(folder / "metrics.json", metrics.model_dump_json(indent=2) + "\n")
    write_text(folder / "metrics.txt", merge_table(metrics))
    largest = max(merge.solutions, key=len)
    for name, anchors in largest.items():
        log = merge.graph.log(name)
        assert log is not None
        poses = keyframe_poses(log, anchors)
        stamps = np.array([float(keyframe.tick) for keyframe in log.keyframes])
        write_tum(Trajectory(stamps, poses), folder / f"{names[name].name}.tum")
    _draw(merge, metrics, grids, names, folder / PICTURE)
    write_map(_joint_grid([grids[name] for name in largest]), folder / "map.yaml")


def _joint_grid(grids: list[OccupancyGrid]) -> OccupancyGrid:
    """Maps in one frame as one: what any of them holds for wall is wall."""
    size = grids[0].resolution
    left = min(grid.origin_x for grid in grids)
    bottom = min(grid.origin_y for grid in grids)
    right = max(grid.origin_x + size * grid.cells.shape[1] for grid in grids)
    top = max(grid.origin_y + size * grid.cells.shape[0] for grid in grids)
    cells = np.full((round((top - bottom) / size), round((right - left) / size)), -1, dtype=np.int8)
    for grid in grids:
        row, column = round((grid.origin_y - bottom) / size), round((grid.origin_x - left) / size)
        height, width = grid.cells.shape
        window = cells[row : row + height, column : column + width]
        np.maximum(window, grid.cells, out=window)
    return OccupancyGrid(cells, size, left, bottom)


def _draw(
    merge: Merge,
    metrics: MergeMetrics,
    grids: dict[LogName, OccupancyGrid],
    names: dict[LogName, Source],
    path: Path,
) -> None:
    """The largest group: the walls of each robot in its colour, and below it how pairs stand."""
    largest = max(merge.solutions, key=len)
    together = _joint_grid([grids[name] for name in largest])
    left, right, bottom, top = free_box(together, MARGIN_M)
    width_px = min(0.94 * WIDTH_PX, MAX_MAP_PX * (right - left) / (top - bottom))
    map_px = width_px * (top - bottom) / (right - left)
    rows = min(len(metrics.pairs), MAX_ROWS)
    foot_px = 60 + ROW_PX * (rows + 1)
    height_px = round(HEAD_PX + map_px + foot_px)
    figure = new_figure(height_px)
    agreement = "" if metrics.agreement is None else f" · agreement {metrics.agreement:.3f}"
    headline(
        figure,
        f"{metrics.aligned} of {len(metrics.robots)} maps merged without known starts",
        f"{metrics.compared_places} pairs of places compared{agreement} · "
        f"contradictions {percent(metrics.contradictions)}",
    )
    place = (0.03, foot_px / height_px, 0.94, map_px / height_px)
    axes: Any = figure.add_axes(place)
    show_cells(axes, together, together.free, colour=FREE_COLOUR, T_world_map=IDENTITY, order=1)
    order = list(names)
    for name in largest:
        colour = robot_colour(order.index(name))
        log = merge.graph.log(name)
        assert log is not None
        grid = grids[name]
        show_cells(axes, grid, grid.occupied, colour=colour, T_world_map=IDENTITY, order=2)
        poses = keyframe_poses(log, largest[name])
        axes.plot(poses[:, 0], poses[:, 1], color=colour, lw=0.8, zorder=3)
        axes.plot(*poses[0, :2], "o", ms=7, mfc="white", mec=colour, mew=2, zorder=4)
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    axes.set(xticks=[], yticks=[], facecolor=UNKNOWN_COLOUR)
    figure.legend(
        handles=[
            Line2D([], [], color=robot_colour(k), lw=2.2, label=names[name].name)
            for k, name in enumerate(order)
        ],
        loc="lower left",
        bbox_to_anchor=(0.03, (foot_px - 50) / height_px),
        ncols=8,
        frameon=False,
        fontsize=8,
        labelcolor=INK,
    )
    for row, pair in enumerate(metrics.pairs[:rows]):
        y = (foot_px - 60 - ROW_PX * (row + 0.5)) / height_px
        colour = STATE_COLOURS[State(pair.state)]
        figure.text(0.03, y, "●", color=colour, size=9, va="center")
        figure.text(0.045, y, _words(pair), color=INK, size=6.6, va="center")
    save_figure(figure, path)
