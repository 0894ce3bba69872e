"""A start for a pose graph that needs no start: headings first, then positions, both linear.

Martinec and Pajdla, "Robust rotation and translation estimation in multiview reconstruction",
2007; Carlone, Tron, Daniilidis, Dellaert, "Initialization techniques for 3D SLAM: a survey on
rotation estimation and its use in pose graph optimization", 2015. In the plane a heading is a
complex number z of length 1. Leaving the length open makes

    min Σ ω_ij |z_j − z_i exp(iθ_ij)|²,   then   min Σ |R_iᵀ (p_j − p_i) − t_ij|²_Ω

two linear least squares problems, the second with the headings of the first.
"""

import numpy as np
import numpy.typing as npt
import qdldl
from scipy.sparse import coo_matrix, csc_matrix, triu

from protocol.pose import FloatArray
from robot.slam.normal_equations import DIAGONAL_FLOOR

IntArray = npt.NDArray[np.int64]


def chordal_start(
    nodes: FloatArray,
    edge_nodes: npt.NDArray[np.integer],
    measurements: FloatArray,
    information: FloatArray,
    fixed: npt.NDArray[np.bool_],
) -> FloatArray:
    """Nodes (m×3) near the optimum, from the edges alone; arguments as in `optimise`.

    Fixed nodes stay; each component needs one. What `nodes` says of the others is not used.
    """
    edges = np.asarray(edge_nodes, dtype=np.int64)
    fixed = np.asarray(fixed, dtype=bool)
    out = np.array(nodes, dtype=np.float64)
    if len(edges) == 0 or fixed.all():
        return out
    out[~fixed, 2] = _headings(out, edges, measurements[:, 2], information[:, 2, 2], fixed)[~fixed]
    out[~fixed, :2] = _positions(out, edges, measurements, information, fixed)[~fixed]
    return out


def _headings(
    nodes: FloatArray,
    edges: IntArray,
    turns: FloatArray,
    weights: FloatArray,
    fixed: npt.NDArray[np.bool_],
) -> FloatArray:
    c, s = np.cos(turns), np.sin(turns)
    # Row blocks z_j − R(θ_ij) z_i over the real and imaginary part.
    minus_turn = -np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], axis=1)
    blocks_i = minus_turn
    blocks_j = np.broadcast_to(np.eye(2), minus_turn.shape)
    weight = weights[:, None, None] * np.eye(2)
    known = np.stack([np.cos(nodes[:, 2]), np.sin(nodes[:, 2])], axis=-1)
    zero = np.zeros((len(edges), 2))
    z = _least_squares(blocks_i, blocks_j, zero, weight, edges, known, fixed)
    return np.asarray(np.arctan2(z[:, 1], z[:, 0]), dtype=np.float64)


def _positions(
    nodes: FloatArray,
    edges: IntArray,
    measurements: FloatArray,
    information: FloatArray,
    fixed: npt.NDArray[np.bool_],
) -> FloatArray:
    """Residuals and weights as in the graph itself, in the frame of the measured node: the error
    is turned by the measured angle, and what the headings lack of a turn is already decided."""
    theta = nodes[edges[:, 0], 2]
    turned = _rotations(theta + measurements[:, 2]).transpose(0, 2, 1)
    offsets = np.einsum(
        "kab,kb->ka", _rotations(measurements[:, 2]).transpose(0, 2, 1), measurements[:, :2]
    )
    return _least_squares(
        -turned, turned, offsets, information[:, :2, :2], edges, nodes[:, :2], fixed
    )


def _rotations(theta: FloatArray) -> FloatArray:
    c, s = np.cos(theta), np.sin(theta)
    return np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], axis=1)


def _least_squares(
    blocks_i: FloatArray,
    blocks_j: FloatArray,
    wanted: FloatArray,
    weight: FloatArray,
    edges: IntArray,
    known: FloatArray,
    fixed: npt.NDArray[np.bool_],
) -> FloatArray:
    """x (m×2) that minimises Σ |A_k x_i + B_k x_j − wanted_k|²_W, with x = `known` where fixed."""
    free = ~fixed
    column = np.where(free, np.cumsum(free) - 1, -1)
    size = 2 * int(free.sum())
    terms = ((edges[:, 0], blocks_i), (edges[:, 1], blocks_j))
    right = wanted.copy()
    for ends, blocks in terms:
        held = fixed[ends]
        right[held] -= np.einsum("kab,kb->ka", blocks[held], known[ends[held]])
    gradient = np.zeros(size)
    rows, columns, values = [], [], []
    two = np.arange(2)
    for ends_a, blocks_a in terms:
        weighted = np.einsum("kba,kbc->kac", blocks_a, weight)
        loose = column[ends_a] >= 0
        places = 2 * column[ends_a][:, None] + two
        np.add.at(gradient, places[loose], np.einsum("kab,kb->ka", weighted, right)[loose])
        for ends_b, blocks_b in terms:
            both = loose & (column[ends_b] >= 0)
            rows.append(np.repeat(places[both], 2, axis=1).ravel())
            columns.append(np.tile((2 * column[ends_b][:, None] + two)[both], (1, 2)).ravel())
            values.append((weighted @ blocks_b)[both].ravel())
    entries = (np.concatenate(rows), np.concatenate(columns))
    H = coo_matrix((np.concatenate(values), entries), shape=(size, size))
    floor = coo_matrix((np.full(size, DIAGONAL_FLOOR), (np.arange(size), np.arange(size))))
    solver = qdldl.Solver(csc_matrix(triu(csc_matrix(H + floor))), upper=True)
    x = np.array(known, dtype=np.float64)
    x[free] = np.asarray(solver.solve(gradient)).reshape(-1, 2)
    return x
