"""Compiled loops of patrolling: the roomiest block of each square of the plane."""

import math

import numpy as np

from protocol.kernel import kernel


@kernel
def roomiest(cost, clearance, centres, resolution, origin_x, origin_y, needed, wanted, square_m):
    """For each square (by x, then y) with blocks that can be got to, the index of its best block.

    Grids h×w: `cost` of travel (m, inf where there is none), `clearance` (m), and `centres`
    (h×w×2: row, column, in blocks of `resolution` m), where a robot stands on a block. The best
    has the most clearance, of that up to `wanted`, and is of those the nearest to the square's
    middle. Blocks with less than `needed` are none to stand on.
    """
    height, width = cost.shape
    left, low = math.floor(origin_x / square_m), math.floor(origin_y / square_m)
    columns = int(math.floor((origin_x + width * resolution) / square_m) - left) + 1
    rows = int(math.floor((origin_y + height * resolution) / square_m) - low) + 1
    best = np.full(columns * rows, -1, dtype=np.int64)
    room, off_middle = np.zeros(columns * rows), np.zeros(columns * rows)
    for row in range(height):
        for column in range(width):
            if clearance[row, column] < needed or not math.isfinite(cost[row, column]):
                continue
            x = (origin_x + centres[row, column, 1] * resolution) / square_m
            y = (origin_y + centres[row, column, 0] * resolution) / square_m
            square = int(math.floor(x) - left) * rows + int(math.floor(y) - low)
            clear = min(clearance[row, column], wanted)
            off = math.hypot(x - math.floor(x) - 0.5, y - math.floor(y) - 0.5)
            if (
                best[square] < 0
                or clear > room[square]
                or (clear == room[square] and off < off_middle[square])
            ):
                best[square] = row * width + column
                room[square], off_middle[square] = clear, off
    return best[best >= 0]
