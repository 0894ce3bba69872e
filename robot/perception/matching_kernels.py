"""Compiled loop of scan matching: reweighted least squares on a correlation field."""

import math

import numpy as np

from protocol.kernel import inlined, kernel
from protocol.pose_kernels import apply_inverse, compose, exp, wrap
from robot.perception.field_kernels import expected
from robot.perception.sampling_kernels import sample

# A Gauss-Newton step is made longer by at most this.
MAX_STRETCH = 5.0
# A climb is given up when at the last step's gain it would take so many more to get high enough.
PATIENCE = 10.0
# A step that gains less than this share is the last: kinks of the field keep it from being short.
MIN_GAIN = 3e-6


@inlined
def _prepare(returns, count, resolution, sigma_floor, points):
    """What stays the same from step to step (6×n): x and y in nodes, normal, weight, lever of a
    turn about the robot (m); the weight of all returns if nothing but noise displaced them."""
    full = 0.0
    for k in range(count):
        x, y, nx, ny = returns[k, 0], returns[k, 1], returns[k, 2], returns[k, 3]
        variance = returns[k, 5] * returns[k, 5]
        weight = returns[k, 4] * sigma_floor * sigma_floor / (sigma_floor * sigma_floor + variance)
        full += weight * expected(returns[k, 5], sigma_floor)
        points[0, k] = x / resolution
        points[1, k] = y / resolution
        points[2, k] = nx
        points[3, k] = ny
        points[4, k] = weight
        points[5, k] = ny * x - nx * y
    return full


@inlined
def _accumulate(field, origin, resolution, pose, points, sigma_floor, cells, samples, H, g):
    """Σ w M over all points; H and g take the normal equations in the tangent space at the pose.

    Iteratively reweighted least squares for Welsch's loss 1 − M: each return counts with weight M
    and residual −σ² ∇M / M, along its surface normal where it has one. What is not a sum goes
    through all points at once; `cells` and `samples` are the work space of that (see `sample`).
    """
    c = math.cos(pose[2])
    s = math.sin(pose[2])
    u0 = (pose[0] - origin[0]) / resolution
    v0 = (pose[1] - origin[1]) / resolution
    slope = 1.0 / resolution
    precision = 1.0 / (sigma_floor * sigma_floor)
    sample(field, u0, v0, c, s, points[0], points[1], cells, samples)
    weights, values, us, vs = points[4], samples[0], samples[1], samples[2]
    for k in range(weights.shape[0]):
        w = weights[k] if values[k] > 0.0 else 0.0
        gx = w * slope * (c * us[k] + s * vs[k])
        vs[k] = w * slope * (c * vs[k] - s * us[k])
        us[k] = gx
        values[k] = w * values[k]
    total = g0 = g1 = g2 = 0.0
    h00 = h01 = h11 = h02 = h12 = h22 = 0.0
    for k in range(weights.shape[0]):
        nx, ny, gx, gy = points[2, k], points[3, k], us[k], vs[k]
        total += values[k]
        curvature = values[k] * precision
        if nx != 0.0 or ny != 0.0:
            along = gx * nx + gy * ny
            lever = points[5, k]
            g0 += along * nx
            g1 += along * ny
            g2 += along * lever
            h00 += curvature * nx * nx
            h01 += curvature * nx * ny
            h11 += curvature * ny * ny
            h02 += curvature * nx * lever
            h12 += curvature * ny * lever
            h22 += curvature * lever * lever
        else:
            x = points[0, k] * resolution
            y = points[1, k] * resolution
            g0 += gx
            g1 += gy
            g2 += gy * x - gx * y
            h00 += curvature
            h11 += curvature
            h02 -= curvature * y
            h12 += curvature * x
            h22 += curvature * (x * x + y * y)
    g[0], g[1], g[2] = g0, g1, g2
    H[0, 0], H[1, 1], H[2, 2] = h00, h11, h22
    H[0, 1] = H[1, 0] = h01
    H[0, 2] = H[2, 0] = h02
    H[1, 2] = H[2, 1] = h12
    return total


@inlined
def solve3(A, b, out):
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
    exp(tangent, out)
    compose(pose, out, out)
    out[2] = wrap(out[2])


@inlined
def _prior_offset(prior, pose, out):
    """out = (prior⁻¹ ∘ pose) in the body frame of the pose: what the prior disagrees by."""
    x, y = apply_inverse(pose, prior[0], prior[1])
    out[0] = -x
    out[1] = -y
    out[2] = wrap(pose[2] - prior[2])


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
    prior_scale2,
    max_iterations,
    tolerance,
    wanted,
    pose,
    information,
):
    """Move `pose` uphill on trust · Σ w M − ½ c² ln(1 + |pose − prior|² / c²), c² = `prior_scale2`;
    (score, that value, iterations, converged).

    A climb that will not come to the score `wanted` is given up on its way. `information` (3×3)
    takes that of the returns alone, in the tangent space at the pose. The
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
    points = np.empty((6, count))
    cells = np.empty((6, count), dtype=np.int32)
    samples = np.empty((5, count))
    full_weight = _prepare(returns, count, resolution, sigma_floor, points)
    best_total = 0.0
    converged = False
    iterations = 0
    halvings = 0
    while iterations < max_iterations:
        iterations += 1
        total = _accumulate(
            field, origin, resolution, candidate, points, sigma_floor, cells, samples, H, g
        )
        _prior_offset(prior, candidate, offset)
        squared = 0.0
        for i in range(3):
            for j in range(3):
                squared += offset[i] * prior_information[i, j] * offset[j]
        value = trust * total - 0.5 * prior_scale2 * math.log1p(squared / prior_scale2)
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
        if wanted * full_weight - total > PATIENCE * gain:
            best_value, best_total = value, total
            best[:] = candidate
            break
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
        held = 1.0 / (1.0 + squared / prior_scale2)
        for i in range(3):
            b[i] = trust * g[i]
            for j in range(3):
                A[i, j] = trust * H[i, j] + held * prior_information[i, j]
                b[i] -= held * prior_information[i, j] * offset[j]
                information[i, j] = trust * H[i, j]
            seen -= step[i] * b[i]
        stretch = 1.0
        if iterations > 1:
            stretch = MAX_STRETCH
            if seen * MAX_STRETCH > foreseen:
                stretch = max(foreseen / seen, 0.5)
        if not solve3(A, b, step):
            break
        for i in range(3):
            step[i] *= stretch
        moved = math.sqrt(step[0] * step[0] + step[1] * step[1])
        if max(moved, abs(step[2])) < tolerance:
            _move(best, step, candidate)
            best[:] = candidate
            converged = True
            break
        if gain < MIN_GAIN * abs(value):
            converged = True
            break
        _move(best, step, candidate)
    pose[:] = best
    score = best_total / full_weight if full_weight > 0.0 else 0.0
    return score, best_value, iterations, converged
