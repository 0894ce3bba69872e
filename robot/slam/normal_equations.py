"""The normal equations of a pose graph, in a sparse pattern that is built once.

H = Σ JᵀΩJ in 3×3 blocks, one for every pose and every pair of poses that an edge ties, written by
a kernel at each linearisation.
"""

import numpy as np
import numpy.typing as npt

from protocol.errors import EarshotError
from protocol.pose import FloatArray
from robot.slam import chain_kernels, chordal_kernels, edge_kernels, normal_equation_kernels
from robot.slam.block_cholesky import BlockCholesky

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]


class PoseGraphError(EarshotError):
    """A graph that cannot be solved as it is; the message says which node or array is at fault."""


class NormalEquations:
    """A graph with the pattern of its normal equations, linearised as often as wanted.

    `nodes` m×3, `edge_nodes` k×2, `measurements` k×3 (`T_i_j`), `information` k×3×3, `fixed` m,
    `robust` k: which edges count by Cauchy's kernel. `weights` (k, all 1 at first) may be changed
    between linearisations: each edge counts so many times, not at all with 0.

    Raises PoseGraphError when arrays do not fit, or a component has no fixed node.
    """

    def __init__(
        self,
        nodes: FloatArray,
        edge_nodes: npt.NDArray[np.integer],
        measurements: FloatArray,
        information: FloatArray,
        fixed: BoolArray,
        robust: BoolArray | None,
        cauchy_squared: float,
    ) -> None:
        self.nodes = floats(nodes)
        self.edge_nodes = integers(edge_nodes)
        self.measurements = floats(measurements)
        self.information = floats(information)
        k = len(self.edge_nodes)
        self.weights = np.ones(k)
        self._robust = np.array(np.zeros(k) if robust is None else robust, dtype=np.bool_)
        self.is_robust = bool(self._robust.any())
        self._cauchy2 = cauchy_squared
        self._check(fixed)
        self.free = ~np.asarray(fixed, dtype=bool)
        count = int(self.free.sum())
        self.size = 3 * count
        places = np.where(self.free, np.cumsum(self.free) - 1, -1)
        ends = places[self.edge_nodes.reshape(-1, 2)]
        inner = (ends >= 0).all(axis=1)
        self._factor = BlockCholesky(count, ends[inner])
        self.blocks: IntArray = np.full(len(self.nodes), -1, dtype=np.int64)
        self.blocks[self.free] = self._factor.order
        self._slots: IntArray = np.zeros(k, dtype=np.int64)
        self._slots[inner] = self._factor.slots
        self._diagonal = np.zeros((count, 9))
        self._lower = np.zeros((self._factor.lower_count, 9))
        self.gradient = np.zeros((count, 3))
        """−g (count×3), in the order of `blocks`."""
        self.linearised_at: FloatArray | None = None
        """The nodes at which the equations were taken last."""

    def chi2(self, nodes: FloatArray) -> float:
        """Σ eᵀΩe, by weight."""
        return float(self.weights @ self.squared_errors(nodes))

    def squared_errors(self, nodes: FloatArray) -> FloatArray:
        """eᵀΩe (k)."""
        out = np.empty(len(self.edge_nodes))
        edge_kernels.squared_errors(
            nodes, self.edge_nodes, self.measurements, self.information, out
        )
        return out

    def linearise(self, nodes: FloatArray) -> float:
        """Take the normal equations at these nodes. The cost there: Σ eᵀΩe by weight, robust edges
        by their kernel."""
        self.linearised_at = nodes
        return float(
            normal_equation_kernels.linearise(
                nodes,
                self.edge_nodes,
                self.measurements,
                self.information,
                self.weights,
                self._robust,
                self._cauchy2,
                self.blocks,
                self._slots,
                self._diagonal,
                self._lower,
                self.gradient,
            )
        )

    def linearise_headings(self, nodes: FloatArray) -> None:
        """Those of the headings as complex numbers of any length (see `chordal`)."""
        self.linearised_at = None
        chordal_kernels.linearise_headings(nodes, *self._arrays())

    def place(self, nodes: FloatArray) -> FloatArray:
        """The nodes with the positions that suit their headings best; as they are where the
        positions are not determined. Edges count by weight, without a kernel."""
        self.linearised_at = None
        chordal_kernels.linearise_positions(nodes, *self._arrays())
        positions = self.solve()
        placed = nodes.copy()
        if positions is not None:
            placed[self.free, :2] = positions[self.blocks[self.free], :2]
        return placed

    def solve(self, damping: float = 0.0) -> FloatArray | None:
        """What solves the equations as they stand (count×3, in the order of `blocks`); None where
        the damped matrix is not positive definite."""
        if not self._factor.factorise(self._diagonal, self._lower, damping):
            return None
        return self._factor.solve(self.gradient)

    def factorise(self) -> None:
        """Make `covariance` ready at the last linearisation. Raises PoseGraphError on a matrix that
        is not positive definite."""
        if not self._factor.factorise(self._diagonal, self._lower):
            raise PoseGraphError("the information of the edges does not hold all nodes")

    def covariance(self, node: int) -> FloatArray:
        """Marginal covariance (3×3, tangent space at the node), once factorised."""
        block = int(self.blocks[node])
        if block < 0:
            return np.zeros((3, 3))
        return self._factor.spread(block, np.eye(3), -1, np.zeros((3, 3)))

    def innovations(
        self,
        nodes: FloatArray,
        edge_nodes: IntArray,
        measurements: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Errors (q×3) of measured `T_i_j`, and the covariances (q×3×3) that the graph gives them
        without the measurements' own; once factorised."""
        errors, covariances = np.empty((len(edge_nodes), 3)), np.empty((len(edge_nodes), 3, 3))
        starts, rows, factor, inverses, work = self._factor.factor
        normal_equation_kernels.innovations(
            nodes,
            edge_nodes,
            measurements,
            self.blocks,
            starts,
            rows,
            factor,
            inverses,
            work,
            errors,
            covariances,
        )
        return errors, covariances

    def retract(self, nodes: FloatArray, step: FloatArray) -> FloatArray:
        """The nodes moved by a step (count×3)."""
        out = np.empty_like(nodes)
        normal_equation_kernels.retract(nodes, self.blocks, step, out)
        return out

    def _arrays(self) -> tuple[npt.NDArray[np.generic], ...]:
        return (
            self.edge_nodes,
            self.measurements,
            self.information,
            self.weights,
            self.blocks,
            self._slots,
            self._diagonal,
            self._lower,
            self.gradient,
        )

    def _check(self, fixed: BoolArray) -> None:
        m, k = len(self.nodes), len(self.edge_nodes)
        shapes = (
            self.nodes.shape == (m, 3)
            and self.edge_nodes.shape == (k, 2)
            and self.measurements.shape == (k, 3)
            and self.information.shape == (k, 3, 3)
            and np.shape(fixed) == (m,)
            and self._robust.shape == (k,)
        )
        if not shapes:
            raise PoseGraphError(
                "a pose graph takes nodes m×3, edge_nodes k×2, measurements k×3, "
                "information k×3×3, fixed m and robust k"
            )
        fault, place = chain_kernels.first_fault(m, self.edge_nodes, np.array(fixed, dtype=bool))
        if fault == 1:
            raise PoseGraphError(f"an edge names a node outside 0…{m - 1}")
        if fault == 2:
            raise PoseGraphError("an edge ties a node to itself")
        if fault == 3:
            raise PoseGraphError(f"node {place} is tied to no fixed node; fix one of its component")


def floats(array: npt.ArrayLike) -> FloatArray:
    """A writable copy in C order: what the kernels are compiled for."""
    return np.array(array, dtype=np.float64, order="C")


def integers(array: npt.ArrayLike) -> IntArray:
    return np.array(array, dtype=np.int64, order="C")
