"""Compiled loops that draw scans into correlation fields: walls as ridges, free ground as cells."""

import math

import numpy as np

from protocol.kernel import inlined, kernel
from robot.perception.field_kernels import FRACTION_BITS, FULL, are_within, facing, fixed

# A Gaussian is drawn to this many σ: beyond, it is three of 255 levels or less.
REACH_SIGMAS = 3.0
# Nodes of a row are drawn in multiples of this, as many as vector instructions take at once.
LANES = 8
# exp(−4 y) = (exp(−y))⁴ is drawn by the best polynomial for exp(−y), y ≤ REACH_SIGMAS² / 8: to 2e-5
# of FULL.
BELL = tuple(np.float32(c) for c in (0.999997, -0.999732, 0.497026, -0.156018, 0.026562))
# Two segments go straight on, with such a cosine between them: beside the bend less than 0.08 of
# the reach is not drawn, where there is next to nothing.
STRAIGHT = 0.7
# Rays mark cells from where the two beside them, half as many, are farther apart than so many.
APART = 0.9
ZERO = np.float32(0.0)
HALF = np.float32(0.5)
ONE = np.float32(1.0)


@kernel
def draw_returns(field, used, origin, resolution, pose, returns, links, count, sigma_floor):
    """Raise the field to the Gaussian of every return, and of the segments between linked ones.

    `pose` (x, y, θ) maps the returns into the field's frame. `used` is widened (see `_widen`). A
    return with a larger σ than `sigma_floor` is drawn wider and, in the same measure, lower: a
    precise look beats a vague one.
    A mirrored scan draws the mirror image: with the σ of its first end alone for a segment all
    walls would be turned a little, the same way round.
    """
    c = math.cos(pose[2])
    s = math.sin(pose[2])
    points = np.empty((count, 2))
    for k in range(count):
        points[k, 0] = (pose[0] + c * returns[k, 0] - s * returns[k, 1] - origin[0]) / resolution
        points[k, 1] = (pose[1] + s * returns[k, 0] + c * returns[k, 1] - origin[1]) / resolution
    sides = _sides(points, links, count)
    first_row, last_row = field.shape[0], -1
    first_column, last_column = field.shape[1], -1
    for k in range(count):
        j = k
        if links[k] == 1:
            j = k + 1 if k + 1 < count else 0
        elif links[k - 1 if k > 0 else count - 1] == 1:
            continue  # it is the end of a segment
        variance = 0.5 * (returns[k, 5] ** 2 + returns[j, 5] ** 2)
        sigma = math.sqrt(sigma_floor * sigma_floor + variance)
        reach = REACH_SIGMAS * sigma / resolution
        ax, ay = points[k]
        bx, by = points[j]
        row0 = max(0, math.ceil(min(ay - reach * sides[k, 1], by - reach * sides[j, 1])))
        row1 = math.floor(max(ay + reach * sides[k, 1], by + reach * sides[j, 1]))
        row1 = min(field.shape[0] - 1, row1)
        column0 = max(0, math.ceil(min(ax - reach * sides[k, 0], bx - reach * sides[j, 0])))
        column1 = math.floor(max(ax + reach * sides[k, 0], bx + reach * sides[j, 0]))
        column1 = min(field.shape[1] - 1, column1)
        if column1 < column0 or row1 < row0:
            continue
        first_row, last_row = min(first_row, row0), max(last_row, row1)
        first_column, last_column = min(first_column, column0), max(last_column, column1)
        box = (row0, row1, column0, column1)
        _draw_segment(field, box, ax, ay, bx, by, sigma / resolution, sigma_floor / sigma)
    # Whole lanes are drawn, to the right, or to the left where the field ends.
    _widen(used, first_row, last_row, first_column - LANES, last_column + LANES)


@inlined
def _sides(points, links, count):
    """How far a ridge reaches from each of the points (n×2) along x and y, as a share of its reach.

    Where a line goes straight on, what lies beyond its end is nearer to the next segment: only what
    is beside it need be drawn. All round (1, 1), where it ends or bends.
    """
    across = np.zeros((count, 2))
    for k in range(count):
        if links[k] == 1:
            j = k + 1 if k + 1 < count else 0
            dx = points[j, 0] - points[k, 0]
            dy = points[j, 1] - points[k, 1]
            length = math.sqrt(dx * dx + dy * dy)
            if length > 0.0:
                across[k, 0] = -dy / length
                across[k, 1] = dx / length
    sides = np.ones((count, 2))
    for k in range(count):
        before = k - 1 if k > 0 else count - 1
        # 0 also where one of the two is no segment
        if across[before, 0] * across[k, 0] + across[before, 1] * across[k, 1] > STRAIGHT:
            sides[k, 0] = max(abs(across[before, 0]), abs(across[k, 0]))
            sides[k, 1] = max(abs(across[before, 1]), abs(across[k, 1]))
    return sides


