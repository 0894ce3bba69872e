"""Solving a pose graph that was read from a file, and the same by a peer."""

import importlib.util
import time
from typing import Any

import numpy as np

from protocol.errors import EarshotError
from protocol.model import Model
from protocol.pose import FloatArray
from robot.slam.admission import optimise_admitting
from robot.slam.chordal import chordal_start
from robot.slam.normal_equations import (
    BoolArray,
    IntArray,
    NormalEquations,
    floats,
    integers,
)
from robot.slam.pose_graph import minimise, squared_errors
from station.formats import PoseGraph, chained

PEER_ITERATIONS = 100
SAME_CHI2 = 1e-3
UPPER = np.triu_indices(3)


class GraphError(EarshotError):
    """A graph that cannot be solved as asked; the message says why."""


class PeerFigures(Model):
    chi2: float
    seconds: float
    iterations: int


class FalseClosureFigures(Model):
    """With false closures added: χ² over the edges of the file, and the distance of the nodes (root
    of the mean square) from where they are without the false ones; the same by least squares."""

    added: int
    clean_chi2: float
    clean_seconds: float
    true_chi2: float
    off_m: float
    plain_true_chi2: float
    plain_off_m: float


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
    false_closures: FalseClosureFigures | None = None
    peer: PeerFigures | None = None


def solve(graph: PoseGraph, start: str, robust: bool) -> tuple[GraphFigures, FloatArray]:
    """Figures and solved nodes (m×3); node 0 stays where it is.

    `start` is file, odometry, chordal, or auto: the one of odometry and chordal with less error.
    `robust` starts from odometry. Raises GraphError, PoseGraphError.
    """
    if len(graph.edge_nodes) == 0:
        raise GraphError("the graph has no edge: there is nothing to optimise")
    edges, measured, information, fixed = arrays_of(graph)
    load_kernels()
    began = time.perf_counter()
    refused = 0
    odometry = graph.nodes if start == "file" else _by_odometry(graph)
    if robust:
        doubted = doubted_edges(edges)
        found = optimise_admitting(odometry, edges, measured, information, fixed, doubted)
        solution, refused, name = found.solution, int((~found.accepted).sum()), "odometry"
    else:
        problem = NormalEquations(odometry, edges, measured, information, fixed, None, 1.0)
        starts = {"file" if start == "file" else "odometry": odometry}
        if start in ("auto", "chordal"):
            starts["chordal"] = chordal_start(problem)
        name = min(starts, key=lambda one: problem.chi2(starts[one])) if start == "auto" else start
        solution = minimise(problem, starts[name])
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


def doubted_edges(edges: IntArray) -> BoolArray:
    """Which edges (k) are closures: all but the first one between consecutive nodes."""
    doubted = np.ones(len(edges), dtype=np.bool_)
    steps = np.flatnonzero(np.abs(np.diff(edges, axis=1).ravel()) == 1)
    _, first = np.unique(edges[steps].min(axis=1), return_index=True)
    doubted[steps[first]] = False
    return doubted


def with_false_closures(graph: PoseGraph, share: float, seed: int) -> PoseGraph:
    """The graph with as many false closures appended as `share` of its closures.

    Each ties two random nodes by the translation and information of a random closure of the file,
    as a place taken for another one does, and a random heading.
    """
    rng = np.random.default_rng(seed)
    closures = np.flatnonzero(doubted_edges(integers(graph.edge_nodes)))
    count = round(share * len(closures))
    ends = [np.sort(rng.choice(len(graph.nodes), 2, replace=False)) for _ in range(count)]
    values = graph.edge_values[rng.choice(closures, count)] if count else graph.edge_values[:0]
    values = values.copy()
    values[:, 2] = rng.uniform(-np.pi, np.pi, count)
    return PoseGraph(
        graph.nodes,
        np.vstack([graph.edge_nodes, np.array(ends, dtype=np.int32).reshape(-1, 2)]),
        np.vstack([graph.edge_values, values]),
    )


