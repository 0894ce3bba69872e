"""Compiled loop of scan matching: reweighted least squares on a correlation field."""

import math

import numpy as np

from protocol.kernel import inlined, kernel
from robot.perception.field_kernels import expected, look_up

# A Gauss-Newton step is made longer by at most this.
MAX_STRETCH = 5.0
# A step that gains less than this share is the last: kinks of the field keep it from being short.
MIN_GAIN = 3e-6


@inlined
def _accumulate(field, origin, resolution, pose, returns, count, sigma_floor, H, g):
    """Σ w M over all returns; H and g take the normal equations in the tangent space at the pose.

    Iteratively reweighted least squares for Welsch's loss 1 − M: each return counts with weight M
    and residual −σ² ∇M / M, along its surface normal where it has one.
    """
    c = math.cos(pose[2])
    s = math.sin(pose[2])
    precision = 1.0 / (sigma_floor * sigma_floor)
    H[:, :] = 0.0
    g[:] = 0.0
    total = 0.0
    for k in range(count):
        x, y = returns[k, 0], returns[k, 1]
        u = (pose[0] + c * x - s * y - origin[0]) / resolution
        v = (pose[1] + s * x + c * y - origin[1]) / resolution
        value, du, dv = look_up(field, u, v)
        if value <= 0.0:
            continue
        share = sigma_floor * sigma_floor / (sigma_floor * sigma_floor + returns[k, 5] ** 2)
        w = returns[k, 4] * share
        total += w * value
        gx = (c * du + s * dv) / resolution
        gy = (-s * du + c * dv) / resolution
        nx, ny = returns[k, 2], returns[k, 3]
        curvature = w * value * precision
        if nx != 0.0 or ny != 0.0:
            along = w * (gx * nx + gy * ny)
            lever = ny * x - nx * y
            g[0] += along * nx
            g[1] += along * ny
            g[2] += along * lever
            H[0, 0] += curvature * nx * nx
            H[0, 1] += curvature * nx * ny
            H[1, 1] += curvature * ny * ny
            H[0, 2] += curvature * nx * lever
            H[1, 2] += curvature * ny * lever
            H[2, 2] += curvature * lever * lever
        else:
            g[0] += w * gx
            g[1] += w * gy
            g[2] += w * (gy * x - gx * y)
            H[0, 0] += curvature
            H[1, 1] += curvature
            H[0, 2] -= curvature * y
            H[1, 2] += curvature * x
            H[2, 2] += curvature * (x * x + y * y)
    H[1, 0] = H[0, 1]
    H[2, 0] = H[0, 2]
    H[2, 1] = H[1, 2]
    return total


@inlined
def _solve3(A, b, out):
    """Solve a symmetric positive definite 3×3 system by Cholesky; False when it is singular."""
    if A[0, 0] <= 0.0:
        return False
    l00 = math.sqrt(A[0, 0])
    l10 = A[1, 0] / l00
    l20 = A[2, 0] / l00
    d1 = A[1, 1] - l10 * l10
    if d1 <= 1e-12 * A[1, 1]:
        return False
    l11 = math.sqrt(d1)
    l21 = (A[2, 1] - l20 * l10) / l11
    d2 = A[2, 2] - l20 * l20 - l21 * l21
    if d2 <= 1e-12 * A[2, 2]:
        return False
    l22 = math.sqrt(d2)
    y0 = b[0] / l00
    y1 = (b[1] - l10 * y0) / l11
    y2 = (b[2] - l20 * y0 - l21 * y1) / l22
    out[2] = y2 / l22
    out[1] = (y1 - l21 * out[2]) / l11
    out[0] = (y0 - l10 * out[1] - l20 * out[2]) / l00
    return True


