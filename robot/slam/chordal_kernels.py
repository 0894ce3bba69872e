"""Compiled normal equations of a start without a start: headings first, then positions."""

import math

from protocol.kernel import kernel
from protocol.pose_kernels import wrap


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
        turn = weights[k] * wrap(nodes[j, 2] - nodes[i, 2] - measurements[k, 2])
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
