"""Compiled loops over correlation fields: drawing into them, looking up, laying a scan over them.

A field is a uint8 array of *nodes*: node (row, column) lies at origin + (column, row) * resolution
exactly, so that there is no half cell to forget. 255 is certainty.
"""

import math

import numpy as np

from protocol.kernel import inlined, kernel

FULL = 255.0
# A Gaussian is drawn to this many σ: beyond, it is three of 255 levels or less.
REACH_SIGMAS = 3.0
# exp(−d²/2σ²) over d²/σ², in steps of 1 / LEVELS_PER_UNIT.
LEVELS_PER_UNIT = 64.0
GAUSSIAN = np.exp(-0.5 * np.arange(int(REACH_SIGMAS**2 * LEVELS_PER_UNIT) + 2) / LEVELS_PER_UNIT)


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
    scale = LEVELS_PER_UNIT / (sigma * sigma)
    inverse_length2 = 1.0 / length2 if length2 > 0.0 else 0.0
    reach2 = reach * reach
    full = FULL * height
    for row in range(first_row, last_row + 1):
        for column in range(first_column, last_column + 1):
            px = column - ax
            py = row - ay
            t = min(1.0, max(0.0, (px * dx + py * dy) * inverse_length2))
            px -= t * dx
            py -= t * dy
            d2 = px * px + py * py
            if d2 > reach2:
                continue
            value = np.uint8(full * GAUSSIAN[int(scale * d2 + 0.5)] + 0.5)
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
def look_up(field, u, v):
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
def expected(sigma, sigma_floor):
    """Mean of M at a return of this σ, over a wall that was drawn from returns of the same σ."""
    return sigma_floor / math.sqrt(sigma_floor * sigma_floor + 2.0 * sigma * sigma)


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
    step = resolution
    for k in range(count):
        x, y, w = returns[k, 0], returns[k, 1], returns[k, 4]
        px = pose[0] + c * x - s * y - origin[0]
        py = pose[1] + s * x + c * y - origin[1]
        value, _, _ = look_up(field, px / resolution, py / resolution)
        if value >= hit_level * expected(returns[k, 5], sigma_floor):
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
