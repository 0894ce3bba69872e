"""Compiled loops of planning: distance to obstacles, cost of travel, shortcuts.

Grids are H×W with row 0 at the lowest y; a block's index is `row * W + column`.
"""

import math

import numpy as np

from protocol.kernel import inlined, kernel

UNKNOWN, FREE, OCCUPIED = -1, 0, 1
ESCAPE_PRICE = 10.0


@kernel
def coarsen(cells, stride, state):
    """Blocks of stride×stride cells (int8, as in OccupancyGrid) to FREE, OCCUPIED or UNKNOWN.

    A block is occupied if any of its cells is, else free if any is known: the slivers that fan
    out between far beams are narrower than a block. `state` is H/stride × W/stride, rounded up.
    """
    height, width = cells.shape
    for row in range(state.shape[0]):
        for column in range(state.shape[1]):
            block = UNKNOWN
            for i in range(row * stride, min((row + 1) * stride, height)):
                for j in range(column * stride, min((column + 1) * stride, width)):
                    if cells[i, j] >= 50:
                        block = OCCUPIED
                    elif cells[i, j] >= 0 and block == UNKNOWN:
                        block = FREE
            state[row, column] = block


@kernel
def bridge_slivers(state):
    """Set unknown blocks to free that lie between free ones, left and right or above and below."""
    height, width = state.shape
    bridged = state.copy()
    for row in range(1, height - 1):
        for column in range(1, width - 1):
            if state[row, column] == UNKNOWN and (
                (state[row, column - 1] == FREE and state[row, column + 1] == FREE)
                or (state[row - 1, column] == FREE and state[row + 1, column] == FREE)
            ):
                bridged[row, column] = FREE
    return bridged


@kernel
def block_clearance(cells, stride, state, resolution):
    """Metres (like `state`) from the best cell of each block to the nearest cell that is not free,
    and where in the block the best cells are on average (h×w×2: row, column, in blocks).

    Not free are occupied cells, unknown ones unless their block is free, and all outside the
    grid. The distance is exact, between centres of cells: Meijster, Roerdink, Hesselink, "A
    general algorithm for computing distance transforms in linear time", 2000. The best cell
    stands for its block, so that a passage that blocks straddle stays as wide as it is.
    """
    height, width = cells.shape
    block_of = np.arange(max(height, width)) // stride
    gaps = np.empty((height, width), dtype=np.int32)
    for row in range(height):
        for column in range(width):
            block = state[block_of[row], block_of[column]]
            blocked = (
                cells[row, column] >= 50
                or block == UNKNOWN
                or (block == OCCUPIED and cells[row, column] < 0)
            )
            above = gaps[row - 1, column] if row > 0 else 0
            gaps[row, column] = 0 if blocked else above + 1
    for row in range(height - 1, -1, -1):
        for column in range(width):
            below = gaps[row + 1, column] if row < height - 1 else 0
            gaps[row, column] = min(gaps[row, column], below + 1)
    squares = np.zeros((height, width), dtype=np.int32)
    site, start = np.empty(width + 2, dtype=np.int32), np.empty(width + 2, dtype=np.int32)
    for row in range(height):
        _row_squares(gaps[row], site, start, squares[row])
    clearance, centres = np.zeros(state.shape), np.empty((*state.shape, 2))
    for row in range(state.shape[0]):
        for column in range(state.shape[1]):
            best, count, i_sum, j_sum = -1, 0, 0, 0
            for i in range(row * stride, min((row + 1) * stride, height)):
                for j in range(column * stride, min((column + 1) * stride, width)):
                    if squares[i, j] > best:
                        best, count, i_sum, j_sum = squares[i, j], 0, 0, 0
                    if squares[i, j] == best:
                        count, i_sum, j_sum = count + 1, i_sum + i, j_sum + j
            clearance[row, column] = math.sqrt(best) * resolution
            centres[row, column, 0] = (i_sum / count + 0.5) / stride
            centres[row, column, 1] = (j_sum / count + 0.5) / stride
    return clearance, centres


@inlined
def _row_squares(gaps, site, start, squares):
    """The second phase: squared distances along one row.

    Each run of free cells has its own lower envelope of parabolas, for the blocked cell (or the
    outside) at either end of it is nearer to all of it than anything beyond.
    """
    width = gaps.shape[0]
    first = 0
    while first < width:
        if gaps[first] == 0:
            first += 1
            continue
        end = first
        while end < width and gaps[end] > 0:
            end += 1
        top = 0
        site[0], start[0] = first - 1, first
        for u in range(first, end + 1):
            square_u = 0 if u == end else gaps[u] * gaps[u]
            while top >= 0:
                s, t = site[top], start[top]
                square_s = 0 if s == first - 1 else gaps[s] * gaps[s]
                if (t - s) * (t - s) + square_s <= (t - u) * (t - u) + square_u:
                    break
                top -= 1
            begins = first
            if top >= 0:
                s = site[top]
                square_s = 0 if s == first - 1 else gaps[s] * gaps[s]
                begins = 1 + (u * u - s * s + square_u - square_s) // (2 * (u - s))
            if begins < end:
                top += 1
                site[top], start[top] = u, begins
        for u in range(end - 1, first - 1, -1):
            while start[top] > u:
                top -= 1
            s = site[top]
            square_s = 0 if s == first - 1 or s == end else gaps[s] * gaps[s]
            squares[u] = (u - s) * (u - s) + square_s
        first = end


