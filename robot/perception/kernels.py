"""Compiled loops of perception: surfaces of a scan, correlation fields, matching and search.

A field is a uint8 array of *nodes*: node (row, column) lies at origin + (column, row) * resolution
exactly, so that there is no half cell to forget. 255 is certainty.
"""

import heapq
import math

import numpy as np

from protocol.kernel import inlined, kernel

FULL = 255.0
# A Gaussian is drawn to this many σ: beyond, it is less than one of 255 levels.
REACH_SIGMAS = 3.3
# A Gauss-Newton step is made longer by at most this.
MAX_STRETCH = 5.0
# A step that gains less than this share is the last: kinks of the field keep it from being short.
MIN_GAIN = 3e-6


@kernel
def describe_returns(
    ranges, angles, increment, wraps, max_range, max_gap, normal_radius, spacing, noise, out, links
):
    """Points, surface normals, weights and σ of a scan's returns; the number of them is returned.

    `noise` = (σ at 0 m, growth per metre, variance per metre, σ of the angle). `out` (n×6) takes
    x, y, normal x, normal y, weight, σ; the normal is (0, 0) where the neighbours lie on no line.
    A return on a surface is moved onto the line through its neighbours, as far as noise explains,
    and its σ is the one across the surface: range noise along a grazing ray does not count there.
    `links[i]` is 1 when return i and the next lie on one surface.
    """
    n = ranges.shape[0]
    count = 0
    beam = np.empty(n, dtype=np.int64)
    for i in range(n):
        r = ranges[i]
        if math.isfinite(r) and r <= max_range:
            out[count, 0] = r * math.cos(angles[i])
            out[count, 1] = r * math.sin(angles[i])
            sigma_r = noise[0] + noise[1] * r
            variance = sigma_r * sigma_r + noise[2] * r + (r * noise[3]) ** 2
            out[count, 5] = math.sqrt(variance)
            beam[count] = i
            count += 1
    for k in range(count):
        links[k] = 0
        following = k + 1
        gap_beams = 0
        if following < count:
            gap_beams = beam[following] - beam[k]
        elif wraps and count > 1:
            following = 0
            gap_beams = n - beam[k] + beam[0]
        if gap_beams == 0 or gap_beams > 2:
            continue
        dx = out[following, 0] - out[k, 0]
        dy = out[following, 1] - out[k, 1]
        r = min(ranges[beam[k]], ranges[beam[following]])
        limit = max(3.0 * r * increment * gap_beams, 3.0 * spacing) + 3.0 * out[k, 5]
        if math.sqrt(dx * dx + dy * dy) < min(limit, max_gap):
            links[k] = 1
    shift = np.zeros(count)
    across = np.empty(count)
    for k in range(count):
        r = ranges[beam[k]]
        radius = max(normal_radius, 2.5 * r * increment, 4.0 * out[k, 5])
        nx, ny, near, shift[k] = _normal(out, links, count, k, radius)
        used = near
        if near < 3.0 and count > 2:
            before = (k - 1) % count
            after = (k + 1) % count
            if (beam[k] - beam[before]) % n <= 2 and (beam[after] - beam[k]) % n <= 2:
                nx, ny = _grazing_normal(out, before, k, after)
                used = 1.0
        out[k, 2] = nx
        out[k, 3] = ny
        out[k, 4] = min(1.0, r * increment / spacing)
        across[k] = out[k, 5]
        if nx != 0.0 or ny != 0.0:
            facing = (out[k, 0] * nx + out[k, 1] * ny) / r
            sigma_r = noise[0] + noise[1] * r
            along_ray = (sigma_r * sigma_r + noise[2] * r) * facing * facing
            sideways = (r * noise[3]) ** 2 * (1.0 - facing * facing)
            raw = math.sqrt(along_ray + sideways)
            across[k] = raw / math.sqrt(used)
            shift[k] = min(max(shift[k], -2.0 * raw), 2.0 * raw)
    for k in range(count):
        out[k, 0] += shift[k] * out[k, 2]
        out[k, 1] += shift[k] * out[k, 3]
        out[k, 5] = across[k]
    return count


