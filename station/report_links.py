"""The picture of the radio: who could talk to whom when, and how much each pair carried."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from maps.grid import BoolArray
from station.pictures import (
    FAINT_INK,
    INK,
    headline,
    new_figure,
    plain_axes,
    robot_colour,
    save_figure,
)
from station.wording import readable_bytes

ROW_PX = 64
MAX_ROWS = 36


def draw_links(
    path: Path,
    *,
    names: Sequence[str],
    links: BoolArray,
    delivered_bytes: npt.NDArray[np.int64],
    tick_s: float,
    title: str,
    subtitle: str,
) -> None:
    """Write links.png.

    `links` T×n×n: within earshot at each tick. `delivered_bytes` n×n: from row to column. A large
    team has more pairs than fit: those that carried most are shown, and the title says so.
    """
    pairs = [(i, j) for i in range(len(names)) for j in range(i + 1, len(names))]
    carried = {pair: int(delivered_bytes[pair] + delivered_bytes[pair[::-1]]) for pair in pairs}
    shown = pairs
    if len(pairs) > MAX_ROWS:
        shown = sorted(sorted(pairs, key=lambda pair: -carried[pair])[:MAX_ROWS])
        subtitle += f" · the {MAX_ROWS} of {len(pairs)} pairs that carried most"
    height_px = 190 + ROW_PX * max(len(shown), 2)
    figure = new_figure(height_px)
    headline(figure, title, subtitle)
    foot, head = 72 / height_px, 118 / height_px
    axes = figure.add_axes((0.10, foot, 0.60, 1 - foot - head))
    plain_axes(axes)
    axes.grid(axis="y", visible=False)
    axes.set_xlim(0.0, max(len(links), 1) * tick_s)
    axes.set_ylim(max(len(shown), 1) - 0.4, -0.6)
    axes.set_xlabel("simulated time (s)")
    axes.set_yticks(range(len(shown)), [f"{names[i]} – {names[j]}" for i, j in shown])
    axes.tick_params(axis="y", length=0, labelsize=9, colors=INK)
    if not shown:
        axes.text(0.5, 0.5, "a single robot has nobody to talk to", transform=axes.transAxes)
    for row, (i, j) in enumerate(shown):
        _draw_row(
            axes, row, links[:, i, j], tick_s=tick_s, upper=robot_colour(i), lower=robot_colour(j)
        )
    amounts = figure.add_axes((0.745, foot, 0.17, 1 - foot - head), sharey=axes)
    _draw_amounts(amounts, shown, delivered_bytes)
    save_figure(figure, path)


def _draw_row(
    axes: Any, row: int, linked: BoolArray, *, tick_s: float, upper: str, lower: str
) -> None:
    """Bars in the colours of both robots, one above the other."""
    axes.axhline(row, color="#eceef1", lw=0.8, zorder=0)
    spans = [(start * tick_s, (end - start) * tick_s) for start, end in spans_of(linked)]
    axes.broken_barh(spans, (row - 0.26, 0.26), color=upper, lw=0)
    axes.broken_barh(spans, (row, 0.26), color=lower, lw=0)
    share = float(linked.mean()) if len(linked) else 0.0
    axes.annotate(
        f"{100 * share:.0f} %",
        (1.0, row),
        xycoords=("axes fraction", "data"),
        xytext=(5, 0),
        textcoords="offset points",
        va="center",
        size=8,
        color=FAINT_INK,
    )


def _draw_amounts(
    axes: Any, shown: Sequence[tuple[int, int]], delivered_bytes: npt.NDArray[np.int64]
) -> None:
    """Bytes delivered in either direction, in the colour of the sender."""
    for side in ("top", "right", "bottom", "left"):
        axes.spines[side].set_visible(False)
    axes.tick_params(left=False, bottom=False, labelleft=False, labelbottom=False)
    axes.set_title("bytes delivered, by sender", size=8.5, color=INK, loc="left")
    most = max([int(delivered_bytes[[i, j], [j, i]].max()) for i, j in shown] + [1])
    axes.set_xlim(0, most)
    for row, (i, j) in enumerate(shown):
        for offset, sender, receiver in ((-0.13, i, j), (0.13, j, i)):
            amount = int(delivered_bytes[sender, receiver])
            axes.barh(row + offset, amount, height=0.24, color=robot_colour(sender))
            axes.annotate(
                readable_bytes(amount),
                (amount, row + offset),
                xytext=(4, 0),
                textcoords="offset points",
                va="center",
                size=7.5,
                color=FAINT_INK,
                annotation_clip=False,
            )


def spans_of(linked: BoolArray) -> list[tuple[int, int]]:
    """Where a series (T) is true, as half-open ranges of its index."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], linked, [False]]).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