@kernel
def travel_costs(state, clearance, extra, tight, needed, wanted, wall_cost, step_m, start_index):
    """Dijkstra from a block: cost (m, longer near walls) to and parent of every block.

    A metre costs 1 + `wall_cost`·(1 − clearance / `wanted`)² + `extra` (like `state`, ≥ 0). Blocks
    with clearance below `needed` are closed, except free ones, at ten times the price: to a robot
    that stands in one, until it has left, and to any if clearance is at least `tight`. Unreached
    blocks have infinite cost and parent −1.

    The queue is a ring of buckets as wide as the cheapest step, so that what is in the present
    bucket is final: Dial, "Shortest-path forest with topological ordering", 1969.
    """
    height, width = state.shape
    cost = np.full(height * width, np.inf)
    parent = np.full(height * width, -1, dtype=np.int64)
    dearest = math.sqrt(2.0) * max(ESCAPE_PRICE, 1.0 + wall_cost + extra.max())
    ring = int(math.ceil(dearest)) + 2
    head = np.full(ring, -1, dtype=np.int64)
    after = np.full(height * width, -1, dtype=np.int64)
    before = np.full(height * width, -1, dtype=np.int64)
    cost[start_index] = 0.0
    head[0] = start_index
    queued, bucket = 1, 0
    while queued > 0:
        index = head[bucket % ring]
        if index < 0:
            bucket += 1
            continue
        _unlink(head, after, before, index, bucket % ring)
        queued -= 1
        row, column = index // width, index % width
        escaping = clearance[row, column] < needed
        for dr in range(-1, 2):
            for dc in range(-1, 2):
                i, j = row + dr, column + dc
                if (dr == 0 and dc == 0) or i < 0 or j < 0 or i >= height or j >= width:
                    continue
                closed = clearance[i, j] < needed
                squeezed = escaping or clearance[i, j] >= tight
                if closed and (not squeezed or state[i, j] != FREE):
                    continue
                lack = max(0.0, 1.0 - clearance[i, j] / wanted)
                price = ESCAPE_PRICE if closed else 1.0 + wall_cost * lack * lack + extra[i, j]
                length = step_m * (math.sqrt(2.0) if dr != 0 and dc != 0 else 1.0)
                total = cost[index] + length * price
                neighbour = i * width + j
                if total < cost[neighbour]:
                    if math.isfinite(cost[neighbour]):
                        old = int(cost[neighbour] / step_m)
                        _unlink(head, after, before, neighbour, old % ring)
                        queued -= 1
                    cost[neighbour] = total
                    parent[neighbour] = index
                    slot = int(total / step_m) % ring
                    after[neighbour], before[neighbour] = head[slot], -1
                    if head[slot] >= 0:
                        before[head[slot]] = neighbour
                    head[slot] = neighbour
                    queued += 1
    return cost.reshape(height, width), parent


@inlined
def _unlink(head, after, before, index, slot):
    """Take a block out of the bucket that it is in."""
    if before[index] >= 0:
        after[before[index]] = after[index]
    else:
        head[slot] = after[index]
    if after[index] >= 0:
        before[after[index]] = before[index]


@kernel
def segment_clearance(clearance, row_a, column_a, row_b, column_b):
    """The least clearance of the blocks on a straight line between two points, in block units
    (block (i, j) covers [i, i + 1) × [j, j + 1)); 0 where the line leaves the grid."""
    height, width = clearance.shape
    steps = max(1, int(math.ceil(2.0 * max(abs(row_b - row_a), abs(column_b - column_a)))))
    least = np.inf
    for k in range(steps + 1):
        i = math.floor(row_a + (row_b - row_a) * k / steps)
        j = math.floor(column_a + (column_b - column_a) * k / steps)
        if i < 0 or j < 0 or i >= height or j >= width:
            return 0.0
        least = min(least, clearance[i, j])
    return least


@kernel
def shortcut(path, clearance, needed, wanted):
    """Indices of the points of a path (n×2: row, column in block units) that are enough.

    A straight piece may replace a part of the path if it keeps the clearance of that part, or
    the wanted one if that is less, and never less than the needed one: where the path itself has
    less (out of a tight start, past a teammate) it stays as it is.
    """
    n = path.shape[0]
    keep = np.empty(n, dtype=np.int64)
    keep[0], kept, i = 0, 1, 0
    while i < n - 1:
        farthest = i + 1
        least = np.inf
        for j in range(i + 1, n):
            row, column = int(path[j, 0]), int(path[j, 1])
            least = min(least, clearance[row, column])
            straight = segment_clearance(clearance, path[i, 0], path[i, 1], path[j, 0], path[j, 1])
            if straight >= max(needed, min(least, wanted)):
                farthest = j
            elif j - farthest > 20:
                break
        keep[kept] = farthest
        kept += 1
        i = farthest
    return keep[:kept]
