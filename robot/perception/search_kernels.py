"""Compiled loops of exhaustive search: block maxima of a field, branch and bound over poses."""

import heapq
import math

import numpy as np

from protocol.kernel import inlined, kernel
from robot.perception.field_kernels import look_up

# Nodes of a field to a search cell, in each direction.
NODES_PER_CELL = 4


@kernel
def block_maxima(field, first_row, first_column, rows, columns):
    """Maxima over rows × columns cells of a field, of which the first begins at the given node."""
    maxima = np.zeros((rows, columns), dtype=np.uint8)
    strip = np.zeros(columns * NODES_PER_CELL, dtype=np.uint8)
    width = min(columns * NODES_PER_CELL, field.shape[1] - first_column)
    for row in range(rows):
        strip[:] = 0
        start = first_row + row * NODES_PER_CELL
        for r in range(start, min(start + NODES_PER_CELL, field.shape[0])):
            line = field[r, first_column : first_column + width]
            for column in range(width):
                strip[column] = max(strip[column], line[column])
        for column in range(columns):
            k = column * NODES_PER_CELL
            maxima[row, column] = max(strip[k], strip[k + 1], strip[k + 2], strip[k + 3])
    return maxima


@kernel
def cells_under(points, x, y, theta, half_m, half_rad, origin, resolution, node_rows, node_columns):
    """First row and column, rows and columns of the search cells of a field in which points (n×2)
    can lie that are moved by up to `half_m` and turned by up to `half_rad` from (x, y, theta)."""
    c = math.cos(theta)
    s = math.sin(theta)
    left = bottom = math.inf
    right = top = -math.inf
    farthest = 0.0
    for k in range(points.shape[0]):
        px = x + c * points[k, 0] - s * points[k, 1]
        py = y + s * points[k, 0] + c * points[k, 1]
        left, right = min(left, px), max(right, px)
        bottom, top = min(bottom, py), max(top, py)
        farthest = max(farthest, math.hypot(points[k, 0], points[k, 1]))
    reach = half_m + farthest * min(half_rad, 2.0)
    size = resolution * NODES_PER_CELL
    last_row = (node_rows - 1) // NODES_PER_CELL
    last_column = (node_columns - 1) // NODES_PER_CELL
    row = min(max(math.floor((bottom - reach - origin[1]) / size), 0), last_row)
    column = min(max(math.floor((left - reach - origin[0]) / size), 0), last_column)
    end_row = min(max(math.ceil((top + reach - origin[1]) / size), row + 1), last_row + 1)
    end_column = min(
        max(math.ceil((right + reach - origin[0]) / size), column + 1), last_column + 1
    )
    return row, column, end_row - row, end_column - column


@kernel
def build_pyramid(cells, levels):
    """Maxima over 2^level × 2^level cells that start at each cell: levels×rows×columns."""
    rows, columns = cells.shape
    pyramid = np.empty((levels, rows, columns), dtype=np.uint8)
    pyramid[0] = cells
    strip = np.empty(columns, dtype=np.uint8)
    for level in range(1, levels):
        half = 1 << (level - 1)
        for row in range(rows):
            near = pyramid[level - 1, row]
            far = pyramid[level - 1, min(row + half, rows - 1)]
            for column in range(columns):
                strip[column] = max(near[column], far[column])
            out = pyramid[level, row]
            for column in range(columns - half):
                out[column] = max(strip[column], strip[column + half])
            for column in range(max(0, columns - half), columns):
                out[column] = strip[column]
    return pyramid


@kernel
def rotated_cells(points, angles, x, y, origin, resolution):
    """Rows and columns (angles×n×2) of the cells that points (n×2) lie in, turned by each angle
    about (x, y)."""
    cells = np.empty((angles.shape[0], points.shape[0], 2), dtype=np.int64)
    for a in range(angles.shape[0]):
        c = math.cos(angles[a])
        s = math.sin(angles[a])
        for k in range(points.shape[0]):
            column = (x + c * points[k, 0] - s * points[k, 1] - origin[0]) / resolution
            row = (y + s * points[k, 0] + c * points[k, 1] - origin[1]) / resolution
            # Cell k holds the nodes n·k … n·k + n − 1; what is nearest to a node counts as on it.
            cells[a, k, 0] = int(math.floor(row + 0.5)) // NODES_PER_CELL
            cells[a, k, 1] = int(math.floor(column + 0.5)) // NODES_PER_CELL
    return cells


@inlined
def bound_of(pyramid, level, cells, angle, row, column):
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


