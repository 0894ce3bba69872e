"""Compiled normal equations of a pose graph, in a fixed sparse pattern of 3×3 blocks."""

import math

import numpy as np

from protocol.kernel import inlined, kernel
from protocol.pose_kernels import compose, wrap
from robot.slam.cholesky_kernels import spread
from robot.slam.edge_kernels import error, error_turned, jacobians, squared


@kernel
def linearise(
    nodes,
    edge_nodes,
    measurements,
    information,
    weights,
    robust,
    cauchy2,
    blocks,
    slots,
    diagonal,
    lower,
    gradient,
):
    """Normal equations H δ = −g of all edges, for δ in each node's own frame; the cost.

    H is written into `diagonal` (n×9) and `lower` (m×9): edge k's block is `lower[slots[k]]`.
    `blocks` maps nodes to their place in H, −1 for fixed ones. `gradient` (n×3) takes −g.
    """
    diagonal[:] = 0.0
    lower[:] = 0.0
    gradient[:] = 0.0
    e = np.empty(3)
    A = np.zeros((3, 3))
    B = np.zeros((3, 3))
    WA = np.empty((3, 3))
    WB = np.empty((3, 3))
    headings = np.empty((nodes.shape[0], 2))
    for n in range(nodes.shape[0]):
        headings[n, 0] = math.cos(nodes[n, 2])
        headings[n, 1] = math.sin(nodes[n, 2])
    cost = 0.0
    for k in range(edge_nodes.shape[0]):
        if weights[k] == 0.0:
            continue
        i = edge_nodes[k, 0]
        j = edge_nodes[k, 1]
        cz = math.cos(measurements[k, 2])
        sz = math.sin(measurements[k, 2])
        c, s = headings[i, 0], headings[i, 1]
        lx, ly = error_turned(nodes, i, j, measurements[k], c, s, cz, sz, e)
        s = weights[k] * squared(e, information[k])
        weight = weights[k]
        if robust[k]:
            weight /= 1.0 + s / cauchy2
            s = cauchy2 * math.log1p(s / cauchy2)
        cost += s
        jacobians(cz, sz, e, lx, ly, A, B)
        for r in range(3):
            for c in range(3):
                wa = 0.0
                wb = 0.0
                for m in range(3):
                    wa += information[k, r, m] * A[m, c]
                    wb += information[k, r, m] * B[m, c]
                WA[r, c] = weight * wa
                WB[r, c] = weight * wb
        bi = blocks[i]
        bj = blocks[j]
        for r in range(3):
            for m in range(3):
                if bi >= 0:
                    gradient[bi, r] -= WA[m, r] * e[m]
                if bj >= 0:
                    gradient[bj, r] -= WB[m, r] * e[m]
        if bi >= 0:
            _add_product(diagonal[bi], A, WA)
        if bj >= 0:
            _add_product(diagonal[bj], B, WB)
        if bi >= 0 and bj >= 0:
            if bi < bj:
                _add_product(lower[slots[k]], B, WA)
            else:
                _add_product(lower[slots[k]], A, WB)
    return cost


@inlined
def _add_product(block, J, WK):
    """Add Jᵀ W K to a block (9)."""
    for r in range(3):
        for c in range(3):
            block[3 * r + c] += J[0, r] * WK[0, c] + J[1, r] * WK[1, c] + J[2, r] * WK[2, c]


@kernel
def innovations(
    nodes,
    edge_nodes,
    measurements,
    blocks,
    column_starts,
    column_rows,
    factor,
    inverses,
    work,
    errors,
    covariances,
):
    """Errors (q×3) of edges, and [A B] H⁻¹ [A B]ᵀ (q×3×3)."""
    A = np.zeros((3, 3))
    B = np.zeros((3, 3))
    for q in range(edge_nodes.shape[0]):
        i = edge_nodes[q, 0]
        j = edge_nodes[q, 1]
        lx, ly = error(nodes, i, j, measurements[q], errors[q])
        cz = math.cos(measurements[q, 2])
        sz = math.sin(measurements[q, 2])
        jacobians(cz, sz, errors[q], lx, ly, A, B)
        spread(
            column_starts,
            column_rows,
            factor,
            inverses,
            blocks[i],
            A,
            blocks[j],
            B,
            work,
            covariances[q],
        )


@kernel
def retract(nodes, blocks, step, out):
    """Move every free node by its row of the step (n×3), in its own frame."""
    for n in range(nodes.shape[0]):
        b = blocks[n]
        if b < 0:
            out[n] = nodes[n]
            continue
        compose(nodes[n], step[b], out[n])
        out[n, 2] = wrap(out[n, 2])
