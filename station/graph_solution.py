"""Solving a pose graph that was read from a file, and the same by a peer."""

import importlib.util
import time
from typing import Any

import numpy as np

from protocol.errors import EarshotError
from protocol.model import Model
from protocol.pose import FloatArray
from robot.slam.chordal import chordal_start
from robot.slam.graduated import optimise_graduated
from robot.slam.pose_graph import optimise, squared_errors
from station.formats import PoseGraph, chained

PEER_ITERATIONS = 100
UPPER = np.triu_indices(3)


class GraphError(EarshotError):
    """A graph that cannot be solved as asked; the message says why."""


class PeerFigures(Model):
    chi2: float
    seconds: float
    iterations: int


class GraphFigures(Model):
    """metrics.json of `earshot optimise`. `chi2` is Σ eᵀΩe over the edges that count, `seconds`
    the time from the read file to the solution."""

    nodes: int
    edges: int
    start: str
    chi2: float
    seconds: float
    iterations: int
    converged: bool
    refused: int = 0
    peer: PeerFigures | None = None


def solve(graph: PoseGraph, start: str, robust: bool) -> tuple[GraphFigures, FloatArray]:
    """Figures and solved nodes (m×3); node 0 stays where it is.

    `start` is file, odometry, chordal, or auto: the one of odometry and chordal with less error,
    odometry alone for `robust`, since one false edge bends a chordal start. Raises GraphError,
    PoseGraphError.
    """
    if len(graph.edge_nodes) == 0:
        raise GraphError("the graph has no edge: there is nothing to optimise")
    edges, measured = graph.edge_nodes, np.ascontiguousarray(graph.edge_values[:, :3])
    information = np.empty((len(edges), 3, 3))
    information[:, UPPER[0], UPPER[1]] = graph.edge_values[:, 3:]
    information[:, UPPER[1], UPPER[0]] = graph.edge_values[:, 3:]
    fixed = np.arange(len(graph.nodes)) == 0

    _load_kernels()
    began = time.perf_counter()
    starts: dict[str, FloatArray] = {}
    if start == "file":
        starts["file"] = graph.nodes
    if start in ("auto", "odometry"):
        starts["odometry"] = _by_odometry(graph)
    if start == "chordal" or (start == "auto" and not robust):
        starts["chordal"] = chordal_start(graph.nodes, edges, measured, information, fixed)
    name = min(
        starts,
        key=lambda one: float(squared_errors(starts[one], edges, measured, information).sum()),
    )
    refused = 0
    if robust:
        doubted = np.abs(np.diff(edges, axis=1).ravel()) != 1
        found = optimise_graduated(starts[name], edges, measured, information, fixed, doubted)
        solution, refused = found.solution, int((found.weights == 0.0).sum())
    else:
        solution = optimise(starts[name], edges, measured, information, fixed)
    seconds = time.perf_counter() - began
    figures = GraphFigures(
        nodes=len(graph.nodes),
        edges=len(edges),
        start=name,
        chi2=solution.chi2,
        seconds=seconds,
        iterations=solution.iterations,
        converged=solution.converged,
        refused=refused,
    )
    return figures, solution.nodes


def _load_kernels() -> None:
    """Reading compiled kernels from the disk takes longer than solving: not a part of the time."""
    nodes, edges = np.zeros((3, 3)), np.array([[0, 1], [1, 2], [0, 2]])
    optimise(nodes, edges, np.ones((3, 3)), np.tile(np.eye(3), (3, 1, 1)), np.arange(3) == 0)


def _by_odometry(graph: PoseGraph) -> FloatArray:
    """Chained edges; a node that none reaches stands where the file has it."""
    nodes = chained(len(graph.nodes), graph.edge_nodes, graph.edge_values[:, :3], graph.nodes[0])
    return np.where(np.isnan(nodes), graph.nodes, nodes)


def require_gtsam() -> Any:
    """The library; raises GraphError when it is not installed."""
    if importlib.util.find_spec("gtsam") is None:
        raise GraphError("--peer gtsam: GTSAM is not installed; `pip install gtsam` installs it")
    return importlib.import_module("gtsam")


def peer_gtsam(graph: PoseGraph) -> PeerFigures:
    """GTSAM's Levenberg-Marquardt, from odometry. Its time is that of `optimize` alone, without the
    making of the graph and of the start. Its residual is the logarithm: χ² differs a little."""
    gtsam = require_gtsam()
    factors, initial = gtsam.NonlinearFactorGraph(), gtsam.Values()
    nodes = _by_odometry(graph)
    for index, pose in enumerate(nodes):
        initial.insert(index, gtsam.Pose2(*pose))
    for (i, j), values in zip(graph.edge_nodes.tolist(), graph.edge_values, strict=True):
        information = np.empty((3, 3))
        information[UPPER] = information.T[UPPER] = values[3:]
        model = gtsam.noiseModel.Gaussian.Information(information)
        factors.add(gtsam.BetweenFactorPose2(i, j, gtsam.Pose2(*values[:3]), model))
    factors.add(gtsam.NonlinearEqualityPose2(0, gtsam.Pose2(*nodes[0])))
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(PEER_ITERATIONS)
    solver = gtsam.LevenbergMarquardtOptimizer(factors, initial, parameters)
    began = time.perf_counter()
    result = solver.optimize()
    return PeerFigures(
        chi2=2.0 * float(factors.error(result)),
        seconds=time.perf_counter() - began,
        iterations=int(solver.iterations()),
    )
