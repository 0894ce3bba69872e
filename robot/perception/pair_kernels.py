"""Compiled loops that match one scan on another, return by return."""

import math

import numpy as np

from protocol.kernel import inlined, kernel
from robot.perception.matching_kernels import solve3

# Directions of surfaces are counted by the degree, and may be this many degrees off.
BINS = 360
BLUR = 5
# First bearings of the target's returns are looked up in so many sectors.
SECTORS = 512
# Surfaces whose normals differ by more than this (cosine) are not the same one.
SAME_SURFACE = 0.8
# Beyond the end of a surface it is believed to go on for so long.
OVERHANG_M = 0.1
# Returns farther off than this many σ (and what the reach allows) do not count; Cauchy's kernel
# makes light of those that come near that.
GATE_SIGMAS = 3.0
CAUCHY_SIGMAS = 1.5
# A reach below this is none.
LEAST_REACH_M = 0.01
MAX_ROUNDS_PER_REACH = 3
# While there is a reach, so many returns are one: it is the way there, not the answer.
THINNED = 3


@inlined
def _count_directions(returns, turn, counts):
    """Weight of the surfaces that face each degree of direction, after a turn."""
    counts[:] = 0.0
    for k in range(returns.shape[0]):
        nx = returns[k, 2]
        ny = returns[k, 3]
        if nx == 0.0 and ny == 0.0:
            continue
        if nx * returns[k, 0] + ny * returns[k, 1] > 0.0:
            nx = -nx
            ny = -ny
        place = (math.atan2(ny, nx) + turn) / (2.0 * math.pi) * BINS
        low = int(math.floor(place))
        share = place - low
        counts[low % BINS] += returns[k, 4] * (1.0 - share)
        counts[(low + 1) % BINS] += returns[k, 4] * share


