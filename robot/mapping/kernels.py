"""Compiled loops of occupancy mapping: a scan into counts, counts into cells."""

import math

import numpy as np

from protocol.kernel import inlined, kernel

MISSED, HIT = 1, 2


@kernel
def beam_extents(
    ranges, angles, max_range, hit_range, noise_floor, noise_slope, noise_root, resolution, grazing
):
    """How far each beam (n) shows free space, and where it shows an obstacle (NaN if nowhere).

    The standard deviation of a range is `noise_floor + noise_slope·r + noise_root·√r`; a beam
    clears up to two of them before its end. Along a wall seen at a grazing angle a beam runs
    within a cell of the wall for long before it ends: that stretch (at most `grazing` metres)
    says nothing. The angle comes from the nearer of the two neighbouring returns, so that the
    edge of a door frame is not taken for a wall in the direction of the beam.
    """
    n = ranges.shape[0]
    clear, hit = np.zeros(n), np.full(n, np.nan)
    for i in range(n):
        r = ranges[i]
        if not r > 0.0:
            continue
        if r > max_range:
            clear[i] = max_range
            continue
        x, y = r * math.cos(angles[i]), r * math.sin(angles[i])
        sine = 0.0
        for neighbour in ((i - 1) % n, (i + 1) % n):
            rn = ranges[neighbour]
            if math.isfinite(rn):
                dx = rn * math.cos(angles[neighbour]) - x
                dy = rn * math.sin(angles[neighbour]) - y
                gap = math.hypot(dx, dy)
                if gap > 0.0:
                    across = abs(dx * math.sin(angles[i]) - dy * math.cos(angles[i]))
                    sine = max(sine, across / gap)
        margin = grazing if sine * grazing < resolution else resolution / sine
        sigma = noise_floor + noise_slope * r + noise_root * math.sqrt(r)
        clear[i] = r - max(margin, 2.0 * sigma)
        if r <= hit_range:
            hit[i] = r
    return clear, hit


@kernel
def count_scan(
    hits, misses, first_row, first_column, resolution, x, y, theta, clear, hit, angles, sign
):
    """Add (sign 1) or take out (sign −1) one scan.

    In one scan a cell counts once, as hit if any beam ended in it, else as missed if any beam
    crossed it: otherwise the many beams that cross a cell near the robot would outvote all later
    views of it. `hits`, `misses`: H×W counts, whose cell (0, 0) is cell (`first_row`,
    `first_column`) of the plane; they must cover the scan.
    """
    n = angles.shape[0]
    reach = 0.0
    for i in range(n):
        reach = max(reach, clear[i])
        if not math.isnan(hit[i]):
            reach = max(reach, hit[i] + resolution)
    half = int(math.ceil(reach / resolution)) + 1
    centre_row, centre_column = math.floor(y / resolution), math.floor(x / resolution)
    marks = np.zeros((2 * half + 1, 2 * half + 1), dtype=np.uint8)
    # What a mark at (0, 0) is in the plane, and in the arrays.
    row0, column0 = centre_row - half, centre_column - half
    dr, dc = row0 - first_row, column0 - first_column
    for i in range(n):
        if math.isnan(hit[i]):
            continue
        # A surface is the near side of an obstacle: the obstacle's cell is half a cell behind.
        r = hit[i] + 0.5 * resolution
        column = math.floor((x + r * math.cos(theta + angles[i])) / resolution) - column0
        row = math.floor((y + r * math.sin(theta + angles[i])) / resolution) - row0
        if marks[row, column] == 0:
            marks[row, column] = HIT
            hits[row + dr, column + dc] += sign
    for i in range(n):
        _count_beam(
            misses, marks, dr, dc,
            x / resolution - column0, y / resolution - row0,
            math.cos(theta + angles[i]), math.sin(theta + angles[i]), clear[i] / resolution, sign,
        )  # fmt: skip


@inlined
def _count_beam(misses, marks, dr, dc, x, y, dx, dy, length, sign):
    """Walk every cell that a beam crosses (Amanatides, Woo 1987), in units of cells."""
    if length <= 0.0:
        return
    column, row = math.floor(x), math.floor(y)
    step_x, step_y = (1 if dx > 0.0 else -1), (1 if dy > 0.0 else -1)
    per_x = 1.0 / abs(dx) if dx != 0.0 else np.inf
    per_y = 1.0 / abs(dy) if dy != 0.0 else np.inf
    next_x = ((column + 1 - x) if dx > 0.0 else (x - column)) * per_x if dx != 0.0 else np.inf
    next_y = ((row + 1 - y) if dy > 0.0 else (y - row)) * per_y if dy != 0.0 else np.inf
    while True:
        if marks[row, column] == 0:
            marks[row, column] = MISSED
            misses[row + dr, column + dc] += sign
        if next_x < next_y:
            if next_x > length:
                return
            column += step_x
            next_x += per_x
        else:
            if next_y > length:
                return
            row += step_y
            next_y += per_y


@kernel
def content_box(hits, misses):
    """First row, first column, end row, end column of what is known; all zero if nothing is."""
    height, width = hits.shape
    top, left, bottom, right = height, width, -1, -1
    for row in range(height):
        for column in range(width):
            if hits[row, column] + misses[row, column] > 0:
                top, bottom = min(top, row), row
                left, right = min(left, column), max(right, column)
    if bottom < 0:
        return 0, 0, 0, 0
    return top, left, bottom + 1, right + 1


@kernel
def render(hits, misses, top, left, cells, hit_weight):
    """Fill `cells` (h×w int8) with −1 or the share of hits in percent, from (top, left) on.

    Returns how many cells are known. What lies beyond the counts is unknown.
    """
    height, width = cells.shape
    known = 0
    for row in range(height):
        for column in range(width):
            i, j = top + row, left + column
            cells[row, column] = -1
            if 0 <= i < hits.shape[0] and 0 <= j < hits.shape[1]:
                weighted = hit_weight * hits[i, j]
                total = weighted + misses[i, j]
                if total > 0:
                    cells[row, column] = (100 * weighted + total // 2) // total
                    known += 1
    return known
