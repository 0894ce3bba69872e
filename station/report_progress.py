"""The picture of a run over time: how much is known, and how well each robot knows where it is."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter

from protocol.pose import FloatArray
from station.pictures import (
    FAINT_INK,
    INK,
    headline,
    new_figure,
    plain_axes,
    robot_colour,
    robot_dash,
    save_figure,
)
from station.report_tracks import Track
from world.report_log import ReportLog

HEIGHT_PX = 1150
# A line of more points than this shows no more on 1600 pixels.
MAX_POINTS = 800
MAX_LEGEND = 20
# Below a millimetre an error is rounding; a logarithm of it would stretch the picture for nothing.
FLOOR_M = 1e-3


def draw_progress(
    path: Path,
    *,
    tracks: Sequence[Track],
    reports: Mapping[str, ReportLog],
    coverage: Sequence[tuple[float, float]],
    target_m2: float | None,
    tick_s: float,
    title: str,
    subtitle: str,
) -> None:
    """Write progress.png.

    Above: the area (m²) that each robot's joint map knows, by its reports, and the share of the
    building covered at the moments when that was measured (`coverage`: s, share). Below: position
    errors (m, logarithmic): at each tick's own time, as optimised at the end, and of dead
    reckoning.
    """
    figure = new_figure(HEIGHT_PX)
    headline(figure, title, subtitle)
    end_s = max([float(track.stamps[-1]) for track in tracks if len(track.stamps)] + [tick_s])
    above = figure.add_axes((0.065, 0.515, 0.755, 0.355))
    below = figure.add_axes((0.065, 0.075, 0.755, 0.355))
    for axes in (above, below):
        plain_axes(axes)
        axes.set_xlim(0.0, end_s)
    _draw_known(above, tracks, reports, target_m2=target_m2, tick_s=tick_s, covered=bool(coverage))
    if coverage and target_m2 is not None:
        _draw_coverage(above, coverage, target_m2)
    _draw_errors(below, tracks)
    save_figure(figure, path)


def _draw_known(
    axes: Any,
    tracks: Sequence[Track],
    reports: Mapping[str, ReportLog],
    *,
    target_m2: float | None,
    tick_s: float,
    covered: bool,
) -> None:
    axes.set_title(
        "Area known to each robot, from its own scans and its teammates'",
        loc="left",
        size=9.5,
        color=INK,
    )
    axes.set_ylabel("known area (m²)")
    most = target_m2 or 1.0
    for index, track in enumerate(tracks):
        log = reports.get(track.name)
        if log:
            times, areas = log.ticks * tick_s, log.known_m2
            most = max(most, float(areas.max()))
            axes.plot(times, areas, color=robot_colour(index), ls=robot_dash(index), lw=1.8)
    if not any(reports.get(track.name) for track in tracks):
        _say(axes, "no robot reported anything")
    axes.set_ylim(0.0, 1.08 * most)
    if target_m2 is not None:
        axes.axhline(target_m2, color=FAINT_INK, lw=1, ls=(0, (4, 3)))
        axes.annotate(
            f"where a robot can get to: {target_m2:.0f} m²",
            (0.0, target_m2),
            xytext=(6, 4),
            textcoords="offset points",
            size=8,
            color=FAINT_INK,
        )
    handles = [
        Line2D([], [], color=robot_colour(i), ls=robot_dash(i), lw=2, label=track.name)
        for i, track in enumerate(tracks[:MAX_LEGEND])
    ]
    if covered:
        handles.append(
            Line2D([], [], color=INK, lw=1.2, marker="o", ms=3, label="the team's\ncoverage")
        )
    axes.legend(
        handles=handles, loc="upper left", bbox_to_anchor=(1.06, 1.0), frameon=False, fontsize=8.5
    )


def _draw_coverage(axes: Any, coverage: Sequence[tuple[float, float]], target_m2: float) -> None:
    """On an axis of its own, on which the whole target is level with its area."""
    times, shares = np.array(coverage).T
    right = axes.twinx()
    right.set_ylim(0.0, 100.0 * axes.get_ylim()[1] / target_m2)
    right.plot(times, 100.0 * shares, color=INK, lw=1.2, marker="o", ms=3)
    right.set_ylabel("covered correctly by the team (%)", size=8.5, color=INK)
    right.tick_params(colors=FAINT_INK, labelsize=8)
    for side in ("top", "left", "bottom"):
        right.spines[side].set_visible(False)
    right.spines["right"].set_color("#b8bcc4")


def _draw_errors(axes: Any, tracks: Sequence[Track]) -> None:
    axes.set_title(
        "Position error against the truth (one alignment for the team, one for dead reckoning)",
        loc="left",
        size=9.5,
        color=INK,
    )
    axes.set_xlabel("simulated time (s)")
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(FuncFormatter(_length))
    axes.yaxis.set_minor_formatter(FuncFormatter(lambda *_: ""))
    lowest, highest = 0.01, 0.1
    for index, track in enumerate(tracks):
        belief = track.belief
        if belief is None:
            continue
        colour = robot_colour(index)
        styles = (
            (belief.dead_reckoned, {"lw": 1.0, "ls": (0, (1, 1.6))}),
            (belief.online, {"lw": 0.8, "alpha": 0.45}),
            (belief.final, {"lw": 1.8}),
        )
        for poses, style in styles:
            stamps, errors = _thinned(belief.stamps, np.maximum(belief.error_m(poses), FLOOR_M))
            axes.plot(stamps, errors, color=colour, **style)
            lowest = min(lowest, float(np.quantile(errors, 0.02)))
            highest = max(highest, float(errors.max()))
    axes.set_ylim(max(FLOOR_M, 0.7 * lowest), 1.5 * highest)
    if all(track.belief is None for track in tracks):
        _say(axes, "no robot answered with its trajectory")
    key = [
        Line2D([], [], color=FAINT_INK, lw=2, label="as optimised\nat the end"),
        Line2D([], [], color=FAINT_INK, lw=1, alpha=0.6, label="online, at\nits own tick"),
        Line2D([], [], color=FAINT_INK, lw=1.2, ls=(0, (1, 1.6)), label="dead\nreckoning"),
    ]
    axes.legend(
        handles=key,
        loc="upper left",
        bbox_to_anchor=(1.06, 1.0),
        frameon=False,
        fontsize=8.5,
        labelspacing=0.9,
    )


def _thinned(times: FloatArray, errors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """At most `MAX_POINTS`, each the largest of its stretch, so that no peak is lost."""
    stretch = -(-len(errors) // MAX_POINTS)
    if stretch <= 1:
        return times, errors
    whole = len(errors) // stretch * stretch
    return times[:whole:stretch], errors[:whole].reshape(-1, stretch).max(axis=1)


def _length(metres: float, _: object = None) -> str:
    if metres < 0.01:
        return f"{1000 * metres:g} mm"
    return f"{100 * metres:g} cm" if metres < 1.0 else f"{metres:g} m"


def _say(axes: Any, what: str) -> None:
    axes.text(0.5, 0.5, what, transform=axes.transAxes, ha="center", color=FAINT_INK, size=11)