@inlined
def _move(pose, tangent, out):
    """out = pose ∘ Exp(tangent)"""
    theta = tangent[2]
    if abs(theta) < 1e-6:
        a = 1.0 - theta * theta / 6.0
        b = 0.5 * theta
    else:
        a = math.sin(theta) / theta
        b = (1.0 - math.cos(theta)) / theta
    x = a * tangent[0] - b * tangent[1]
    y = b * tangent[0] + a * tangent[1]
    c = math.cos(pose[2])
    s = math.sin(pose[2])
    out[0] = pose[0] + c * x - s * y
    out[1] = pose[1] + s * x + c * y
    out[2] = (pose[2] + theta + math.pi) % (2.0 * math.pi) - math.pi


@inlined
def _prior_offset(prior, pose, out):
    """out = (prior⁻¹ ∘ pose) in the body frame of the pose: what the prior disagrees by."""
    c = math.cos(pose[2])
    s = math.sin(pose[2])
    dx = pose[0] - prior[0]
    dy = pose[1] - prior[1]
    out[0] = c * dx + s * dy
    out[1] = -s * dx + c * dy
    out[2] = (pose[2] - prior[2] + math.pi) % (2.0 * math.pi) - math.pi


@kernel
def match_returns(
    field,
    origin,
    resolution,
    returns,
    count,
    sigma_floor,
    trust,
    prior,
    prior_information,
    max_iterations,
    tolerance,
    pose,
    information,
):
    """Move `pose` uphill on trust · Σ w M − ½ |pose − prior|²; (score, iterations, converged).

    `information` (3×3) takes that of the returns alone, in the tangent space at the pose. The
    score is Σ w M over what it would be if nothing but noise stood between scan and field.
    """
    H = np.empty((3, 3))
    g = np.empty(3)
    A = np.zeros((3, 3))
    b = np.zeros(3)
    step = np.zeros(3)
    offset = np.empty(3)
    candidate = pose.copy()
    best = pose.copy()
    best_value = -1e300
    full_weight = 0.0
    for k in range(count):
        share = sigma_floor * sigma_floor / (sigma_floor * sigma_floor + returns[k, 5] ** 2)
        full_weight += returns[k, 4] * share * expected(returns[k, 5], sigma_floor)
    best_total = 0.0
    converged = False
    iterations = 0
    halvings = 0
    while iterations < max_iterations:
        iterations += 1
        total = _accumulate(field, origin, resolution, candidate, returns, count, sigma_floor, H, g)
        _prior_offset(prior, candidate, offset)
        value = trust * total
        for i in range(3):
            for j in range(3):
                value -= 0.5 * offset[i] * prior_information[i, j] * offset[j]
        if value < best_value - 1e-9 and halvings < 4:
            halvings += 1
            for i in range(3):
                step[i] *= 0.5
            _move(best, step, candidate)
            continue
        if value < best_value - 1e-9:
            converged = True
            break
        halvings = 0
        gain = value - best_value
        best_value = value
        best_total = total
        best[:] = candidate
        # Where scans that err by some centimetres were drawn over each other the ridge is broad and
        # its curvature less than the Gaussian's. How much less, the last step tells: sᵀAs foreseen
        # against sᵀ(b − b') seen (Barzilai and Borwein, 1988).
        foreseen = 0.0
        seen = 0.0
        for i in range(3):
            seen += step[i] * b[i]
            for j in range(3):
                foreseen += step[i] * A[i, j] * step[j]
        for i in range(3):
            b[i] = trust * g[i]
            for j in range(3):
                A[i, j] = trust * H[i, j] + prior_information[i, j]
                b[i] -= prior_information[i, j] * offset[j]
                information[i, j] = trust * H[i, j]
            seen -= step[i] * b[i]
        stretch = 1.0
        if iterations > 1:
            stretch = MAX_STRETCH
            if seen * MAX_STRETCH > foreseen:
                stretch = max(foreseen / seen, 0.5)
        if not _solve3(A, b, step):
            break
        for i in range(3):
            step[i] *= stretch
        moved = math.sqrt(step[0] * step[0] + step[1] * step[1])
        if max(moved, abs(step[2])) < tolerance or gain < MIN_GAIN * abs(value):
            converged = True
            break
        _move(best, step, candidate)
    pose[:] = best
    score = best_total / full_weight if full_weight > 0.0 else 0.0
    return score, iterations, converged
