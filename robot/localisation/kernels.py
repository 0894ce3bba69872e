"""Compiled loops of localisation in a known map: all places where a scan may have been taken."""

import heapq
import math

import numpy as np

from protocol.kernel import inlined, kernel
from robot.perception.search_kernels import bound_of

# Above any sum of a search: up to 128 points of 255 each.
MOST_TOTAL = 1 << 15


@inlined
def _is_near(found, count, angle, row, column, size, near_cells, near_angles, angles):
    """Whether a block of offsets lies wholly near one of the peaks found."""
    for k in range(count):
        apart = abs(angle - found[k, 1])
        apart = min(apart, angles - apart)
        if (
            apart < near_angles
            and abs(row - found[k, 2]) < near_cells
            and abs(row + size - 1 - found[k, 2]) < near_cells
            and abs(column - found[k, 3]) < near_cells
            and abs(column + size - 1 - found[k, 3]) < near_cells
        ):
            return True
    return False


@inlined
def _packed(total, level, angle, row, column):
    """A block and its bound in one number; the order of the numbers is that of the tuples
    (−total, level, angle, row, column), and a heap of them is several times as quick."""
    return ((MOST_TOTAL - total) << 48) | (level << 44) | (angle << 32) | (row << 16) | column


@inlined
def _bounds_of_quarters(pyramid, level, cells, angle, row, column, bounds):
    """`bound_of` for the four blocks of a level that one of the level above consists of: rows
    first, then columns."""
    rows = pyramid.shape[1]
    columns = pyramid.shape[2]
    half = 1 << level
    maxima = pyramid[level]
    bounds[0] = bounds[1] = bounds[2] = bounds[3] = 0
    for k in range(cells.shape[1]):
        r0 = cells[angle, k, 0] + row
        c0 = cells[angle, k, 1] + column
        r1 = r0 + half
        c1 = c0 + half
        # As in `bound_of`, of a block that starts before the grid the first node counts.
        if r0 < 0:
            r0 = 0 if r1 > 0 else -1
            r1 = 0 if -half < r1 < 0 else r1
        if c0 < 0:
            c0 = 0 if c1 > 0 else -1
            c1 = 0 if -half < c1 < 0 else c1
        if 0 <= r0 < rows:
            if 0 <= c0 < columns:
                bounds[0] += maxima[r0, c0]
            if 0 <= c1 < columns:
                bounds[1] += maxima[r0, c1]
        if 0 <= r1 < rows:
            if 0 <= c0 < columns:
                bounds[2] += maxima[r1, c0]
            if 0 <= c1 < columns:
                bounds[3] += maxima[r1, c1]


@kernel
def find_peaks(pyramid, open_cells, cells, floor, share, near_cells, near_angles, most, max_nodes):
    """The best offsets of rotated points on a field, each the best for some way around.

    `cells` (angles×points×2) are rows and columns of the points at each rotation of a full turn,
    for a robot in cell (0, 0); an offset is the cell of the robot, which must be one of
    `open_cells` (levels×rows×columns, maxima over blocks as those of the field). Best-first, as in
    `search_kernels.branch_and_bound`, so peaks come in order: until one has less than `share` of
    the best one's total, or `floor`, or there are `most`. Returns peaks (k×4: total, angle, row,
    column), whether the search came to its end within `max_nodes`, and the nodes it looked at.
    """
    rows = pyramid.shape[1]
    columns = pyramid.shape[2]
    angles = cells.shape[0]
    top = pyramid.shape[0] - 1
    size = 1 << top
    heap = [0]
    heap.clear()
    for angle in range(angles):
        for row in range(0, rows, size):
            for column in range(0, columns, size):
                if open_cells[top, row, column] > 0:
                    total = bound_of(pyramid, top, cells, angle, row, column)
                    if total > floor:
                        heap.append(_packed(total, top, angle, row, column))
    heapq.heapify(heap)
    found = np.zeros((most, 4), dtype=np.int64)
    bounds = np.zeros(4, dtype=np.int64)
    least = floor
    count = 0
    nodes = 0
    while len(heap) > 0 and count < most:
        packed = heapq.heappop(heap)
        total = MOST_TOTAL - (packed >> 48)
        level = (packed >> 44) & 0xF
        angle = (packed >> 32) & 0xFFF
        row = (packed >> 16) & 0xFFFF
        column = packed & 0xFFFF
        if count > 0 and total < share * found[0, 0]:
            return found[:count], True, nodes
        nodes += 1
        if nodes > max_nodes:
            return found[:count], False, nodes
        size = 1 << level
        if _is_near(found, count, angle, row, column, size, near_cells, near_angles, angles):
            continue
        if level == 0:
            found[count, 0] = total
            found[count, 1] = angle
            found[count, 2] = row
            found[count, 3] = column
            count += 1
            # What lies below the share ends the search: it need not come to the heap.
            least = max(floor, int(math.ceil(share * found[0, 0])) - 1)
            continue
        half = size >> 1
        _bounds_of_quarters(pyramid, level - 1, cells, angle, row, column, bounds)
        for i in range(4):
            r = row + (i >> 1) * half
            c = column + (i & 1) * half
            if r >= rows or c >= columns or open_cells[level - 1, r, c] == 0:
                continue
            if bounds[i] > least:
                heapq.heappush(heap, _packed(bounds[i], level - 1, angle, r, c))
    return found[:count], len(heap) == 0, nodes


@kernel
def blend(nodes, free, origin, resolution, free_resolution, T_field_part, part, part_free, at):
    """Draw a field (`part`, `part_free`, origin `at`) into a larger one where it lies in it: of
    walls the stronger, of free ground what either has seen."""
    c = np.cos(T_field_part[2])
    s = np.sin(T_field_part[2])
    for fine in range(2):
        step = resolution if fine else free_resolution
        source = part if fine else part_free
        target = nodes if fine else free
        height = source.shape[0] * step
        width = source.shape[1] * step
        low_x, low_y, high_x, high_y = np.inf, np.inf, -np.inf, -np.inf
        for i in range(2):
            for j in range(2):
                x = at[0] + i * width
                y = at[1] + j * height
                u = T_field_part[0] + c * x - s * y - origin[0]
                v = T_field_part[1] + s * x + c * y - origin[1]
                low_x, high_x = min(low_x, u), max(high_x, u)
                low_y, high_y = min(low_y, v), max(high_y, v)
        for row in range(max(0, int(low_y / step)), min(target.shape[0], int(high_y / step) + 2)):
            for column in range(
                max(0, int(low_x / step)), min(target.shape[1], int(high_x / step) + 2)
            ):
                x = origin[0] + column * step - T_field_part[0]
                y = origin[1] + row * step - T_field_part[1]
                u = (c * x + s * y - at[0]) / step
                v = (-s * x + c * y - at[1]) / step
                if fine == 0:
                    j, i = int(np.floor(u + 0.5)), int(np.floor(v + 0.5))
                    if 0 <= i < source.shape[0] and 0 <= j < source.shape[1] and source[i, j]:
                        target[row, column] = 1
                    continue
                j, i = int(np.floor(u)), int(np.floor(v))
                if i < 0 or j < 0 or i + 1 >= source.shape[0] or j + 1 >= source.shape[1]:
                    continue
                fu, fv = u - j, v - i
                value = (1.0 - fv) * ((1.0 - fu) * source[i, j] + fu * source[i, j + 1]) + fv * (
                    (1.0 - fu) * source[i + 1, j] + fu * source[i + 1, j + 1]
                )
                if value > target[row, column]:
                    target[row, column] = np.uint8(value)
