"""Sparse Cholesky factorisation of a symmetric matrix of 3×3 blocks, its pattern analysed once.

A pose graph couples whole poses, so the pattern is that of blocks: ordering and analysis see a
ninth of the entries, and the loops multiply small dense blocks. The ordering is by minimum degree:
of few blocks the exact one, of many the approximate one (Amestoy, Davis, Duff 1996) that qdldl
finds for the graph of the blocks.
"""

import numpy as np
import numpy.typing as npt
import qdldl
from scipy.sparse import csc_matrix

from protocol.pose import FloatArray
from robot.slam import cholesky_kernels

IntArray = npt.NDArray[np.int64]

# Keeps a direction that nothing measures from ending the factorisation.
DIAGONAL_FLOOR = 1e-9
# Up to so many blocks the exact minimum degree takes less time.
FEW = 256


class BlockCholesky:
    """The pattern of a matrix A of n×n blocks, and its factor L Lᵀ as often as values change.

    `order` (n): where each block of the caller's numbering stands in A. `slots` (k): which lower
    block of A each of the caller's pairs (k×2) is.
    """

    def __init__(self, count: int, pairs: IntArray) -> None:
        self.count = count
        self.order = _minimum_degree(count, pairs)
        of_pairs = _keys(count, self.order[pairs])
        keys = _distinct(of_pairs)
        self.slots: IntArray = np.searchsorted(keys, of_pairs)
        self._starts: IntArray = np.searchsorted(keys, np.arange(count + 1) * count)
        self._columns: IntArray = keys % max(count, 1)
        self.lower_count = len(keys)
        (
            self._column_starts,
            self._column_rows,
            self._row_starts,
            self._row_columns,
            self._row_places,
        ) = cholesky_kernels.analyse(count, self._starts, self._columns)
        self._blocks = np.empty((len(self._column_rows), 9))
        self._inverses = np.empty((count, 9))
        self._work = np.zeros((count, 9))

    def factorise(self, diagonal: FloatArray, lower: FloatArray, damping: float = 0.0) -> bool:
        """L Lᵀ of the blocks (n×9 and lower_count×9) with the diagonal raised by `damping` times
        itself; False where that is not positive definite."""
        return bool(
            cholesky_kernels.factorise(
                diagonal,
                lower,
                self._starts,
                self._columns,
                damping,
                DIAGONAL_FLOOR,
                self._column_starts,
                self._column_rows,
                self._row_starts,
                self._row_columns,
                self._row_places,
                self._blocks,
                self._inverses,
                self._work,
            )
        )

    def solve(self, right: FloatArray) -> FloatArray:
        """A⁻¹ right (n×3)."""
        x = right.copy()
        cholesky_kernels.solve(
            self._column_starts, self._column_rows, self._blocks, self._inverses, x
        )
        return x

    def spread(self, first: int, J: FloatArray, second: int, K: FloatArray) -> FloatArray:
        """[J K] A⁻¹ [J K]ᵀ (3×3) for 3×3 matrices at two blocks of A, −1 for none.

        With A the information of a graph: the covariance of what J and K make of two poses.
        """
        out = np.empty((3, 3))
        cholesky_kernels.spread(
            self._column_starts,
            self._column_rows,
            self._blocks,
            self._inverses,
            first,
            J,
            second,
            K,
            self._work,
            out,
        )
        return out

    @property
    def factor(self) -> tuple[IntArray, IntArray, FloatArray, FloatArray, FloatArray]:
        """What `spread` takes of this: column starts, row of each place, L, inverse diagonal,
        work space."""
        return self._column_starts, self._column_rows, self._blocks, self._inverses, self._work


def _keys(count: int, pairs: IntArray) -> IntArray:
    """Of pairs (k×2) in either order: their places (k) in a lower triangle, row by row."""
    first, second = pairs[:, 0], pairs[:, 1]
    return np.maximum(first, second) * count + np.minimum(first, second)


def _distinct(keys: IntArray) -> IntArray:
    """The keys in ascending order, each once: np.unique takes several times as long for few."""
    keys = np.sort(keys)
    new = np.ones(len(keys), dtype=np.bool_)
    np.not_equal(keys[1:], keys[:-1], out=new[1:])
    return keys[new]


def _minimum_degree(count: int, pairs: IntArray) -> IntArray:
    """Where each block should stand so that little fills in."""
    if count <= FEW:
        return np.asarray(cholesky_kernels.minimum_degree(count, pairs))
    # Of the graph's Laplacian, the upper triangle by columns: what SciPy would be slow to sort.
    each = np.arange(count)
    keys = _distinct(np.concatenate([_keys(count, pairs), each * count + each]))
    rows, columns = keys % count, keys // count
    diagonal = rows == columns
    values = np.full(len(keys), -1.0)
    values[diagonal] = np.bincount(rows) + np.bincount(columns) - 1.0
    starts = np.searchsorted(columns, np.arange(count + 1))
    upper = csc_matrix((values, rows.astype(np.int32), starts.astype(np.int32)), (count, count))
    _, _, chosen = qdldl.Solver(upper, upper=True).factors()
    order = np.empty(count, dtype=np.int64)
    order[np.asarray(chosen)] = np.arange(count)
    return order