@inlined
def _widen(used, first_row, last_row, first_column, last_column):
    """Make `used` (first and last row, first and last column) hold these rows and columns too."""
    if first_row <= last_row:
        used[0], used[1] = min(used[0], first_row), max(used[1], last_row)
        used[2], used[3] = min(used[2], first_column), max(used[3], last_column)


@inlined
def _draw_segment(field, box, ax, ay, bx, by, sigma, height):
    """Maximum of the field and a ridge over the segment a–b, in a box (rows, columns, both ends
    of each within the field, or a few columns more); all lengths in nodes.

    In single precision and without branches, so that a row of nodes is one vector.
    """
    first_row, last_row, first_column, last_column = box
    width = (last_column - first_column + LANES) // LANES * LANES
    first_column = max(0, min(first_column, field.shape[1] - width))
    # Only a field narrower than this box is not drawn up to its last column.
    width = min(width, field.shape[1] // LANES * LANES)
    dx = np.float32(bx - ax)
    dy = np.float32(by - ay)
    length2 = dx * dx + dy * dy
    inverse_length2 = ONE / length2 if length2 > ZERO else ZERO
    along_x = dx * inverse_length2
    along_y = dy * inverse_length2
    scale = np.float32(0.125 / (sigma * sigma))
    limit = np.float32(0.125 * REACH_SIGMAS * REACH_SIGMAS)
    full = np.float32(FULL * height)
    left = np.float32(first_column - ax)
    for row in range(first_row, last_row + 1):
        below = np.float32(row - ay)
        for start in range(0, width, LANES):
            line = field[row, first_column + start : first_column + start + LANES]
            for i in range(LANES):
                # 32 bits: there is no vector instruction that makes floats of 64.
                px = left + np.float32(np.int32(start + i))
                t = min(ONE, max(ZERO, px * along_x + below * along_y))
                px -= t * dx
                py = below - t * dy
                y = (px * px + py * py) * scale
                # What does not wait for each other side by side: a row takes as long as its chain.
                e = BELL[2] + y * BELL[3] + y * y * BELL[4]
                e = BELL[0] + y * BELL[1] + y * y * e
                e = e * e
                e = e * e if y <= limit else ZERO
                line[i] = max(line[i], np.uint8(np.int32(full * e + HALF)))


@kernel
def mark_free(free, used, origin, resolution, pose, returns, count, margin, max_range):
    """Set the cells (of a coarse grid) that rays passed, up to `margin` before their return.

    Near the robot rays lie close together: there few of them mark what all pass. `used` is widened
    (see `_widen`).
    """
    c = math.cos(pose[2])
    s = math.sin(pose[2])
    rows = np.uint64(free.shape[0])
    columns = np.uint64(free.shape[1])
    u = (pose[0] - origin[0]) / resolution + 0.5
    v = (pose[1] - origin[1]) / resolution + 0.5
    rays = np.empty((count, 3))  # direction, and how far it is free
    for k in range(count):
        x, y = returns[k, 0], returns[k, 1]
        r = math.sqrt(x * x + y * y)
        rays[k, 0] = (c * x - s * y) / r
        rays[k, 1] = (s * x + c * y) / r
        reach = r - margin / facing(returns, k, r) - 2.0 * returns[k, 5]
        rays[k, 2] = max(0.0, min(reach, max_range))
    left, right, low, high = u, u, v, v
    for k in range(count):
        reach = rays[k, 2]
        if reach <= 0.0:
            continue
        steps = int(reach / resolution) + 1
        stride = reach / (steps * resolution)
        column_step, row_step = fixed(rays[k, 0] * stride), fixed(rays[k, 1] * stride)
        first = int(_unmarked(rays, k, count, APART * resolution) / resolution)
        column_at = fixed(u) + first * column_step
        row_at = fixed(v) + first * row_step
        within = are_within(
            column_at, column_step, columns, row_at, row_step, rows, max(0, steps - 1 - first)
        )
        for _ in range(first, steps):
            column = np.uint64(column_at >> FRACTION_BITS)
            row = np.uint64(row_at >> FRACTION_BITS)
            if within or (row < rows and column < columns):
                free[row, column] = 1
            column_at += column_step
            row_at += row_step
        far = reach / resolution
        left, right = min(left, u + rays[k, 0] * far), max(right, u + rays[k, 0] * far)
        low, high = min(low, v + rays[k, 1] * far), max(high, v + rays[k, 1] * far)
    _widen(used, math.floor(low), math.floor(high), math.floor(left), math.floor(right))


@inlined
def _unmarked(rays, k, count, apart):
    """How far out ray k begins to mark cells that others leave out.

    Of every two neighbours the odd one begins where those beside it are `apart` or end; so, of the
    even ones, does every second, and so on.
    """
    level = k & -k
    if level == 0 or k + level >= count:
        return 0.0
    before, after = rays[k - level], rays[k + level]
    if before[0] * after[0] + before[1] * after[1] <= 0.0:
        return 0.0
    spread = abs(before[0] * after[1] - before[1] * after[0])
    marked = min(before[2], after[2], rays[k, 2])
    return min(marked, apart / spread) if spread > 0.0 else marked