@inlined
def _coarsest_blocks(pyramid, cells, half_rows, half_columns, floor):
    """A heap of the blocks of offsets that may hold more than the floor, of the largest size:
    (minus its bound, level, angle, first row, first column)."""
    top = pyramid.shape[0] - 1
    size = 1 << top
    heap = [(0, 0, 0, 0, 0)]
    heap.clear()
    for angle in range(cells.shape[0]):
        for row in range(-half_rows, half_rows + 1, size):
            for column in range(-half_columns, half_columns + 1, size):
                total = bound_of(pyramid, top, cells, angle, row, column)
                if total > floor:
                    heap.append((-total, top, angle, row, column))
    heapq.heapify(heap)
    return heap


@kernel
def branch_and_bound(
    pyramid,
    cells,
    turns,
    half_rows,
    half_columns,
    exclusion_cells,
    exclusion_turn,
    floor,
    share,
    max_nodes,
):
    """Best offset of rotated points on a field, and the best one elsewhere; all in search cells.

    `cells` (angles×points×2) are rows and columns of the points at each rotation, at offset 0;
    `turns` (angles) the rotations themselves, in the unit of `exclusion_turn`. Offsets within
    ±half_rows, ±half_columns are searched best-first, so that the first leaf met is the best of
    all; the second result is the best leaf outside the exclusion zone round it, or (angle −1) a
    bound on it, where none has more than `share` of the best. Returns best (total, angle, row,
    column), second (the same), nodes.
    After Olson, "Real-time correlative scan matching", 2009 and Hess et al., "Real-time loop
    closure in 2D lidar SLAM", 2016.
    """
    heap = _coarsest_blocks(pyramid, cells, half_rows, half_columns, floor)
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
            if near_rows and near_columns and abs(turns[angle] - turns[best[1]]) < exclusion_turn:
                continue
        if nodes > max_nodes or -negative < share * best[0]:
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
                total = bound_of(pyramid, level - 1, cells, angle, r, c)
                if total > floor:
                    heapq.heappush(heap, (-total, level - 1, angle, r, c))
    return best, second, nodes


@inlined
def _is_near(found, count, turns, angle, row, column, size, exclusion_cells, exclusion_turn):
    """Whether a block of offsets lies wholly in the exclusion zone of one of the peaks found."""
    for k in range(count):
        if (
            abs(turns[angle] - turns[found[k, 1]]) < exclusion_turn
            and abs(row - found[k, 2]) < exclusion_cells
            and abs(row + size - 1 - found[k, 2]) < exclusion_cells
            and abs(column - found[k, 3]) < exclusion_cells
            and abs(column + size - 1 - found[k, 3]) < exclusion_cells
        ):
            return True
    return False


@kernel
def find_peaks(
    pyramid,
    cells,
    turns,
    half_rows,
    half_columns,
    exclusion_cells,
    exclusion_turn,
    floor,
    share,
    most,
    max_nodes,
):
    """The best offsets of rotated points on a field, each outside the exclusion zones of better
    ones; all as in `branch_and_bound`.

    They come in order, until one has less than `share` of the best or there are `most`. Returns
    peaks (k×4: total, angle, row, column).
    """
    heap = _coarsest_blocks(pyramid, cells, half_rows, half_columns, floor)
    found = np.zeros((most, 4), dtype=np.int64)
    count = 0
    nodes = 0
    while len(heap) > 0 and count < most:
        negative, level, angle, row, column = heapq.heappop(heap)
        nodes += 1
        if nodes > max_nodes or -negative < share * found[0, 0]:
            break
        size = 1 << level
        if _is_near(found, count, turns, angle, row, column, size, exclusion_cells, exclusion_turn):
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
                if r > half_rows or c > half_columns:
                    continue
                total = bound_of(pyramid, level - 1, cells, angle, r, c)
                if total > floor:
                    heapq.heappush(heap, (-total, level - 1, angle, r, c))
    return found[:count]


@kernel
def best_nearby(field, origin, resolution, points, centre, reach, steps, turn, best):
    """`best` takes the pose with the most of the field under the points (n×2), of those on a grid
    of ± `steps` steps over ± `reach` (m) in x and y, at −1, 0 and 1 times `turn` (rad)."""
    most = -1.0
    for i in range(-1, 2):
        theta = centre[2] + i * turn
        c = math.cos(theta)
        s = math.sin(theta)
        for row in range(-steps, steps + 1):
            y = centre[1] + row * reach / steps - origin[1]
            for column in range(-steps, steps + 1):
                x = centre[0] + column * reach / steps - origin[0]
                total = 0.0
                for k in range(points.shape[0]):
                    u = (x + c * points[k, 0] - s * points[k, 1]) / resolution
                    v = (y + s * points[k, 0] + c * points[k, 1]) / resolution
                    value, _, _ = look_up(field, u, v)
                    total += value
                if total > most:
                    most = total
                    best[0] = x + origin[0]
                    best[1] = y + origin[1]
                    best[2] = theta
