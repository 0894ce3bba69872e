"""Compiled walks through a grid cell by cell: what `world.ray_kernels` is measured against.

Lengths are in cells, as there; `solid` (h×w) has a solid rim.
"""

import math

import numpy as np
import numpy.typing as npt

from protocol.kernel import kernel
from protocol.pose import FloatArray

BoolArray = npt.NDArray[np.bool_]


@kernel
def walk_rays(
    solid: BoolArray, x: float, y: float, angles: FloatArray, limit: float, ranges: FloatArray
) -> None:
    """`ranges` (n) of rays at `angles` (n); each border is computed from the start, so that no
    rounding error adds up: the reference for being right."""
    for i in range(angles.shape[0]):
        dx, dy = math.cos(angles[i]), math.sin(angles[i])
        c, r = math.floor(x), math.floor(y)
        sx, sy = (-1 if dx < -1e-12 else 1), (-1 if dy < -1e-12 else 1)
        ix = 1.0 / dx if abs(dx) > 1e-12 else math.inf
        iy = 1.0 / dy if abs(dy) > 1e-12 else math.inf
        ex, ey = (sx + 1) // 2, (sy + 1) // 2
        t = 0.0
        while not solid[r, c]:
            tx, ty = (c + ex - x) * ix, (r + ey - y) * iy
            if tx < ty:
                t = tx
                c += sx
            else:
                t = ty
                r += sy
            if t > limit:
                t = math.inf
                break
        ranges[i] = t


@kernel
def dda_rays(
    solid: BoolArray, x: float, y: float, angles: FloatArray, limit: float, ranges: FloatArray
) -> None:
    """The same by additions alone, as Amanatides and Woo (1987) print it: the reference for being
    fast."""
    for i in range(angles.shape[0]):
        dx, dy = math.cos(angles[i]), math.sin(angles[i])
        c, r = math.floor(x), math.floor(y)
        sx, sy = (-1 if dx < -1e-12 else 1), (-1 if dy < -1e-12 else 1)
        step_x = abs(1.0 / dx) if abs(dx) > 1e-12 else math.inf
        step_y = abs(1.0 / dy) if abs(dy) > 1e-12 else math.inf
        tx = abs(c + (sx + 1) // 2 - x) * step_x
        ty = abs(r + (sy + 1) // 2 - y) * step_y
        t = 0.0
        while not solid[r, c]:
            if tx < ty:
                t = tx
                tx += step_x
                c += sx
            else:
                t = ty
                ty += step_y
                r += sy
            if t > limit:
                t = math.inf
                break
        ranges[i] = t
