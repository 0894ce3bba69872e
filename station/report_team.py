"""The picture of the team map: the joint map over the truth, and everybody's way through it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from maps.grid import OccupancyGrid
from protocol.pose import IDENTITY
from station.pictures import (
    FAINT_INK,
    FREE_COLOUR,
    INK,
    TRUE_WALL_COLOUR,
    UNKNOWN_COLOUR,
    WALL_COLOUR,
    WIDTH_PX,
    free_box,
    headline,
    new_figure,
    robot_colour,
    robot_dash,
    save_figure,
    show_cells,
    wall_skin,
)
from station.report_tracks import Track, Tracks

MARGIN_M = 0.6
HEAD_PX = 100
MAX_MAP_PX = 1500
SCALE_BARS_M = (1, 2, 5, 10, 20, 50, 100)
MAX_LEGEND_ROBOTS = 12


def draw_team(
    path: Path,
    *,
    truth: OccupancyGrid,
    joint: OccupancyGrid | None,
    tracks: Tracks,
    labels: Sequence[str],
    title: str,
    subtitle: str,
) -> None:
    """Write team.png. `labels` (one for each track) go to the legend."""
    left, right, bottom, top = free_box(truth, MARGIN_M)
    map_width_px = 0.94 * WIDTH_PX
    map_px = min(MAX_MAP_PX, map_width_px * (top - bottom) / (right - left))
    rows = (min(len(tracks.robots), MAX_LEGEND_ROBOTS) + 2) // 3
    foot_px = 76 + 34 * rows
    height_px = round(HEAD_PX + map_px + foot_px)
    figure = new_figure(height_px)
    headline(figure, title, subtitle)
    axes = figure.add_axes((0.03, foot_px / height_px, 0.94, map_px / height_px))
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    axes.set_axis_off()
    axes.set_facecolor(UNKNOWN_COLOUR)
    axes.add_patch(_background(left, right, bottom, top))
    if joint is not None:
        show_cells(
            axes, joint, joint.free, colour=FREE_COLOUR, T_world_map=tracks.T_world_team, order=1
        )
    show_cells(
        axes, truth, wall_skin(truth), colour=TRUE_WALL_COLOUR, T_world_map=IDENTITY, order=2
    )
    if joint is not None:
        show_cells(
            axes,
            joint,
            joint.occupied,
            colour=WALL_COLOUR,
            T_world_map=tracks.T_world_team,
            order=3,
        )
    axes.set(xlim=(left, right), ylim=(bottom, top))
    for index, track in enumerate(tracks.robots):
        _draw_track(axes, track, index)
    _scale_bar(axes, left, right, bottom)
    _legends(figure, tracks.robots, labels, height_px, joint is not None)
    save_figure(figure, path)


def _background(left: float, right: float, bottom: float, top: float) -> Any:
    return Rectangle((left, bottom), right - left, top - bottom, color=UNKNOWN_COLOUR, zorder=0)


def _draw_track(axes: Any, track: Track, index: int) -> None:
    """A broad band where the robot went, and on it the line where it believes it went."""
    colour = robot_colour(index)
    true = track.true
    axes.plot(true[:, 0], true[:, 1], color=colour, alpha=0.25, lw=4.5, zorder=4)
    if track.belief is not None:
        final, dash = track.belief.final, robot_dash(index)
        axes.plot(final[:, 0], final[:, 1], color=colour, lw=1.1, ls=dash, zorder=5)
    if len(true) == 0:
        return
    axes.plot(*true[0, :2], "o", ms=8, mfc="white", mec=colour, mew=2.2, zorder=7)
    mark = {"marker": "X", "ms": 11} if track.belief is None else {"marker": "s", "ms": 8}
    axes.plot(*true[-1, :2], ls="", mfc=colour, mec="white", mew=1.2, zorder=7, **mark)
    axes.annotate(
        track.name,
        true[-1, :2],
        xytext=(7, 7),
        textcoords="offset points",
        size=8.5,
        weight="bold",
        color=colour,
        zorder=8,
        bbox={"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.8},
    )


def _scale_bar(axes: Any, left: float, right: float, bottom: float) -> None:
    """As long as a round number of metres that is about a sixth of the picture."""
    wanted = (right - left) / 6.0
    length = max((bar for bar in SCALE_BARS_M if bar <= wanted), default=SCALE_BARS_M[0])
    x, y = left + 0.012 * (right - left), bottom + 0.5 * MARGIN_M
    axes.plot([x, x + length], [y, y], color=INK, lw=3, solid_capstyle="butt", zorder=9)
    axes.annotate(
        f"{length} m",
        (x + length, y),
        xytext=(6, 0),
        textcoords="offset points",
        va="center",
        size=8.5,
        color=INK,
        zorder=9,
    )


def _legends(
    figure: Any, tracks: Sequence[Track], labels: Sequence[str], height_px: int, mapped: bool
) -> None:
    robots = [
        Line2D([], [], color=robot_colour(i), ls=robot_dash(i), lw=2.2, label=labels[i])
        for i in range(min(len(tracks), MAX_LEGEND_ROBOTS))
    ]
    if len(tracks) > MAX_LEGEND_ROBOTS:
        robots[-1] = Line2D([], [], ls="", label=f"and {len(tracks) - len(robots) + 1} more")
    grey = FAINT_INK
    key = [
        Patch(fc=WALL_COLOUR, label="wall in the joint map" if mapped else "no joint map"),
        Patch(fc=TRUE_WALL_COLOUR, label="true wall, not mapped"),
        Patch(fc=UNKNOWN_COLOUR, label="unknown"),
        Line2D([], [], alpha=0.3, lw=5, label="true way", color=grey),
        Line2D([], [], lw=1.3, label="estimated way", color=grey),
        Line2D([], [], ls="", marker="o", mfc="white", mec=FAINT_INK, mew=2, label="start"),
        Line2D([], [], ls="", marker="s", mfc=FAINT_INK, mec="white", label="end"),
    ]
    if any(track.belief is None for track in tracks):
        key.append(
            Line2D([], [], ls="", marker="X", ms=9, mfc=FAINT_INK, mec="white", label="no answer")
        )
    shared = {"frameon": False, "fontsize": 8, "borderaxespad": 0.0, "handletextpad": 0.6}
    figure.legend(
        handles=key,
        loc="lower left",
        bbox_to_anchor=(0.03, 14 / height_px),
        ncols=len(key),
        columnspacing=1.4,
        labelcolor=FAINT_INK,
        **shared,
    )
    figure.legend(
        handles=robots,
        loc="lower left",
        bbox_to_anchor=(0.03, 54 / height_px),
        ncols=3,
        columnspacing=2.0,
        labelcolor=INK,
        **shared,
    )
