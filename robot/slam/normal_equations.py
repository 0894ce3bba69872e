"""The normal equations of a pose graph, in a sparse pattern that is built once.

The upper triangle of H = Σ JᵀΩJ in compressed columns, written by a kernel at each linearisation
and factorised as LDLᵀ by qdldl.
"""

import numpy as np
import numpy.typing as npt
import qdldl
from scipy.sparse import csc_matrix

from protocol.errors import EarshotError
from protocol.pose import FloatArray
from robot.slam import kernels

IntArray = npt.NDArray[np.int64]

DIAGONAL_FLOOR = 1e-9


class PoseGraphError(EarshotError):
    """A graph that cannot be solved as it is; the message says which node or array is at fault."""


class NormalEquations:
    """A graph with the pattern of its normal equations, linearised as often as wanted."""

    def __init__(
        self,
        nodes: FloatArray,
        edge_nodes: npt.NDArray[np.integer],
        measurements: FloatArray,
        information: FloatArray,
        fixed: npt.NDArray[np.bool_],
        robust: npt.NDArray[np.bool_] | None,
        cauchy_squared: float,
    ) -> None:
        self.nodes = floats(nodes)
        self.edge_nodes = integers(edge_nodes)
        self._measurements = floats(measurements)
        self._information = floats(information)
        k = len(self.edge_nodes)
        self._robust = integers(np.zeros(k) if robust is None else robust)
        self._cauchy2 = cauchy_squared
        self._check(fixed)
        free = ~np.asarray(fixed, dtype=bool)
        self.blocks: IntArray = np.where(free, np.cumsum(free) - 1, -1)
        self.size = 3 * int(free.sum())
        self._solver: qdldl.Solver | None = None
        self._build_pattern(int(free.sum()))

    def chi2(self, nodes: FloatArray) -> float:
        """Σ eᵀΩe"""
        out = np.empty(len(self.edge_nodes))
        kernels.squared_errors(nodes, self.edge_nodes, self._measurements, self._information, out)
        return float(out.sum())

    def cost(self, nodes: FloatArray) -> float:
        """Σ eᵀΩe, robust edges by their kernel."""
        return float(
            kernels.robust_cost(
                nodes,
                self.edge_nodes,
                self._measurements,
                self._information,
                self._robust,
                self._cauchy2,
            )
        )

    def linearise(self, nodes: FloatArray) -> None:
        """Take the normal equations at these nodes."""
        kernels.linearise(
            nodes,
            self.edge_nodes,
            self._measurements,
            self._information,
            self._robust,
            self._cauchy2,
            self.blocks,
            self._slots,
            self._bases,
            self._widths,
            self._values,
            self._gradient,
        )

    def solve(self, damping: float) -> FloatArray:
        """The step (all free nodes, in their own frames) at the last linearisation."""
        solver = self._factorise(damping)
        return np.asarray(solver.solve(self._gradient), dtype=np.float64)

    def inverse_block(self, block: int) -> FloatArray:
        """The diagonal block (3×3) of H⁻¹ that belongs to a block column."""
        solver = self._factorise(0.0)
        columns = np.empty((3, 3))
        for c in range(3):
            unit = np.zeros(self.size)
            unit[3 * block + c] = 1.0
            columns[:, c] = solver.solve(unit)[3 * block : 3 * block + 3]
        return 0.5 * (columns + columns.T)

    def retract(self, nodes: FloatArray, step: FloatArray) -> FloatArray:
        """The nodes moved by a step."""
        out = np.empty_like(nodes)
        kernels.retract(nodes, self.blocks, step, out)
        return out

    def _check(self, fixed: npt.NDArray[np.bool_]) -> None:
        m, k = len(self.nodes), len(self.edge_nodes)
        shapes = (
            self.nodes.shape == (m, 3)
            and self.edge_nodes.shape == (k, 2)
            and self._measurements.shape == (k, 3)
            and self._information.shape == (k, 3, 3)
            and np.shape(fixed) == (m,)
            and self._robust.shape == (k,)
        )
        if not shapes:
            raise PoseGraphError(
                "a pose graph takes nodes m×3, edge_nodes k×2, measurements k×3, "
                "information k×3×3, fixed m and robust k"
            )
        if k and (self.edge_nodes.min() < 0 or self.edge_nodes.max() >= m):
            raise PoseGraphError(f"an edge names a node outside 0…{m - 1}")
        if k and (self.edge_nodes[:, 0] == self.edge_nodes[:, 1]).any():
            raise PoseGraphError("an edge ties a node to itself")
        labels = kernels.label_components(m, self.edge_nodes)
        loose = ~np.isin(labels, labels[np.asarray(fixed, dtype=bool)])
        if loose.any():
            node = int(np.flatnonzero(loose)[0])
            raise PoseGraphError(f"node {node} is tied to no fixed node; fix one of its component")

    def _build_pattern(self, count: int) -> None:
        a = self.blocks[self.edge_nodes[:, 0]]
        b = self.blocks[self.edge_nodes[:, 1]]
        inner = (a >= 0) & (b >= 0)
        low, high = np.minimum(a, b), np.maximum(a, b)
        keys, where = np.unique(high[inner] * max(count, 1) + low[inner], return_inverse=True)
        pair_high, pair_low = keys // max(count, 1), keys % max(count, 1)
        self._widths: IntArray = np.bincount(pair_high, minlength=count).astype(np.int64)
        first = np.concatenate([[0], np.cumsum(self._widths)[:-1]]).astype(np.int64)
        self._slots: IntArray = np.zeros(len(a), dtype=np.int64)
        self._slots[inner] = where - first[high[inner]]
        sizes = 9 * self._widths + 6
        self._bases: IntArray = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64)
        self._bases = self._bases[:count]
        self._indices, self._pointers = self._index_arrays(pair_low, first, count)
        self._values = np.zeros(len(self._indices))
        self._damped = np.zeros(len(self._indices))
        self._gradient = np.zeros(3 * count)

    def _index_arrays(
        self, pair_low: IntArray, first: IntArray, count: int
    ) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
        """Row indices and column pointers of the upper triangle, rows in ascending order."""
        rows: list[IntArray] = []
        pointers = [0]
        three = np.arange(3)
        for b in range(count):
            above = pair_low[first[b] : first[b] + self._widths[b]]
            above_rows = (3 * above[:, None] + three).ravel()
            for c in range(3):
                rows.append(above_rows)
                rows.append(3 * b + three[: c + 1])
                pointers.append(pointers[-1] + len(above_rows) + c + 1)
        indices = np.concatenate(rows) if rows else np.zeros(0)
        return indices.astype(np.int32), np.array(pointers, dtype=np.int32)

    def _factorise(self, damping: float) -> qdldl.Solver:
        """LDLᵀ of the damped matrix; the pattern is analysed the first time only."""
        kernels.damp(self._values, self._bases, self._widths, damping, DIAGONAL_FLOOR, self._damped)
        matrix = csc_matrix(
            (self._damped, self._indices, self._pointers), shape=(self.size, self.size)
        )
        if self._solver is None:
            self._solver = qdldl.Solver(matrix, upper=True)
        else:
            self._solver.update(matrix, upper=True)
        return self._solver


def floats(array: npt.ArrayLike) -> FloatArray:
    """A writable copy in C order: what the kernels are compiled for."""
    return np.array(array, dtype=np.float64, order="C")


def integers(array: npt.ArrayLike) -> IntArray:
    return np.array(array, dtype=np.int64, order="C")