@inlined
def _normal(out, links, count, k, radius):
    """Direction across the line through the linked neighbours of return k, (0, 0) for none; how
    many they are, itself among them; and how far the line passes from the return."""
    m = 1.0
    sx = 0.0
    sy = 0.0
    sxx = 0.0
    sxy = 0.0
    syy = 0.0
    x0 = out[k, 0]
    y0 = out[k, 1]
    for direction in (1, -1):
        j = k
        for _ in range(count - 1):
            step_from = j if direction == 1 else (j - 1) % count
            if links[step_from] == 0:
                break
            j = (j + direction) % count
            dx = out[j, 0] - x0
            dy = out[j, 1] - y0
            if dx * dx + dy * dy > radius * radius:
                break
            m += 1.0
            sx += dx
            sy += dy
            sxx += dx * dx
            sxy += dx * dy
            syy += dy * dy
    if m < 3.0:
        return 0.0, 0.0, m, 0.0
    sxx -= sx * sx / m
    sxy -= sx * sy / m
    syy -= sy * sy / m
    half_trace = 0.5 * (sxx + syy)
    root = math.sqrt(max(0.25 * (sxx - syy) ** 2 + sxy * sxy, 0.0))
    large = half_trace + root
    small = half_trace - root
    if small > 0.08 * large:
        return 0.0, 0.0, m, 0.0
    along = 0.5 * math.atan2(2.0 * sxy, sxx - syy)
    nx = -math.sin(along)
    ny = math.cos(along)
    return nx, ny, m, (sx * nx + sy * ny) / m


@inlined
def _grazing_normal(out, before, k, after):
    """Normal of a wall seen at so flat an angle that its returns lie far apart; (0, 0) for none.

    Taken for spots, such returns would hold the robot where the wall lets it slide.
    """
    dx = out[after, 0] - out[before, 0]
    dy = out[after, 1] - out[before, 1]
    length = math.sqrt(dx * dx + dy * dy)
    if length == 0.0:
        return 0.0, 0.0
    px = out[k, 0] - out[before, 0]
    py = out[k, 1] - out[before, 1]
    along = (px * dx + py * dy) / length
    across = (px * dy - py * dx) / length
    if along <= 0.0 or along >= length or abs(across) > 0.02 * length + 3.0 * out[k, 5]:
        return 0.0, 0.0
    return -dy / length, dx / length


@kernel
def draw_returns(field, origin, resolution, pose, returns, links, count, sigma_floor):
    """Raise the field to the Gaussian of every return, and of the segments between linked ones.

    `pose` (x, y, θ) maps the returns into the field's frame. A return with a larger σ than
    `sigma_floor` is drawn wider and, in the same measure, lower: a precise look beats a vague one.
    """
    c = math.cos(pose[2])
    s = math.sin(pose[2])
    for k in range(count):
        sigma = math.sqrt(sigma_floor * sigma_floor + returns[k, 5] ** 2)
        ax = (pose[0] + c * returns[k, 0] - s * returns[k, 1] - origin[0]) / resolution
        ay = (pose[1] + s * returns[k, 0] + c * returns[k, 1] - origin[1]) / resolution
        bx, by = ax, ay
        if links[k] == 1:
            j = k + 1 if k + 1 < count else 0
            bx = (pose[0] + c * returns[j, 0] - s * returns[j, 1] - origin[0]) / resolution
            by = (pose[1] + s * returns[j, 0] + c * returns[j, 1] - origin[1]) / resolution
        _draw_segment(field, ax, ay, bx, by, sigma / resolution, sigma_floor / sigma)


@inlined
def _draw_segment(field, ax, ay, bx, by, sigma, height):
    """Maximum of the field and a ridge over the segment a–b; all lengths in nodes."""
    reach = REACH_SIGMAS * sigma
    first_row = max(0, math.ceil(min(ay, by) - reach))
    last_row = min(field.shape[0] - 1, math.floor(max(ay, by) + reach))
    first_column = max(0, math.ceil(min(ax, bx) - reach))
    last_column = min(field.shape[1] - 1, math.floor(max(ax, bx) + reach))
    dx = bx - ax
    dy = by - ay
    length2 = dx * dx + dy * dy
    scale = -0.5 / (sigma * sigma)
    for row in range(first_row, last_row + 1):
        for column in range(first_column, last_column + 1):
            px = column - ax
            py = row - ay
            if length2 > 0.0:
                t = min(1.0, max(0.0, (px * dx + py * dy) / length2))
                px -= t * dx
                py -= t * dy
            d2 = px * px + py * py
            if d2 > reach * reach:
                continue
            value = np.uint8(FULL * height * math.exp(scale * d2) + 0.5)
            if value > field[row, column]:
                field[row, column] = value


@inlined
def _facing(returns, k, r):
    """Cosine between a ray and the normal of the surface it ends on: grazing rays run inside the
    ridge of a wall long before they end there."""
    if returns[k, 2] == 0.0 and returns[k, 3] == 0.0:
        return 1.0
    return max(abs(returns[k, 0] * returns[k, 2] + returns[k, 1] * returns[k, 3]) / r, 0.05)


