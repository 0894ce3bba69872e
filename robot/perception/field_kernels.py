"""Compiled loops over correlation fields: looking up, laying a scan over them.

A field is a uint8 array of *nodes*: node (row, column) lies at origin + (column, row) * resolution
exactly, so that there is no half cell to forget. 255 is certainty.
"""

import math

import numpy as np

from protocol.kernel import inlined, kernel

FULL = 255.0
SHARE = 1.0 / FULL
# Rays step in fixed point, with so many bits behind the point: 1e-9 of a cell after any ray.
FRACTION_BITS = 40
FRACTION = float(1 << FRACTION_BITS)


@inlined
def facing(returns, k, r):
    """Cosine between a ray and the normal of the surface it ends on: grazing rays run inside the
    ridge of a wall long before they end there."""
    if returns[k, 2] == 0.0 and returns[k, 3] == 0.0:
        return 1.0
    return max(abs(returns[k, 0] * returns[k, 2] + returns[k, 1] * returns[k, 3]) / r, 0.05)


@inlined
def fixed(x):
    """A number in fixed point: where a ray is by addition alone, and its cell by a shift."""
    return np.int64(math.floor(x * FRACTION + 0.5))


@inlined
def are_within(column_at, column_step, columns, row_at, row_step, rows, steps):
    """Whether all cells of a ray in fixed point lie within a grid: where both ends do."""
    # What is below 0 is very large.
    return (
        np.uint64(column_at >> FRACTION_BITS) < columns
        and np.uint64(row_at >> FRACTION_BITS) < rows
        and np.uint64((column_at + steps * column_step) >> FRACTION_BITS) < columns
        and np.uint64((row_at + steps * row_step) >> FRACTION_BITS) < rows
    )


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
    du = (1.0 - fv) * (b - a) + fv * (d - c)
    return value * SHARE, du * SHARE, (high - low) * SHARE


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
    u = (pose[0] - origin[0]) / resolution + 0.5
    v = (pose[1] - origin[1]) / resolution + 0.5
    rows = np.uint64(field.shape[0])
    columns = np.uint64(field.shape[1])
    shrink = resolution / free_resolution
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
        reach = r - margin / facing(returns, k, r) - 3.0 * returns[k, 5]
        if reach <= 0.0:
            continue
        traced += 1.0
        stride = 1.0 / r
        column_at, column_step = fixed(u), fixed((c * x - s * y) * stride)
        row_at, row_step = fixed(v), fixed((s * x + c * y) * stride)
        steps = int(reach / resolution)
        within = are_within(
            column_at, column_step, columns, row_at, row_step, rows, max(0, steps - 1)
        )
        for _ in range(steps):
            column = np.uint64(column_at >> FRACTION_BITS)
            row = np.uint64(row_at >> FRACTION_BITS)
            column_at += column_step
            row_at += row_step
            if not (within or (row < rows and column < columns)) or field[row, column] < 200:
                continue
            # What the submap itself has seen through is no wall: people, legs of chairs.
            free_row = int(row * shrink + 0.5)
            free_column = int(column * shrink + 0.5)
            inside = free_row < free.shape[0] and free_column < free.shape[1]
            if inside and free[free_row, free_column] == 0:
                crossing += 1.0
                break
    return compared, hits, traced, crossing
