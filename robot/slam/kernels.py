"""Compiled loops of the pose graph: errors, and normal equations in a fixed sparse pattern."""

import math

import numpy as np

from protocol.kernel import inlined, kernel
from robot.slam.cholesky_kernels import spread


@inlined
def _error(nodes, i, j, measurement, out):
    """e = measurement⁻¹ ∘ (node i)⁻¹ ∘ (node j) as (x, y, θ); returns T_i_j's x and y."""
    c = math.cos(nodes[i, 2])
    s = math.sin(nodes[i, 2])
    dx = nodes[j, 0] - nodes[i, 0]
    dy = nodes[j, 1] - nodes[i, 1]
    lx = c * dx + s * dy
    ly = -s * dx + c * dy
    cz = math.cos(measurement[2])
    sz = math.sin(measurement[2])
    ex = lx - measurement[0]
    ey = ly - measurement[1]
    out[0] = cz * ex + sz * ey
    out[1] = -sz * ex + cz * ey
    turn = nodes[j, 2] - nodes[i, 2] - measurement[2]
    out[2] = (turn + math.pi) % (2.0 * math.pi) - math.pi
    return lx, ly


@inlined
def _squared(e, W):
    """eᵀ W e"""
    total = 0.0
    for r in range(3):
        for c in range(3):
            total += e[r] * W[r, c] * e[c]
    return total


@kernel
def squared_errors(nodes, edge_nodes, measurements, information, out):
    """eᵀΩe of every edge (k)."""
    e = np.empty(3)
    for k in range(edge_nodes.shape[0]):
        _error(nodes, edge_nodes[k, 0], edge_nodes[k, 1], measurements[k], e)
        out[k] = _squared(e, information[k])


@inlined
def _jacobians(measurement, e, lx, ly, A, B):
    """∂e/∂(node i) and ∂e/∂(node j) in each node's own frame; (lx, ly) is what `_error` returns."""
    cz = math.cos(measurement[2])
    sz = math.sin(measurement[2])
    A[0, 0] = -cz
    A[0, 1] = -sz
    A[1, 0] = sz
    A[1, 1] = -cz
    A[0, 2] = cz * ly - sz * lx
    A[1, 2] = -sz * ly - cz * lx
    A[2, 2] = -1.0
    ct = math.cos(e[2])
    st = math.sin(e[2])
    B[0, 0] = ct
    B[0, 1] = -st
    B[1, 0] = st
    B[1, 1] = ct
    B[2, 2] = 1.0


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
    cost = 0.0
    for k in range(edge_nodes.shape[0]):
        if weights[k] == 0.0:
            continue
        i = edge_nodes[k, 0]
        j = edge_nodes[k, 1]
        lx, ly = _error(nodes, i, j, measurements[k], e)
        s = weights[k] * _squared(e, information[k])
        weight = weights[k]
        if robust[k]:
            weight /= 1.0 + s / cauchy2
            s = cauchy2 * math.log1p(s / cauchy2)
        cost += s
        _jacobians(measurements[k], e, lx, ly, A, B)
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
        lx, ly = _error(nodes, i, j, measurements[q], errors[q])
        _jacobians(measurements[q], errors[q], lx, ly, A, B)
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
def linearise_headings(
    nodes, edge_nodes, measurements, information, weights, blocks, slots, diagonal, lower, gradient
):
    """Normal equations of Σ ω |z_j − exp(iθ) z_i|², z complex: (real, imaginary, nothing).

    The blocks keep three rows so that the pattern serves here too; the third says 0 = 0.
    """
    diagonal[:] = 0.0
    lower[:] = 0.0
    gradient[:] = 0.0
    diagonal[:, 8] = 1.0
    for k in range(edge_nodes.shape[0]):
        bi = blocks[edge_nodes[k, 0]]
        bj = blocks[edge_nodes[k, 1]]
        w = weights[k] * information[k, 2, 2]
        c = w * math.cos(measurements[k, 2])
        s = w * math.sin(measurements[k, 2])
        for b in (bi, bj):
            if b >= 0:
                diagonal[b, 0] += w
                diagonal[b, 4] += w
        if bi >= 0 and bj >= 0:
            turn = s if bi < bj else -s
            block = lower[slots[k]]
            block[0] -= c
            block[1] += turn
            block[3] -= turn
            block[4] -= c
        elif bj >= 0:
            known = nodes[edge_nodes[k, 0], 2]
            gradient[bj, 0] += c * math.cos(known) - s * math.sin(known)
            gradient[bj, 1] += s * math.cos(known) + c * math.sin(known)
        elif bi >= 0:
            known = nodes[edge_nodes[k, 1], 2]
            gradient[bi, 0] += c * math.cos(known) + s * math.sin(known)
            gradient[bi, 1] += -s * math.cos(known) + c * math.sin(known)