@kernel
def mark_free(free, origin, resolution, pose, returns, count, margin, max_range):
    """Set the cells (of a coarse grid) that rays passed, up to `margin` before their return."""
    c = math.cos(pose[2])
    s = math.sin(pose[2])
    rows, columns = free.shape
    for k in range(count):
        x, y = returns[k, 0], returns[k, 1]
        r = math.sqrt(x * x + y * y)
        reach = min(r - margin / _facing(returns, k, r) - 2.0 * returns[k, 5], max_range)
        if reach <= 0.0:
            continue
        ux = (c * x - s * y) / r
        uy = (s * x + c * y) / r
        steps = int(reach / resolution) + 1
        for step in range(steps):
            d = reach * step / steps
            column = int(math.floor((pose[0] + d * ux - origin[0]) / resolution + 0.5))
            row = int(math.floor((pose[1] + d * uy - origin[1]) / resolution + 0.5))
            if 0 <= row < rows and 0 <= column < columns:
                free[row, column] = 1


@inlined
def _look_up(field, u, v):
    """Bilinear value and its gradient (per node) at column u, row v; zero outside."""
    column = int(math.floor(u))
    row = int(math.floor(v))
    if row < 0 or column < 0 or row + 1 >= field.shape[0] or column + 1 >= field.shape[1]:
        return 0.0, 0.0, 0.0
    fu = u - column
    fv = v - row
    a = float(field[row, column])
    b = float(field[row, column + 1])
    c = float(field[row + 1, column])
    d = float(field[row + 1, column + 1])
    low = a + fu * (b - a)
    high = c + fu * (d - c)
    value = low + fv * (high - low)
    return value / FULL, ((1.0 - fv) * (b - a) + fv * (d - c)) / FULL, (high - low) / FULL


@inlined
def _expected(sigma, sigma_floor):
    """Mean of M at a return of this σ, over a wall that was drawn from returns of the same σ."""
    return sigma_floor / math.sqrt(sigma_floor * sigma_floor + 2.0 * sigma * sigma)


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
        value, du, dv = _look_up(field, u, v)
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
        full_weight += returns[k, 4] * share * _expected(returns[k, 5], sigma_floor)
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
        # its curvature less than the Gaussian's. How much less, the last step tells: sᵀAs expected
        # against sᵀ(b − b') seen (Barzilai and Borwein, 1988).
        expected = 0.0
        seen = 0.0
        for i in range(3):
            seen += step[i] * b[i]
            for j in range(3):
                expected += step[i] * A[i, j] * step[j]
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
            if seen * MAX_STRETCH > expected:
                stretch = max(expected / seen, 0.5)
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


@kernel
def overlay(
    field,
    origin,
    resolution,
    free,
    free_resolution,
    pose,
    returns,
    count,
    sigma_floor,
    hit_level,
    margin,
):
    """How a scan lies on a submap: (weight compared, weight of hits, rays traced, rays crossing).

    A return is compared where the submap knows the place: as wall (a hit) or as free (a miss). A
    ray crosses when it meets a wall of the submap that is `margin` or more in front of its own.
    """
    c = math.cos(pose[2])
    s = math.sin(pose[2])
    compared = 0.0
    hits = 0.0
    traced = 0.0
    crossing = 0.0
    step = 0.5 * resolution
    for k in range(count):
        x, y, w = returns[k, 0], returns[k, 1], returns[k, 4]
        px = pose[0] + c * x - s * y - origin[0]
        py = pose[1] + s * x + c * y - origin[1]
        value, _, _ = _look_up(field, px / resolution, py / resolution)
        if value >= hit_level * _expected(returns[k, 5], sigma_floor):
            compared += w
            hits += w
        else:
            column = int(math.floor(px / free_resolution + 0.5))
            row = int(math.floor(py / free_resolution + 0.5))
            if 0 <= row < free.shape[0] and 0 <= column < free.shape[1] and free[row, column]:
                compared += w
        r = math.sqrt(x * x + y * y)
        reach = r - margin / _facing(returns, k, r) - 3.0 * returns[k, 5]
        if reach <= 0.0:
            continue
        traced += 1.0
        ux = (c * x - s * y) / r
        uy = (s * x + c * y) / r
        steps = int(reach / step)
        for i in range(steps):
            column = int(math.floor((pose[0] + i * step * ux - origin[0]) / resolution + 0.5))
            row = int(math.floor((pose[1] + i * step * uy - origin[1]) / resolution + 0.5))
            inside = 0 <= row < field.shape[0] and 0 <= column < field.shape[1]
            if not inside or field[row, column] < 200:
                continue
            # What the submap itself has seen through is no wall: people, legs of chairs.
            row = int(math.floor(row * resolution / free_resolution + 0.5))
            column = int(math.floor(column * resolution / free_resolution + 0.5))
            if row < free.shape[0] and column < free.shape[1] and free[row, column] == 0:
                crossing += 1.0
                break
    return compared, hits, traced, crossing


