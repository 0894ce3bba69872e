"""A picture of where on a map a transmitter is heard, and how well."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.patches import Circle

from maps.grid import BoolArray, OccupancyGrid
from protocol.pose import IDENTITY
from station.pictures import (
    FAINT_INK,
    INK,
    PAPER,
    ROBOT_COLOURS,
    UNKNOWN_COLOUR,
    WALL_COLOUR,
    WIDTH_PX,
    free_box,
    headline,
    new_figure,
    plain_axes,
    save_figure,
    show_cells,
    wall_skin,
)
from world.scenario import GateConfig

HEARD, SHADED, BEYOND = "#9ecae8", "#f6d9c2", "#ffffff"
HEAD_PX, FOOT_PX, SIDE_PX = 110, 120, 110


def draw_coverage(
    grid: OccupancyGrid,
    heard: BoolArray,
    at: tuple[float, float],
    gate: GateConfig,
    title: str,
    path: Path,
) -> None:
    """Write a PNG of `heard` (as `grid.cells`) around a transmitter `at` (x, y in m)."""
    left, right, bottom, top = free_box(grid, margin_m=0.5)
    height_px = (WIDTH_PX - 2 * SIDE_PX) * (top - bottom) / (right - left)
    height_px = int(np.clip(height_px, 300, 2 * WIDTH_PX)) + HEAD_PX + FOOT_PX
    figure = new_figure(height_px)
    headline(figure, title, describe(gate))
    axes = figure.add_axes(
        (
            SIDE_PX / WIDTH_PX,
            FOOT_PX / height_px,
            1 - 2 * SIDE_PX / WIDTH_PX,
            1 - (HEAD_PX + FOOT_PX) / height_px,
        )
    )
    _draw(axes, grid, heard, at, gate.range_m)
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    axes.set_aspect("equal")
    _legend(figure, height_px, gate)
    save_figure(figure, path)


def describe(gate: GateConfig) -> str:
    """The gate in one line."""
    text = f"gate {gate.model}, d = {gate.range_m:g} m"
    if gate.model != "disc":
        text += f", path loss exponent {gate.path_loss_exponent:g}"
    if gate.model == "line-of-sight":
        text += f", walls {gate.wall_loss_db_per_m:g} dB/m"
    if gate.model == "shadowing":
        text += f", σ = {gate.shadowing_sigma_db:g} dB over {gate.shadowing_length_m:g} m"
    return text


def _draw(
    axes: Any, grid: OccupancyGrid, heard: BoolArray, at: tuple[float, float], range_m: float
) -> None:
    rows, columns = np.indices(grid.cells.shape).reshape(2, -1)
    apart = np.hypot(*(grid.to_points(rows, columns) - np.array(at)).T).reshape(grid.cells.shape)
    near = grid.free & (apart <= range_m)
    plain_axes(axes)
    axes.grid(visible=False)
    axes.set_facecolor(UNKNOWN_COLOUR)
    layers = (
        (grid.free & ~near, BEYOND),
        (near & ~heard, SHADED),
        (near & heard, HEARD),
        (wall_skin(grid), WALL_COLOUR),
    )
    for order, (mask, colour) in enumerate(layers):
        show_cells(axes, grid, mask, colour=colour, T_world_map=IDENTITY, order=order)
    rim = Circle(at, range_m, fill=False, edgecolor=INK, linewidth=1.0, linestyle=(0, (5, 4)))
    rim.set_zorder(len(layers))
    axes.add_patch(rim)
    axes.plot(
        *at,
        marker="o",
        markersize=9,
        color=ROBOT_COLOURS[1],
        markeredgecolor=PAPER,
        markeredgewidth=1.5,
        zorder=len(layers) + 1,
    )
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")


def _legend(figure: Any, height_px: int, gate: GateConfig) -> None:
    entries = [(HEARD, "heard"), (BEYOND, "farther than d")]
    if gate.model != "disc":
        why = "walls" if gate.model == "line-of-sight" else "shadowing"
        entries.insert(1, (SHADED, f"within d, lost to {why}"))
    palette = ListedColormap([colour for colour, _ in entries])
    x = SIDE_PX / WIDTH_PX
    for number, (_, label) in enumerate(entries):
        box = figure.add_axes((x, 24 / height_px, 26 / WIDTH_PX, 20 / height_px))
        box.set(xticks=[], yticks=[])
        box.set_facecolor(palette(number))
        for spine in box.spines.values():
            spine.set(color="#b8bcc4", linewidth=0.8)
        figure.text(
            x + 36 / WIDTH_PX, 34 / height_px, label, size=8.5, color=FAINT_INK, va="center"
        )
        x += (100 + len(label) * 11) / WIDTH_PX
