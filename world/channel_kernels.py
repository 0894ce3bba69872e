"""The compiled power budget of radio links: path loss, walls, shadowing.

Lengths are in cells, as in `ray_kernels`; losses are in dB.
"""

import math

import numpy as np
import numpy.typing as npt

from protocol.kernel import inlined, kernel
from protocol.pose import FloatArray

BoolArray = npt.NDArray[np.bool_]


@inlined
def solid_between(
    solid: BoolArray, x: float, y: float, to_x: float, to_y: float, enough: float
) -> float:
    """The length of a segment that lies in solid cells, or something above `enough`.

    The walk of Amanatides and Woo, "A fast voxel traversal algorithm", 1987. Outside the grid
    nothing is known and all is solid.
    """
    height, width = solid.shape
    length = math.hypot(to_x - x, to_y - y)
    if length == 0.0:
        return 0.0
    dx, dy = (to_x - x) / length, (to_y - y) / length
    c, r = math.floor(x), math.floor(y)
    sx, sy = (-1 if dx < 0.0 else 1), (-1 if dy < 0.0 else 1)
    ix = 1.0 / dx if dx != 0.0 else math.inf
    iy = 1.0 / dy if dy != 0.0 else math.inf
    ex, ey = (sx + 1) // 2, (sy + 1) // 2
    t = inside = 0.0
    while t < length and inside <= enough:
        # Beside an axis-parallel ray lies a border that it never reaches: 0 · ∞ must not decide.
        tx = (c + ex - x) * ix if dx != 0.0 else math.inf
        ty = (r + ey - y) * iy if dy != 0.0 else math.inf
        after = min(tx, ty, length)
        if r < 0 or c < 0 or r >= height or c >= width or solid[r, c]:
            inside += after - t
        t = after
        if tx < ty:
            c += sx
        else:
            r += sy
    return inside


@inlined
def shadow(waves: FloatArray, x: float, y: float, to_x: float, to_y: float, length: float) -> float:
    """The shadowing of a link in standard deviations: the same from both ends.

    A sum of `waves` (K×5: the wave vector at either end, a phase) over the places of both ends,
    as in Wang, Tameh and Nix, "Joint shadowing process in urban peer-to-peer radio channels",
    2008, made symmetric and of variance 1. Its correlation decays as exp(−δ / length) when an end
    moves by δ (Gudmundson, "Correlation model for shadow fading in mobile radio systems", 1991).
    """
    total = 0.0
    for k in range(waves.shape[0]):
        ux, uy, vx, vy = waves[k, 0], waves[k, 1], waves[k, 2], waves[k, 3]
        phase = waves[k, 4]
        total += math.cos(ux * x + uy * y + vx * to_x + vy * to_y + phase)
        total += math.cos(ux * to_x + uy * to_y + vx * x + vy * y + phase)
    # Both halves are one and the same where the ends meet, and independent when far apart.
    alike = math.exp(-2.0 * math.hypot(to_x - x, to_y - y) / length)
    return total / math.sqrt(waves.shape[0] * (1.0 + alike))


@inlined
def too_weak(
    solid: BoolArray,
    x: float,
    y: float,
    to_x: float,
    to_y: float,
    budget: FloatArray,
    waves: FloatArray,
) -> bool:
    """Whether a link up to reach long has less than nothing left of its budget.

    `budget` (5): the reach; the exponent, so that over the distance r there are
    10 · exponent · log10(reach / r) dB to lose; what walls take (dB per cell that the link runs
    through them); the standard deviation (dB) of shadowing and its decorrelation length.
    """
    reach, exponent, wall_db = budget[0], budget[1], budget[2]
    sigma_db, length = budget[3], budget[4]
    apart = math.hypot(to_x - x, to_y - y)
    if apart == 0.0 or apart > reach:
        return False
    left = 10.0 * exponent * math.log10(reach / apart)
    if sigma_db > 0.0:
        left -= sigma_db * shadow(waves, x, y, to_x, to_y, length)
    if left < 0.0 or wall_db == 0.0:
        return left < 0.0
    enough = left / wall_db
    return solid_between(solid, x, y, to_x, to_y, enough) > enough


@kernel
def fade_from(
    solid: BoolArray,
    x: float,
    y: float,
    points: FloatArray,
    budget: FloatArray,
    waves: FloatArray,
    faded: BoolArray,
) -> None:
    """`faded` (n): `points` (n×2) in reach of (x, y) where the signal is too weak."""
    for i in range(points.shape[0]):
        faded[i] = too_weak(solid, x, y, points[i, 0], points[i, 1], budget, waves)


@kernel
def fade_all(
    solid: BoolArray,
    points: FloatArray,
    budget: FloatArray,
    waves: FloatArray,
    faded: BoolArray,
) -> None:
    """`faded` (T×n×n): pairs in reach of each other whose signal is too weak, at each row of
    `points` (T×n×2)."""
    ticks, n = points.shape[0], points.shape[1]
    for tick in range(ticks):
        for i in range(n):
            x, y = points[tick, i, 0], points[tick, i, 1]
            faded[tick, i, i] = False
            for k in range(i + 1, n):
                to_x, to_y = points[tick, k, 0], points[tick, k, 1]
                weak = too_weak(solid, x, y, to_x, to_y, budget, waves)
                faded[tick, i, k] = faded[tick, k, i] = weak
