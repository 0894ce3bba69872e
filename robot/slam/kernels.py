"""Compiled loops of the pose graph: errors, and the normal equations in a fixed sparse pattern."""

import math

import numpy as np

from protocol.kernel import inlined, kernel


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


@kernel
def robust_cost(nodes, edge_nodes, measurements, information, robust, cauchy2):
    """Σ ρ(eᵀΩe), where ρ(s) = c² log(1 + s / c²) for robust edges and s for the others."""
    e = np.empty(3)
    total = 0.0
    for k in range(edge_nodes.shape[0]):
        _error(nodes, edge_nodes[k, 0], edge_nodes[k, 1], measurements[k], e)
        s = _squared(e, information[k])
        total += cauchy2 * math.log1p(s / cauchy2) if robust[k] == 1 else s
    return total


@kernel
def linearise(
    nodes,
    edge_nodes,
    measurements,
    information,
    robust,
    cauchy2,
    blocks,
    slots,
    bases,
    widths,
    values,
    gradient,
):
    """Normal equations H δ = −g of all edges, for δ in each node's own frame.

    H is written into `values`, the upper triangle in compressed columns: block column b starts at
    `bases[b]` and has `widths[b]` blocks above the diagonal; edge k's block is the `slots[k]`-th of
    them. `blocks` maps nodes to block columns, −1 for fixed ones. `gradient` takes −g.
    """
    values[:] = 0.0
    gradient[:] = 0.0
    e = np.empty(3)
    A = np.zeros((3, 3))
    B = np.zeros((3, 3))
    WA = np.empty((3, 3))
    WB = np.empty((3, 3))
    for k in range(edge_nodes.shape[0]):
        i = edge_nodes[k, 0]
        j = edge_nodes[k, 1]
        lx, ly = _error(nodes, i, j, measurements[k], e)
        weight = 1.0
        if robust[k] == 1:
            weight = 1.0 / (1.0 + _squared(e, information[k]) / cauchy2)
        cz = math.cos(measurements[k, 2])
        sz = math.sin(measurements[k, 2])
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
            gi = 0.0
            gj = 0.0
            for m in range(3):
                gi += WA[m, r] * e[m]
                gj += WB[m, r] * e[m]
            if bi >= 0:
                gradient[3 * bi + r] -= gi
            if bj >= 0:
                gradient[3 * bj + r] -= gj
        if bi >= 0:
            _add_diagonal(values, bases, widths, bi, A, WA)
        if bj >= 0:
            _add_diagonal(values, bases, widths, bj, B, WB)
        if bi >= 0 and bj >= 0:
            if bi < bj:
                _add_block(values, bases, widths, bj, slots[k], A, WB)
            else:
                _add_block(values, bases, widths, bi, slots[k], B, WA)


@inlined
def _add_diagonal(values, bases, widths, b, J, WJ):
    """Add the upper triangle of Jᵀ W J to diagonal block b."""
    for c in range(3):
        start = bases[b] + 3 * c * widths[b] + c * (c + 1) // 2 + 3 * widths[b]
        for r in range(c + 1):
            total = 0.0
            for m in range(3):
                total += J[m, r] * WJ[m, c]
            values[start + r] += total


@inlined
def _add_block(values, bases, widths, b, slot, J, WK):
    """Add Jᵀ W K to the block `slot` of block column b."""
    for c in range(3):
        start = bases[b] + 3 * c * widths[b] + c * (c + 1) // 2 + 3 * slot
        for r in range(3):
            total = 0.0
            for m in range(3):
                total += J[m, r] * WK[m, c]
            values[start + r] += total


@kernel
def damp(values, bases, widths, factor, floor, out):
    """out = H with its diagonal raised to (1 + factor) times itself plus `floor`."""
    out[:] = values
    for b in range(bases.shape[0]):
        for c in range(3):
            place = bases[b] + 3 * c * widths[b] + c * (c + 1) // 2 + 3 * widths[b] + c
            out[place] += factor * values[place] + floor


@kernel
def retract(nodes, blocks, step, out):
    """Move every free node by its share of the step, in its own frame."""
    for n in range(nodes.shape[0]):
        b = blocks[n]
        if b < 0:
            out[n] = nodes[n]
            continue
        c = math.cos(nodes[n, 2])
        s = math.sin(nodes[n, 2])
        out[n, 0] = nodes[n, 0] + c * step[3 * b] - s * step[3 * b + 1]
        out[n, 1] = nodes[n, 1] + s * step[3 * b] + c * step[3 * b + 1]
        theta = nodes[n, 2] + step[3 * b + 2]
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
