"""The picture of a pose graph."""

from pathlib import Path

import numpy as np
from matplotlib.collections import LineCollection

from station.formats import PoseGraph
from station.pictures import (
    FAINT_INK,
    headline,
    new_figure,
    plain_axes,
    robot_colour,
    save_figure,
)

HEIGHT_PX = 1600


def draw_graph(graph: PoseGraph, path: Path, *, title: str, subtitle: str) -> None:
    """Edges between consecutive nodes as the way, the others in grey."""
    figure = new_figure(HEIGHT_PX)
    headline(figure, title, subtitle)
    axes = figure.add_axes((0.06, 0.05, 0.91, 0.86))
    consecutive = np.abs(np.diff(graph.edge_nodes, axis=1).ravel()) == 1
    ends = graph.nodes[graph.edge_nodes][:, :, :2]
    axes.add_collection(LineCollection(list(ends[~consecutive]), colors=FAINT_INK, linewidths=0.4))
    way = LineCollection(list(ends[consecutive]), colors=robot_colour(0), linewidths=0.9)
    axes.add_collection(way)
    axes.autoscale_view()
    axes.set(aspect="equal", xlabel="x (m)", ylabel="y (m)")
    plain_axes(axes)
    save_figure(figure, path)