@kernel
def turn_between(target, source, guess, window):
    """The turn (rad, within ± `window`) on top of the guessed heading of the source at which its
    surfaces face as those of the target do: wherever it stands, walls have their directions."""
    there = np.empty(BINS)
    here = np.empty(BINS)
    _count_directions(target, 0.0, there)
    _count_directions(source, guess, here)
    half = min(int(math.ceil(window / (2.0 * math.pi) * BINS)), BINS // 2)
    # Bins before the first and after the last, as far as the window goes, save remainders.
    blurred = np.zeros(BINS + 2 * half)
    for i in range(BINS + 2 * half):
        for d in range(1 - BLUR, BLUR):
            blurred[i] += there[(i - half + d) % BINS] * (BLUR - abs(d))
    best = -1.0
    turn = 0
    for offset in range(-half, half + 1):
        agreed = 0.0
        for i in range(BINS):
            agreed += here[i] * blurred[i + offset + half]
        if agreed > best:
            best = agreed
            turn = offset
    return turn * 2.0 * math.pi / BINS


@inlined
def _across(returns, k, noise):
    """Variance (m²) of a return across its surface: noise along a grazing ray does not count."""
    x = returns[k, 0]
    y = returns[k, 1]
    r2 = x * x + y * y
    r = math.sqrt(r2)
    facing2 = (x * returns[k, 2] + y * returns[k, 3]) ** 2 / r2
    sigma = noise[0] + noise[1] * r
    return (sigma * sigma + noise[2] * r) * facing2 + r2 * noise[3] ** 2 * (1.0 - facing2)


@inlined
def _leaning(returns, k, across):
    """Variance (rad²) of a return's normal: that of a line through as many points, as far apart, as
    it was fitted to, each with this variance across the line.

    How many they were follows from the return's own σ; one at least on each side.
    """
    count = returns.shape[0]
    before = k - 1 if k > 0 else count - 1
    after = k + 1 if k + 1 < count else 0
    dx = returns[after, 0] - returns[before, 0]
    dy = returns[after, 1] - returns[before, 1]
    spacing2 = 0.25 * (dx * dx + dy * dy)
    m = across / (returns[k, 5] * returns[k, 5])
    spread = max(m * (m * m - 1.0) / 12.0, 2.0) * spacing2
    return across / spread if spread > across else 1.0


@inlined
def _sector(x, y, first):
    """Which sector a bearing falls into, counted from the first return's."""
    turn = (math.atan2(y, x) - first) % (2.0 * math.pi)
    return min(int(turn / (2.0 * math.pi) * SECTORS), SECTORS - 1)


@inlined
def _nearest(target, rays, start, x, y):
    """The return of the target nearest to a point.

    Both ways from the point's own bearing, until a ray passes farther off than the best so far.
    """
    count = target.shape[0]
    best = 1e300
    nearest = -1
    for way in range(2):
        i = start if way == 0 else start - 1
        for _ in range(count):
            i %= count
            dx = target[i, 0] - x
            dy = target[i, 1] - y
            d2 = dx * dx + dy * dy
            if d2 < best:
                best = d2
                nearest = i
            beside = x * rays[i, 1] - y * rays[i, 0]
            if beside * beside >= best or x * rays[i, 0] + y * rays[i, 1] < 0.0:
                break
            i += 1 if way == 0 else -1
    return nearest


@inlined
def _offset(target, links, rays, i, x, y):
    """How far a point lies off the surface at return i: across it, and beyond its end."""
    nx = target[i, 2]
    ny = target[i, 3]
    dx = x - target[i, 0]
    dy = y - target[i, 1]
    along = dy * nx - dx * ny
    # Bearings grow along the surface, or against it: on which side is the neighbour?
    onwards = along if rays[i, 1] * nx - rays[i, 0] * ny > 0.0 else -along
    before = i - 1 if i > 0 else target.shape[0] - 1
    j = -1
    if onwards > 0.0 and links[i] == 1:
        j = i + 1 if i + 1 < target.shape[0] else 0
    elif onwards < 0.0 and links[before] == 1:
        j = before
    if j >= 0:
        sx = target[j, 0] - target[i, 0]
        sy = target[j, 1] - target[i, 1]
        length2 = sx * sx + sy * sy
        if length2 > 0.0:
            share = min(max((dx * sx + dy * sy) / length2, 0.0), 1.0)
            dx -= share * sx
            dy -= share * sy
    return dx * nx + dy * ny, abs(dy * nx - dx * ny)


@inlined
def _add_square(matrix, weight, x, y, turn):
    """Add weight · h hᵀ for h = (x, y, turn)."""
    matrix[0, 0] += weight * x * x
    matrix[0, 1] += weight * x * y
    matrix[0, 2] += weight * x * turn
    matrix[1, 1] += weight * y * y
    matrix[1, 2] += weight * y * turn
    matrix[2, 2] += weight * turn * turn
    matrix[1, 0] = matrix[0, 1]
    matrix[2, 0] = matrix[0, 2]
    matrix[2, 1] = matrix[1, 2]


@kernel
def match_pair(target, links, source, noise, reach, max_iterations, tolerance, pose, information):
    """Move `pose` (T_target_source) until the source's returns lie on the target's surfaces;
    (share of the returns with a normal that do, iterations, converged, held).

    Gauss-Newton on distances to the line through the nearest returns, each by the inverse of both
    scans' variance across the surface. `reach` (m) is added to what may be off at first, and halved
    to nothing. `information` (3×3) is in the tangent space at the pose. A normal that leans by an
    angle ε of noise would add E[ε²] g gᵀ to it, g being how h = (n, p × n) turns with the normal;
    that is taken off, and where it leaves nothing of some direction the pose is not `held`.
    """
    count = target.shape[0]
    rays = np.empty((count, 2))
    there = np.empty(count)
    leaning = np.empty(count)
    for i in range(count):
        r = math.sqrt(target[i, 0] ** 2 + target[i, 1] ** 2)
        rays[i, 0] = target[i, 0] / r
        rays[i, 1] = target[i, 1] / r
        there[i] = _across(target, i, noise)
        leaning[i] = _leaning(target, i, there[i])
    first = math.atan2(target[0, 1], target[0, 0])
    starts = np.zeros(SECTORS, dtype=np.int64)
    for i in range(count):
        starts[_sector(target[i, 0], target[i, 1], first)] = i
    for sector in range(1, SECTORS):
        starts[sector] = max(starts[sector], starts[sector - 1])
    here = np.empty(source.shape[0])
    for k in range(source.shape[0]):
        here[k] = _across(source, k, noise)
    gradient = np.empty(3)
    step = np.empty(3)
    imagined = np.empty((3, 3))
    converged = False
    share = 0.0
    iterations = 0
    rounds = 0
    while iterations < max_iterations:
        iterations += 1
        rounds += 1
        c = math.cos(pose[2])
        s = math.sin(pose[2])
        information[:, :] = 0.0
        imagined[:, :] = 0.0
        gradient[:] = 0.0
        seen = 0
        used = 0
        for k in range(0, source.shape[0], THINNED if reach > 0.0 else 1):
            if source[k, 2] == 0.0 and source[k, 3] == 0.0:
                continue
            seen += 1
            x = source[k, 0]
            y = source[k, 1]
            px = pose[0] + c * x - s * y
            py = pose[1] + s * x + c * y
            i = _nearest(target, rays, starts[_sector(px, py, first)], px, py)
            # The target's normal in the source's frame; nothing where it has none.
            nx = c * target[i, 2] + s * target[i, 3]
            ny = -s * target[i, 2] + c * target[i, 3]
            if abs(nx * source[k, 2] + ny * source[k, 3]) < SAME_SURFACE:
                continue
            off, beyond = _offset(target, links, rays, i, px, py)
            variance = there[i] + here[k]
            bound = GATE_SIGMAS * math.sqrt(variance) + reach
            if abs(off) > bound or beyond > OVERHANG_M + reach:
                continue
            used += 1
            scale = variance + 0.1 * reach * reach
            weight = 1.0 / (scale + off * off / CAUCHY_SIGMAS**2)
            lever = ny * x - nx * y
            gradient[0] -= weight * off * nx
            gradient[1] -= weight * off * ny
            gradient[2] -= weight * off * lever
            _add_square(information, weight, nx, ny, lever)
            if reach == 0.0:
                _add_square(imagined, weight * leaning[i], -ny, nx, nx * x + ny * y)
        share = used / seen if seen > 0 else 0.0
        if not solve3(information, gradient, step):
            break
        pose[0] += c * step[0] - s * step[1]
        pose[1] += s * step[0] + c * step[1]
        pose[2] += step[2]
        moved = max(math.sqrt(step[0] ** 2 + step[1] ** 2), abs(step[2]))
        converged = reach == 0.0 and moved < tolerance
        if converged:
            break
        if moved < 0.3 * reach or rounds >= MAX_ROUNDS_PER_REACH:
            rounds = 0
            reach *= 0.5
            if reach < LEAST_REACH_M:
                reach = 0.0
    information -= imagined
    return share, iterations, converged, solve3(information, gradient, step)