def among_false(graph: PoseGraph, share: float, seed: int) -> tuple[GraphFigures, FloatArray]:
    """Solve robustly with false closures added, beside the same graph without them."""
    clean, clean_nodes = solve(graph, "auto", robust=False)
    worse = with_false_closures(graph, share, seed)
    edges, measured, information, _ = arrays_of(graph)

    def chi2_of(nodes: FloatArray) -> float:
        return float(squared_errors(nodes, edges, measured, information).sum())

    def off(nodes: FloatArray) -> float:
        return float(np.sqrt(((nodes - clean_nodes)[:, :2] ** 2).sum(axis=1).mean()))

    _, plain_nodes = solve(worse, "auto", robust=False)
    figures, nodes = solve(worse, "odometry", robust=True)
    robust = FalseClosureFigures(
        added=len(worse.edge_nodes) - len(edges),
        clean_chi2=clean.chi2,
        clean_seconds=clean.seconds,
        true_chi2=chi2_of(nodes),
        off_m=off(nodes),
        plain_true_chi2=chi2_of(plain_nodes),
        plain_off_m=off(plain_nodes),
    )
    return figures.model_copy(update={"false_closures": robust}), nodes


def arrays_of(graph: PoseGraph) -> tuple[IntArray, FloatArray, FloatArray, BoolArray]:
    """Edges (k×2), measurements (k×3), information (k×3×3) and which nodes are fixed (m): the
    first."""
    information = np.empty((len(graph.edge_nodes), 3, 3))
    information[:, UPPER[0], UPPER[1]] = graph.edge_values[:, 3:]
    information[:, UPPER[1], UPPER[0]] = graph.edge_values[:, 3:]
    edges, measured = integers(graph.edge_nodes), floats(graph.edge_values[:, :3])
    return edges, measured, information, np.arange(len(graph.nodes)) == 0


def load_kernels() -> None:
    """Reading compiled kernels from the disk takes longer than solving: not a part of the time."""
    nodes, edges = np.zeros((3, 3)), np.array([[0, 1], [1, 2], [0, 2]])
    values = np.tile([1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 1.0], (3, 1))
    _, measured, information, fixed = arrays_of(PoseGraph(nodes, edges.astype(np.int32), values))
    chained(3, edges.astype(np.int32), measured)
    problem = NormalEquations(nodes, edges, measured, information, fixed, None, 1.0)
    minimise(problem, chordal_start(problem))
    doubted = np.array([False, False, True])
    optimise_admitting(nodes, integers(edges), measured, information, fixed, doubted)


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
    """GTSAM from odometry: of its Gauss-Newton and Levenberg-Marquardt the one that ends lower, the
    quicker one if both do. Its time is that of `optimize` alone, without the making of the graph
    and of the start. Its residual is the logarithm: χ² differs a little."""
    gtsam = require_gtsam()
    factors, initial = gtsam.NonlinearFactorGraph(), gtsam.Values()
    nodes = _by_odometry(graph)
    for index, pose in enumerate(nodes):
        initial.insert(index, gtsam.Pose2(*pose))
    edges, measured, information, _ = arrays_of(graph)
    for (i, j), values, weight in zip(edges.tolist(), measured, information, strict=True):
        model = gtsam.noiseModel.Gaussian.Information(weight)
        factors.add(gtsam.BetweenFactorPose2(i, j, gtsam.Pose2(*values), model))
    factors.add(gtsam.NonlinearEqualityPose2(0, gtsam.Pose2(*nodes[0])))
    found = []
    for method, parameters in (
        (gtsam.GaussNewtonOptimizer, gtsam.GaussNewtonParams()),
        (gtsam.LevenbergMarquardtOptimizer, gtsam.LevenbergMarquardtParams()),
    ):
        parameters.setMaxIterations(PEER_ITERATIONS)
        solver = method(factors, initial, parameters)
        began = time.perf_counter()
        try:
            result = solver.optimize()
        except RuntimeError:  # Gauss-Newton may meet a matrix that it cannot factorise
            continue
        seconds = time.perf_counter() - began
        chi2 = 2.0 * float(factors.error(result))
        found.append(PeerFigures(chi2=chi2, seconds=seconds, iterations=int(solver.iterations())))
    lowest = min(one.chi2 for one in found)
    same = [one for one in found if one.chi2 <= lowest * (1.0 + SAME_CHI2)]
    return min(same, key=lambda one: one.seconds)
