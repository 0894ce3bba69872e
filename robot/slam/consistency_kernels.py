"""Compiled loop over pairs of closures: does the way from one to the other and back close?"""

import math

import numpy as np

from protocol.kernel import inlined, kernel
from protocol.pose_kernels import between, compose, wrap


@inlined
def _add_carried(x, y, theta, C, sign, out):
    """out += sign · Ad(T⁻¹) C Ad(T⁻¹)ᵀ for T = (x, y, θ)"""
    c = math.cos(theta)
    s = math.sin(theta)
    A = np.empty((3, 3))
    A[0, 0] = c
    A[0, 1] = s
    A[0, 2] = s * x - c * y
    A[1, 0] = -s
    A[1, 1] = c
    A[1, 2] = c * x + s * y
    A[2, 0] = 0.0
    A[2, 1] = 0.0
    A[2, 2] = 1.0
    for r in range(3):
        for q in range(3):
            total = 0.0
            for m in range(3):
                for n in range(3):
                    total += A[r, m] * C[m, n] * A[q, n]
            out[r, q] += sign * total


@inlined
def _determinant_and_distance(C, e):
    """det C and eᵀ C⁻¹ e; (0, ∞) for a C that is not positive definite."""
    l00 = C[0, 0]
    if not l00 > 0.0:
        return 0.0, math.inf
    f10 = C[1, 0] / l00
    f20 = C[2, 0] / l00
    d1 = C[1, 1] - f10 * C[1, 0]
    if not d1 > 0.0:
        return 0.0, math.inf
    t21 = C[2, 1] - f20 * C[1, 0]
    f21 = t21 / d1
    d2 = C[2, 2] - f20 * C[2, 0] - f21 * t21
    if not d2 > 0.0:
        return 0.0, math.inf
    y1 = e[1] - f10 * e[0]
    y2 = e[2] - f20 * e[0] - f21 * y1
    return l00 * d1 * d2, e[0] * e[0] / l00 + y1 * y1 / d1 + y2 * y2 / d2


@kernel
def volume_and_distance(covariances, errors, volumes, distances):
    """√det C and eᵀC⁻¹e of errors (k×3) with covariances (k×3×3); (0, 0) where C is not positive
    definite."""
    for k in range(errors.shape[0]):
        det, distances[k] = _determinant_and_distance(covariances[k], errors[k])
        volumes[k] = math.sqrt(det)
        if det == 0.0:
            distances[k] = 0.0


@kernel
def vote(ends, measurements, covariances, chain, drift, broken, window, gate, room, odds):
    """Log odds (k) that each closure is true, by those near it: odds[k] is added to.

    Closures (k) go from `ends[k, 0]` to the later `ends[k, 1]` and are sorted by the former.
    `chain` (m×3) are nodes as the odometry puts them, `drift` (m×3×3) the covariance it has
    gathered since node 0, carried to node 0's frame; `broken` (m) counts steps that no odometry
    covers. Where both are true the error e of a pair's cycle has the density N(e; 0, C), where one
    is false that of chance, 1 / `room`. With an even chance that the other one is false a pair
    speaks for both by (1 + N · room) / 2. A cycle too vague to tell (the volume of the `gate`, in
    squared σ, is half the room) says nothing.
    """
    a_way = np.empty(3)
    b_way = np.empty(3)
    there = np.empty(3)
    back = np.empty(3)
    e = np.empty(3)
    C = np.empty((3, 3))
    count = ends.shape[0]
    for a in range(count):
        for b in range(a + 1, count):
            if ends[b, 0] - ends[a, 0] > window:
                break
            if abs(ends[b, 1] - ends[a, 1]) > window:
                continue
            ia = ends[a, 0]
            ib = ends[b, 0]
            ja = ends[a, 1]
            jb = ends[b, 1]
            if broken[ia] != broken[ib] or broken[ja] != broken[jb]:
                continue
            # From i_b along the odometry to i_a, through closure a, along to j_b; against b.
            between(chain[ib], chain[ia], a_way)
            between(chain[ja], chain[jb], b_way)
            compose(measurements[a], b_way, there)
            compose(a_way, there, back)
            between(measurements[b], back, e)
            e[2] = wrap(e[2])
            C[:, :] = covariances[b]
            _add_carried(b_way[0], b_way[1], b_way[2], covariances[a], 1.0, C)
            later = max(ja, jb)
            sooner = min(ja, jb)
            x, y, theta = chain[jb, 0], chain[jb, 1], chain[jb, 2]
            _add_carried(x, y, theta, drift[later], 1.0, C)
            _add_carried(x, y, theta, drift[sooner], -1.0, C)
            # Odometry between i_b and i_a, carried on to j_b: first to i_a, then through `there`.
            compose(chain[ia], there, back)
            later = max(ia, ib)
            sooner = min(ia, ib)
            _add_carried(back[0], back[1], back[2], drift[later], 1.0, C)
            _add_carried(back[0], back[1], back[2], drift[sooner], -1.0, C)
            det, squared = _determinant_and_distance(C, e)
            p = 4.0 / 3.0 * math.pi * gate**1.5 * math.sqrt(det) / room
            if not 0.0 < p < 0.5:
                continue
            density = math.exp(-0.5 * squared) / math.sqrt((2.0 * math.pi) ** 3 * det)
            gain = math.log(0.5 * (1.0 + density * room))
            odds[a] += gain
            odds[b] += gain


@kernel
def gather_drift(chain, step_edges, measured_covariances, drift, broken):
    """Covariance of the odometry since node 0 in node 0's frame (m×3×3), and its gaps so far (m).

    `step_edges[n]` is the edge from n − 1 to n, −1 for none.
    """
    A = np.zeros((3, 3))
    drift[0] = 0.0
    broken[0] = 0
    for n in range(1, chain.shape[0]):
        drift[n] = drift[n - 1]
        broken[n] = broken[n - 1]
        k = step_edges[n]
        if k < 0:
            broken[n] += 1
            continue
        c = math.cos(chain[n, 2])
        s = math.sin(chain[n, 2])
        A[0, 0] = c
        A[0, 1] = -s
        A[0, 2] = chain[n, 1]
        A[1, 0] = s
        A[1, 1] = c
        A[1, 2] = -chain[n, 0]
        A[2, 2] = 1.0
        for r in range(3):
            for q in range(3):
                for m in range(3):
                    for o in range(3):
                        drift[n, r, q] += A[r, m] * measured_covariances[k, m, o] * A[q, o]
