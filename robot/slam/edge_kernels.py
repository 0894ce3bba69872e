"""Compiled loops over the edges of a pose graph: errors, and how they change with the nodes."""

import math

import numpy as np

from protocol.kernel import inlined, kernel
from protocol.pose_kernels import wrap


@inlined
def error(nodes, i, j, measurement, out):
    """e = measurement⁻¹ ∘ (node i)⁻¹ ∘ (node j) as (x, y, θ); returns T_i_j's x and y."""
    c = math.cos(nodes[i, 2])
    s = math.sin(nodes[i, 2])
    cz = math.cos(measurement[2])
    sz = math.sin(measurement[2])
    return error_turned(nodes, i, j, measurement, c, s, cz, sz, out)


@inlined
def error_turned(nodes, i, j, measurement, c, s, cz, sz, out):
    """The same, where cosine and sine of node i's heading and of the measurement's turn are known:
    they take longer than all the rest."""
    dx = nodes[j, 0] - nodes[i, 0]
    dy = nodes[j, 1] - nodes[i, 1]
    x = c * dx + s * dy
    y = -s * dx + c * dy
    dx = x - measurement[0]
    dy = y - measurement[1]
    out[0] = cz * dx + sz * dy
    out[1] = -sz * dx + cz * dy
    out[2] = wrap(nodes[j, 2] - nodes[i, 2] - measurement[2])
    return x, y


@inlined
def squared(e, W):
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
        error(nodes, edge_nodes[k, 0], edge_nodes[k, 1], measurements[k], e)
        out[k] = squared(e, information[k])


@inlined
def jacobians(cz, sz, e, lx, ly, A, B):
    """∂e/∂(node i) and ∂e/∂(node j) in each node's own frame; (lx, ly) is what `error` returns,
    (cz, sz) the cosine and sine of the measurement's turn."""
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
