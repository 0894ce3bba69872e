"""What all pictures of a run share: colours, figures, and maps as images."""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.transforms import Affine2D
from scipy import ndimage

from maps.grid import BoolArray, OccupancyGrid
from protocol.pose import Pose2

# Okabe and Ito (2008): eight colours that people with any kind of colour vision can tell apart.
# Their yellow is left out, it is unreadable on white, and black is kept for walls.
ROBOT_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
ROBOT_DASHES = ("-", (0, (6, 2)), (0, (2, 1.5)))
INK = "#1b1e23"
FAINT_INK = "#6b7280"
PAPER = "#ffffff"
UNKNOWN_COLOUR = "#e9e7e2"
FREE_COLOUR = "#ffffff"
TRUE_WALL_COLOUR = "#e8a33d"
WALL_COLOUR = "#1b1e23"

WIDTH_PX = 1600
DPI = 160
# The world is solid without end, but a range finder sees only where it begins.
WALL_SKIN_M = 0.05

Rgba = npt.NDArray[np.float64]


def robot_colour(index: int) -> str:
    """The colour of robot number `index`, the same in every picture."""
    return ROBOT_COLOURS[index % len(ROBOT_COLOURS)]


def robot_dash(index: int) -> Any:
    """A line style that tells robots apart which share a colour in a large team."""
    return ROBOT_DASHES[index // len(ROBOT_COLOURS) % len(ROBOT_DASHES)]


def new_figure(height_px: int) -> Figure:
    """An empty figure of `WIDTH_PX` × `height_px`, drawn without a display."""
    figure = Figure(figsize=(WIDTH_PX / DPI, height_px / DPI), dpi=DPI, facecolor=PAPER)
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: Figure, path: Path) -> None:
    """Write a PNG that appears as a whole."""
    partial = path.with_name(f".{path.name}.part")
    figure.savefig(partial, format="png", dpi=DPI)
    partial.replace(path)


def headline(figure: Figure, title: str, subtitle: str) -> None:
    """What is seen, and under which conditions, at the top left."""
    height_px = figure.get_figheight() * DPI
    figure.text(0.03, 1 - 22 / height_px, title, size=13, weight="bold", color=INK, va="top")
    figure.text(0.03, 1 - 62 / height_px, subtitle, size=8.5, color=FAINT_INK, va="top")


def plain_axes(axes: Any) -> None:
    """Two spines, light grid, quiet ticks."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color("#b8bcc4")
    axes.tick_params(colors=FAINT_INK, labelsize=8)
    axes.xaxis.label.set(size=8.5, color=INK)
    axes.yaxis.label.set(size=8.5, color=INK)
    axes.grid(color="#eceef1", linewidth=0.8)
    axes.set_axisbelow(True)


def wall_skin(grid: OccupancyGrid) -> BoolArray:
    """The solid cells (unknown is solid) that lie within `WALL_SKIN_M` of free space."""
    depth = max(1, round(WALL_SKIN_M / grid.resolution))
    near: BoolArray = ndimage.binary_dilation(
        grid.free, structure=np.ones((3, 3), dtype=bool), iterations=depth
    )
    return near & ~grid.free


def show_cells(
    axes: Any,
    grid: OccupancyGrid,
    mask: BoolArray,
    *,
    colour: str,
    T_world_map: Pose2,
    order: int,
) -> None:
    """Paint the cells of `mask` in one colour, where `T_world_map` puts them."""
    red, green, blue = (int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5))
    image: Rgba = np.zeros((*mask.shape, 4))
    image[mask] = (red, green, blue, 1.0)
    height, width = mask.shape
    size = grid.resolution
    extent = (
        grid.origin_x,
        grid.origin_x + width * size,
        grid.origin_y,
        grid.origin_y + height * size,
    )
    placed = (
        Affine2D().rotate(T_world_map.theta).translate(T_world_map.x, T_world_map.y)
        + axes.transData
    )
    axes.imshow(
        image,
        extent=extent,
        origin="lower",
        interpolation="antialiased",
        transform=placed,
        zorder=order,
    )


def free_box(grid: OccupancyGrid, margin_m: float) -> tuple[float, float, float, float]:
    """Left, right, bottom and top (m) of the free space of a map, with a margin."""
    rows, columns = np.nonzero(grid.free)
    if len(rows) == 0:
        rows, columns = (np.arange(size) for size in grid.cells.shape)
    size = grid.resolution
    return (
        grid.origin_x + columns.min() * size - margin_m,
        grid.origin_x + (columns.max() + 1) * size + margin_m,
        grid.origin_y + rows.min() * size - margin_m,
        grid.origin_y + (rows.max() + 1) * size + margin_m,
    )