@kernel
def build_pyramid(field, levels):
    """Maxima over 2^level × 2^level nodes that start at each node: levels×rows×columns.

    Level 0 is the field at half its resolution (maximum of 2 × 2 nodes), which is what is searched.
    """
    rows = (field.shape[0] + 1) // 2
    columns = (field.shape[1] + 1) // 2
    pyramid = np.zeros((levels, rows, columns), dtype=np.uint8)
    for row in range(field.shape[0]):
        for column in range(field.shape[1]):
            value = field[row, column]
            if value > pyramid[0, row // 2, column // 2]:
                pyramid[0, row // 2, column // 2] = value
    for level in range(1, levels):
        half = 1 << (level - 1)
        for row in range(rows):
            for column in range(columns):
                best = pyramid[level - 1, row, column]
                if row + half < rows:
                    best = max(best, pyramid[level - 1, row + half, column])
                if column + half < columns:
                    best = max(best, pyramid[level - 1, row, column + half])
                if row + half < rows and column + half < columns:
                    best = max(best, pyramid[level - 1, row + half, column + half])
                pyramid[level, row, column] = best
    return pyramid


@inlined
def _bound(pyramid, level, cells, angle, row, column):
    """Sum over the points of the maxima of a block of offsets that starts at (row, column)."""
    rows = pyramid.shape[1]
    columns = pyramid.shape[2]
    size = 1 << level
    total = 0
    for k in range(cells.shape[1]):
        r = cells[angle, k, 0] + row
        c = cells[angle, k, 1] + column
        # A block that starts before the grid still reaches into it; its first node is what counts.
        if r < 0 and r + size > 0:
            r = 0
        if c < 0 and c + size > 0:
            c = 0
        if 0 <= r < rows and 0 <= c < columns:
            total += pyramid[level, r, c]
    return total


@kernel
def branch_and_bound(
    pyramid, cells, half_rows, half_columns, exclusion_cells, exclusion_angles, floor, max_nodes
):
    """Best offset of rotated points on a field, and the best one elsewhere; all in search cells.

    `cells` (angles×points×2) are rows and columns of the points at each rotation, at offset 0.
    Offsets within ±half_rows, ±half_columns are searched best-first, so that the first leaf met is
    the best of all; the second result is the best leaf outside the exclusion zone round it, or
    (angle −1) a bound on it. Returns best (total, angle, row, column), second (the same), nodes.
    After Olson, "Real-time correlative scan matching", 2009 and Hess et al., "Real-time loop
    closure in 2D lidar SLAM", 2016.
    """
    top = pyramid.shape[0] - 1
    size = 1 << top
    heap = [(0, 0, 0, 0, 0)]
    heap.clear()
    for angle in range(cells.shape[0]):
        for row in range(-half_rows, half_rows + 1, size):
            for column in range(-half_columns, half_columns + 1, size):
                total = _bound(pyramid, top, cells, angle, row, column)
                if total > floor:
                    heap.append((-total, top, angle, row, column))
    heapq.heapify(heap)
    best = (0, -1, 0, 0)
    second = (0, -1, 0, 0)
    nodes = 0
    while len(heap) > 0:
        negative, level, angle, row, column = heapq.heappop(heap)
        nodes += 1
        if best[1] >= 0:
            size = 1 << level
            near_rows = abs(row - best[2]) < exclusion_cells and (
                abs(row + size - 1 - best[2]) < exclusion_cells
            )
            near_columns = abs(column - best[3]) < exclusion_cells and (
                abs(column + size - 1 - best[3]) < exclusion_cells
            )
            if near_rows and near_columns and abs(angle - best[1]) < exclusion_angles:
                continue
        if nodes > max_nodes:
            if best[1] >= 0:
                second = (-negative, -1, 0, 0)
            break
        if level == 0:
            if best[1] < 0:
                best = (-negative, angle, row, column)
                continue
            second = (-negative, angle, row, column)
            break
        half = 1 << (level - 1)
        for i in range(2):
            for j in range(2):
                r = row + i * half
                c = column + j * half
                if r > half_rows or c > half_columns:
                    continue
                total = _bound(pyramid, level - 1, cells, angle, r, c)
                if total > floor:
                    heapq.heappush(heap, (-total, level - 1, angle, r, c))
    return best, second, nodes