@kernel
def linearise_positions(
    nodes, edge_nodes, measurements, information, weights, blocks, slots, diagonal, lower, gradient
):
    """Normal equations of Σ eᵀΩe over the positions alone: (x, y, nothing).

    Under given headings e is linear: Tᵀ (p_j − p_i − R_i t) with T = R_i R_ij, and an error of the
    heading that stands.
    """
    diagonal[:] = 0.0
    lower[:] = 0.0
    gradient[:] = 0.0
    diagonal[:, 8] = 1.0
    for k in range(edge_nodes.shape[0]):
        i = edge_nodes[k, 0]
        j = edge_nodes[k, 1]
        c = math.cos(nodes[i, 2] + measurements[k, 2])
        s = math.sin(nodes[i, 2] + measurements[k, 2])
        w00 = weights[k] * information[k, 0, 0]
        w01 = weights[k] * information[k, 0, 1]
        w11 = weights[k] * information[k, 1, 1]
        # M = T Ω Tᵀ, and v = T Ω_xyθ e_θ
        m00 = c * c * w00 - 2.0 * c * s * w01 + s * s * w11
        m01 = c * s * (w00 - w11) + (c * c - s * s) * w01
        m11 = s * s * w00 + 2.0 * c * s * w01 + c * c * w11
        turn = nodes[j, 2] - nodes[i, 2] - measurements[k, 2]
        turn = weights[k] * ((turn + math.pi) % (2.0 * math.pi) - math.pi)
        v0 = turn * (c * information[k, 0, 2] - s * information[k, 1, 2])
        v1 = turn * (s * information[k, 0, 2] + c * information[k, 1, 2])
        ci = math.cos(nodes[i, 2])
        si = math.sin(nodes[i, 2])
        tx = ci * measurements[k, 0] - si * measurements[k, 1]
        ty = si * measurements[k, 0] + ci * measurements[k, 1]
        bi = blocks[i]
        bj = blocks[j]
        for b, other, sign in ((bi, j, -1.0), (bj, i, 1.0)):
            if b < 0:
                continue
            diagonal[b, 0] += m00
            diagonal[b, 1] += m01
            diagonal[b, 3] += m01
            diagonal[b, 4] += m11
            ux = sign * tx
            uy = sign * ty
            if blocks[other] < 0:
                ux += nodes[other, 0]
                uy += nodes[other, 1]
            gradient[b, 0] += m00 * ux + m01 * uy - sign * v0
            gradient[b, 1] += m01 * ux + m11 * uy - sign * v1
        if bi >= 0 and bj >= 0:
            block = lower[slots[k]]
            block[0] -= m00
            block[1] -= m01
            block[3] -= m01
            block[4] -= m11


