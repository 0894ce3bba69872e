"""The pose graph over submap anchors: edges in growing arrays, node poses derived from them."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from protocol.pose import FloatArray, Pose2
from robot.slam.engine import Closure, GraphSnapshot
from robot.slam.gaussian import carry, invert_spd
from robot.slam.normal_equations import NormalEquations
from robot.slam.pose_graph import minimise

FIRST_CAPACITY = 256
# c² of the kernel by which closures count: 6 σ. They have passed tests of their own, while a chain
# drawn through a narrow door errs more than it claims; at 3 σ it outvoted all that closed the loop.
CAUCHY_SQUARED = 36.0


@dataclass(frozen=True, slots=True)
class Optimised:
    """Nodes (m×3) of the snapshot that was optimised, and the covariance (3×3) of its last one."""

    nodes: FloatArray
    last_covariance: FloatArray


class AnchorGraph:
    """Anchors, each tied by the front end to the one that the robot came from, and by closures;
    anchor 0 is fixed."""

    def __init__(self, start: Pose2) -> None:
        self._nodes = np.empty((FIRST_CAPACITY, 3))
        self._nodes[0] = start.to_array()
        self.count = 1
        self._edge_nodes: npt.NDArray[np.int32] = np.empty((FIRST_CAPACITY, 2), dtype=np.int32)
        self._measurements = np.empty((FIRST_CAPACITY, 3))
        self._information = np.empty((FIRST_CAPACITY, 3, 3))
        self._robust: npt.NDArray[np.bool_] = np.empty(FIRST_CAPACITY, dtype=np.bool_)
        self._edges = 0
        self._optimised = 1
        self._covariance = np.zeros((3, 3))
        self._covariances: dict[int, FloatArray] = {}  # those that were asked for since
        self._parents = [0]
        self._relative = [start.to_array()]
        self._relative_covariance = [np.zeros((3, 3))]

    @property
    def nodes(self) -> FloatArray:
        """`T_map_anchor` (m×3)."""
        return self._nodes[: self.count]

    def pose(self, anchor: int) -> Pose2:
        """`T_map_anchor`."""
        return Pose2.from_array(self._nodes[anchor])

    def covariance(self, anchor: int) -> FloatArray:
        """Covariance (3×3) of an anchor against anchor 0: that of the last one optimised, which
        stands for all of them, and the chain of the front end from there on."""
        if anchor not in self._covariances:
            self._covariances[anchor] = self._chained_covariance(anchor)
        return self._covariances[anchor]

    def _chained_covariance(self, anchor: int) -> FloatArray:
        chain = []
        while anchor >= self._optimised:
            chain.append(anchor)
            anchor = self._parents[anchor]
        turn = self._nodes[anchor, 2] - self._nodes[self._optimised - 1, 2]
        covariance = carry(self._covariance, Pose2(0.0, 0.0, turn))
        for n in reversed(chain):
            covariance = carry(covariance, Pose2.from_array(self._relative[n]))
            covariance = covariance + self._relative_covariance[n]
        return covariance

    def add_anchor(self, of: int, T_of_anchor: Pose2, information: FloatArray) -> None:
        """A new anchor, as the front end measured it against the one that the robot comes from."""
        if self.count == len(self._nodes):
            self._nodes = np.concatenate([self._nodes, np.empty_like(self._nodes)])
        self._nodes[self.count] = (self.pose(of) @ T_of_anchor).to_array()
        self._parents.append(of)
        self._relative.append(T_of_anchor.to_array())
        self._relative_covariance.append(invert_spd(information))
        self.count += 1
        self._add_edge(of, self.count - 1, T_of_anchor, information, False)

    def add_closure(self, closure: Closure) -> None:
        """A verified loop closure; it counts by a robust kernel."""
        self._add_edge(closure.of, closure.to, closure.T_of_to, closure.information, True)

    def snapshot(self) -> tuple[GraphSnapshot, npt.NDArray[np.bool_]]:
        """Copies of nodes and edges, and which edges are closures."""
        k = self._edges
        graph = GraphSnapshot(
            self.nodes.copy(),
            self._edge_nodes[:k].copy(),
            self._measurements[:k].copy(),
            self._information[:k].copy(),
        )
        return graph, self._robust[:k].copy()

    def apply(self, optimised: Optimised) -> None:
        """Take optimised nodes; anchors that are newer follow by the front end's own chain."""
        m = len(optimised.nodes)
        self._nodes[:m] = optimised.nodes
        for n in range(m, self.count):
            T_of_anchor = Pose2.from_array(self._relative[n])
            self._nodes[n] = (self.pose(self._parents[n]) @ T_of_anchor).to_array()
        self._optimised = m
        self._covariance = optimised.last_covariance
        self._covariances = {}

    def _add_edge(
        self, of: int, to: int, T_of_to: Pose2, information: FloatArray, robust: bool
    ) -> None:
        k = self._edges
        if k == len(self._edge_nodes):
            self._edge_nodes = np.concatenate([self._edge_nodes, np.empty_like(self._edge_nodes)])
            self._measurements = np.concatenate(
                [self._measurements, np.empty_like(self._measurements)]
            )
            self._information = np.concatenate(
                [self._information, np.empty_like(self._information)]
            )
            self._robust = np.concatenate([self._robust, np.empty_like(self._robust)])
        self._edge_nodes[k] = (of, to)
        self._measurements[k] = T_of_to.to_array()
        self._information[k] = information
        self._robust[k] = robust
        self._edges += 1


def optimise_anchors(
    graph: GraphSnapshot,
    robust: npt.NDArray[np.bool_],
    closures: tuple[Closure, ...],
    max_iterations: int,
) -> Optimised:
    """Optimise a snapshot with new closures added. Pure: may run as a job."""
    edge_nodes = np.concatenate(
        [
            graph.edge_nodes,
            np.array([[c.of, c.to] for c in closures], dtype=np.int32).reshape(-1, 2),
        ]
    )
    measurements = np.concatenate(
        [graph.measurements, np.array([c.T_of_to.to_array() for c in closures]).reshape(-1, 3)]
    )
    information = np.concatenate(
        [graph.information, np.array([c.information for c in closures]).reshape(-1, 3, 3)]
    )
    robust = np.concatenate([robust, np.ones(len(closures), dtype=np.bool_)])
    fixed = np.zeros(len(graph.nodes), dtype=np.bool_)
    fixed[0] = True
    problem = NormalEquations(
        graph.nodes, edge_nodes, measurements, information, fixed, robust, CAUCHY_SQUARED
    )
    solution = minimise(problem, problem.nodes, max_iterations)
    if problem.linearised_at is not solution.nodes:
        problem.linearise(solution.nodes)
    problem.factorise()
    covariance = problem.covariance(len(solution.nodes) - 1)
    return Optimised(solution.nodes, covariance)
