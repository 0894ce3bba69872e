"""Compiled loops of localisation in a known map: all places where a scan may have been taken."""

import heapq

import numpy as np

from protocol.kernel import inlined, kernel
from robot.perception.search_kernels import bound_of


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


@kernel
def find_peaks(pyramid, open_cells, cells, floor, share, near_cells, near_angles, most, max_nodes):
    """The best offsets of rotated points on a field, each the best for some way around.

    `cells` (angles×points×2) are rows and columns of the points at each rotation of a full turn,
    for a robot in cell (0, 0); an offset is the cell of the robot, which must be one of
    `open_cells` (levels×rows×columns, maxima over blocks as those of the field). Best-first, as in
    `search_kernels.branch_and_bound`, so peaks come in order: until one has less than `share` of
    the best one's total, or `floor`, or there are `most`. Returns peaks (k×4: total, angle, row,
    column), and whether the search came to its end within `max_nodes`.
    """
    rows = pyramid.shape[1]
    columns = pyramid.shape[2]
    angles = cells.shape[0]
    top = pyramid.shape[0] - 1
    size = 1 << top
    heap = [(0, 0, 0, 0, 0)]
    heap.clear()
    for angle in range(angles):
        for row in range(0, rows, size):
            for column in range(0, columns, size):
                if open_cells[top, row, column] > 0:
                    total = bound_of(pyramid, top, cells, angle, row, column)
                    if total > floor:
                        heap.append((-total, top, angle, row, column))
    heapq.heapify(heap)
    found = np.zeros((most, 4), dtype=np.int64)
    count = 0
    nodes = 0
    while len(heap) > 0 and count < most:
        negative, level, angle, row, column = heapq.heappop(heap)
        if count > 0 and -negative < share * found[0, 0]:
            return found[:count], True
        nodes += 1
        if nodes > max_nodes:
            return found[:count], False
        size = 1 << level
        if _is_near(found, count, angle, row, column, size, near_cells, near_angles, angles):
            continue
        if level == 0:
            found[count, 0] = -negative
            found[count, 1] = angle
            found[count, 2] = row
            found[count, 3] = column
            count += 1
            continue
        half = 1 << (level - 1)
        for i in range(2):
            for j in range(2):
                r = row + i * half
                c = column + j * half
                if r >= rows or c >= columns or open_cells[level - 1, r, c] == 0:
                    continue
                total = bound_of(pyramid, level - 1, cells, angle, r, c)
                if total > floor:
                    heapq.heappush(heap, (-total, level - 1, angle, r, c))
    return found[:count], len(heap) == 0


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