@kernel
def retract(nodes, blocks, step, out):
    """Move every free node by its row of the step (n×3), in its own frame."""
    for n in range(nodes.shape[0]):
        b = blocks[n]
        if b < 0:
            out[n] = nodes[n]
            continue
        c = math.cos(nodes[n, 2])
        s = math.sin(nodes[n, 2])
        out[n, 0] = nodes[n, 0] + c * step[b, 0] - s * step[b, 1]
        out[n, 1] = nodes[n, 1] + s * step[b, 0] + c * step[b, 1]
        theta = nodes[n, 2] + step[b, 2]
        out[n, 2] = (theta + math.pi) % (2.0 * math.pi) - math.pi


@kernel
def label_components(node_count, edge_nodes):
    """A label for each node, equal for nodes that edges connect (union-find)."""
    parent = np.arange(node_count)
    for k in range(edge_nodes.shape[0]):
        a = edge_nodes[k, 0]
        b = edge_nodes[k, 1]
        while parent[a] != a:
            parent[a] = parent[parent[a]]
            a = parent[a]
        while parent[b] != b:
            parent[b] = parent[parent[b]]
            b = parent[b]
        if a < b:
            parent[b] = a
        else:
            parent[a] = b
    for n in range(node_count):
        a = n
        while parent[a] != a:
            a = parent[a]
        parent[n] = a
    return parent


@kernel
def chain(edge_nodes, measurements, first, nodes):
    """Place nodes (m×3, NaN where no chain leads) by edges, from node 0 at `first`.

    Odometry first: a node follows from the one before it where an edge says so. What does not stand
    then follows by any edge from a node that does, in the order of the edges.
    """
    count = nodes.shape[0]
    edges = edge_nodes.shape[0]
    nodes[:, :] = np.nan
    starts = np.zeros(count + 1, dtype=np.int64)
    for k in range(edges):
        for end in range(2):
            starts[edge_nodes[k, end] + 1] += 1
    for n in range(count):
        starts[n + 1] += starts[n]
    ways = np.empty(2 * edges, dtype=np.int64)
    following = starts[:-1].copy()
    for k in range(edges):
        for end in range(2):
            n = edge_nodes[k, end]
            ways[following[n]] = k
            following[n] += 1
    # Edges that wait, as (edge, end that stands); those of the odometry on a pile that goes first.
    queue = np.empty((2 * edges, 2), dtype=np.int64)
    pile = np.empty((2 * edges, 2), dtype=np.int64)
    head = 0
    tail = 0
    height = 0
    n = 0
    nodes[0] = first
    while True:
        for p in range(starts[n + 1] - 1, starts[n] - 1, -1):
            k = ways[p]
            end = 0 if edge_nodes[k, 0] == n else 1
            other = edge_nodes[k, 1 - end]
            if not math.isnan(nodes[other, 0]):
                continue
            if other == n + 1:
                pile[height, 0] = k
                pile[height, 1] = end
                height += 1
            else:
                queue[tail, 0] = k
                queue[tail, 1] = end
                tail += 1
        found = False
        while not found and (height > 0 or head < tail):
            if height > 0:
                height -= 1
                k = pile[height, 0]
                end = pile[height, 1]
            else:
                k = queue[head, 0]
                end = queue[head, 1]
                head += 1
            n = edge_nodes[k, 1 - end]
            found = math.isnan(nodes[n, 0])
        if not found:
            return
        i = edge_nodes[k, end]
        t = measurements[k]
        if end == 0:
            c = math.cos(nodes[i, 2])
            s = math.sin(nodes[i, 2])
            nodes[n, 0] = nodes[i, 0] + c * t[0] - s * t[1]
            nodes[n, 1] = nodes[i, 1] + s * t[0] + c * t[1]
            theta = nodes[i, 2] + t[2]
        else:
            theta = nodes[i, 2] - t[2]
            c = math.cos(theta)
            s = math.sin(theta)
            nodes[n, 0] = nodes[i, 0] - c * t[0] + s * t[1]
            nodes[n, 1] = nodes[i, 1] - s * t[0] - c * t[1]
        nodes[n, 2] = (theta + math.pi) % (2.0 * math.pi) - math.pi
