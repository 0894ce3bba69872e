"""Compiled loops of frontiers: connected regions, their borders, and lines of sight.

Grids are H×W with row 0 at the lowest y; a block's index is `row * W + column`.
"""

import math

import numpy as np

from protocol.kernel import inlined, kernel
from robot.explore.planner_kernels import FREE


@kernel
def components(mask, diagonal):
    """Connected components of a mask: labels (int32, −1 outside the mask) and their sizes."""
    height, width = mask.shape
    labels = np.full((height, width), -1, dtype=np.int32)
    sizes = np.zeros(height * width, dtype=np.int64)
    stack = np.empty(height * width, dtype=np.int64)
    count = 0
    for first in range(height * width):
        if not mask[first // width, first % width] or labels[first // width, first % width] >= 0:
            continue
        labels[first // width, first % width] = count
        stack[0], depth = first, 1
        while depth > 0:
            depth -= 1
            row, column = stack[depth] // width, stack[depth] % width
            sizes[count] += 1
            for dr in range(-1, 2):
                for dc in range(-1, 2):
                    i, j = row + dr, column + dc
                    if i < 0 or j < 0 or i >= height or j >= width:
                        continue
                    if (diagonal or dr == 0 or dc == 0) and mask[i, j] and labels[i, j] < 0:
                        labels[i, j] = count
                        stack[depth] = i * width + j
                        depth += 1
        count += 1
    return labels, sizes[:count]


@kernel
def frontier_mask(state, unknown_labels, unknown_sizes, hiding_blocks):
    """Free blocks that touch, by a side, an unknown region large enough to hide something.

    A region that reaches the edge of the grid, and what lies beyond the edge, is large.
    """
    height, width = state.shape
    large = unknown_sizes >= hiding_blocks
    for row in range(height):
        for column in range(width):
            on_edge = row == 0 or column == 0 or row == height - 1 or column == width - 1
            if on_edge and unknown_labels[row, column] >= 0:
                large[unknown_labels[row, column]] = True
    mask = np.zeros((height, width), dtype=np.bool_)
    for row in range(height):
        for column in range(width):
            if state[row, column] != FREE:
                continue
            for dr, dc in ((1, 0), (-1, 0), (0, 1), (0, -1)):
                i, j = row + dr, column + dc
                if i < 0 or j < 0 or i >= height or j >= width:
                    mask[row, column] = True
                elif unknown_labels[i, j] >= 0 and large[unknown_labels[i, j]]:
                    mask[row, column] = True
    return mask


@kernel
def viewpoints(mask, state, cost, clearance, needed, offsets):
    """For each frontier block the nearest block, by `offsets` (k×2, sorted by distance), where
    the robot can stand and see it through free blocks: its index, or −1."""
    height, width = mask.shape
    views = np.full((height, width), -1, dtype=np.int64)
    for row in range(height):
        for column in range(width):
            if not mask[row, column]:
                continue
            for k in range(offsets.shape[0]):
                i, j = row + offsets[k, 0], column + offsets[k, 1]
                if i < 0 or j < 0 or i >= height or j >= width:
                    continue
                if clearance[i, j] < needed or not math.isfinite(cost[i, j]):
                    continue
                if _sees(state, row, column, i, j):
                    views[row, column] = i * width + j
                    break
    return views


@inlined
def _sees(state, row_a, column_a, row_b, column_b):
    steps = 2 * max(abs(row_b - row_a), abs(column_b - column_a))
    for k in range(1, steps):
        i = math.floor(row_a + 0.5 + (row_b - row_a) * k / steps)
        j = math.floor(column_a + 0.5 + (column_b - column_a) * k / steps)
        if state[i, j] != FREE:
            return False
    return True
