"""Compiled loops over the terrain: rays and scans.

All lengths inside are in cells and cell (r, c) covers [c, c+1) × [r, r+1). The grid has a rim of
solid cells, so that a ray cannot leave it. `squares[q, r, c]` (4×h×w, uint8) is the side of the
largest square of free cells that has cell (r, c) as its corner and extends in quadrant q: 0 (+x,
+y), 1 (−x, +y), 2 (+x, −y), 3 (−x, −y). It is 0 where the cell is solid.
"""

import math

import numpy as np
import numpy.typing as npt

from protocol.kernel import inlined, kernel
from protocol.pose import FloatArray

BoolArray = npt.NDArray[np.bool_]
ByteArray = npt.NDArray[np.uint8]


@kernel
def free_squares(solid: BoolArray) -> ByteArray:
    """`squares` of a boolean grid h×w whose rim is solid; sides are capped at 255."""
    height, width = solid.shape
    squares = np.zeros((4, height, width), np.uint8)
    for q in range(4):
        sx, sy = 1 - 2 * (q & 1), 1 - (q & 2)
        for i in range(1, height - 1):
            r = height - 1 - i if sy > 0 else i
            for j in range(1, width - 1):
                c = width - 1 - j if sx > 0 else j
                if not solid[r, c]:
                    side = min(
                        squares[q, r + sy, c],
                        squares[q, r, c + sx],
                        squares[q, r + sy, c + sx],
                    )
                    squares[q, r, c] = min(side + 1, 255)
    return squares


@inlined
def crossed(
    start: float,
    slope: float,
    inverse: float,
    first: int,
    step: int,
    most: int,
    t: float,
    inclusive: bool,
) -> int:
    """How many of the next `most` cell borders (at first, first + step, …) a ray that starts at
    `start` has crossed at t. Decided by the very numbers that a walk cell by cell compares, so
    that skipping cells changes nothing, not even the last bit."""
    # The guess may be off by a rounding error; the comparisons below settle it.
    guess = (start + t * slope - first) * step + 1.0
    count = min(max(int(guess), 0), most)
    while count < most:
        border = (first + step * count - start) * inverse
        if not (border < t or (inclusive and border == t)):
            break
        count += 1
    while count > 0:
        border = (first + step * (count - 1) - start) * inverse
        if border < t or (inclusive and border == t):
            break
        count -= 1
    return count


@inlined
def cast(squares: ByteArray, x: float, y: float, dx: float, dy: float, limit: float) -> float:
    """The range (cells) at which a ray enters its first solid cell, +inf beyond `limit`.

    Amanatides and Woo, "A fast voxel traversal algorithm", 1987, over squares of free cells in
    place of single ones. A ray through a corner enters the row first.
    """
    c, r = math.floor(x), math.floor(y)
    # Nearly axis-parallel rays never cross the borders of the other axis.
    sx = -1 if dx < -1e-12 else 1
    sy = -1 if dy < -1e-12 else 1
    ix = 1.0 / dx if abs(dx) > 1e-12 else math.inf
    iy = 1.0 / dy if abs(dy) > 1e-12 else math.inf
    ex, ey = (sx + 1) // 2, (sy + 1) // 2
    field = squares[(1 - sx) // 2 + (1 - sy)]
    t = 0.0
    side = int(field[r, c])
    while side > 0:
        tx = (c + sx * (side - 1) + ex - x) * ix
        ty = (r + sy * (side - 1) + ey - y) * iy
        if tx < ty:
            t = tx
            if side > 1:
                r += sy * crossed(y, dy, iy, r + ey, sy, side - 1, t, True)
            c += sx * side
        else:
            t = ty
            if side > 1:
                c += sx * crossed(x, dx, ix, c + ex, sx, side - 1, t, False)
            r += sy * side
        if t > limit:
            return math.inf
        side = int(field[r, c])
    return t


@kernel
def cast_rays(
    squares: ByteArray,
    x: float,
    y: float,
    angles: FloatArray,
    limit: float,
    ranges: FloatArray,
) -> None:
    """`ranges` (n) of rays from one point, at `angles` (n); cells, +inf beyond `limit`."""
    for i in range(angles.shape[0]):
        ranges[i] = cast(squares, x, y, math.cos(angles[i]), math.sin(angles[i]), limit)


@inlined
def cast_disc(dx: float, dy: float, to_x: float, to_y: float, radius: float) -> float:
    """The range at which a ray enters a disc at (to_x, to_y) from its start; +inf if it misses."""
    along = dx * to_x + dy * to_y
    aside2 = to_x * to_x + to_y * to_y - along * along
    half2 = radius * radius - aside2
    if half2 <= 0.0 or along <= 0.0:
        return math.inf
    return max(along - math.sqrt(half2), 0.0)


@kernel
def scan_all(
    squares: ByteArray,
    poses: FloatArray,
    radius: float,
    angles: FloatArray,
    turned: FloatArray,
    noise: FloatArray,
    min_range: float,
    max_range: float,
    sigma: FloatArray,
    cell: float,
    ranges: npt.NDArray[np.float32],
) -> None:
    """Eq. 14 of the paper: what range finders at `poses` (n×3: cells, cells, rad) report.

    Beam j of robot i really points at angles[j] + turned[i, j]; `noise` (n×m) is standard normal
    and σ_r = sigma[0] + sigma[1] r + √(sigma[2] r) at range r. The other robots are discs of
    `radius` (cells). `cell` is metres per cell; the other lengths and `ranges` (n×m, float32) are
    metres: 0 below `min_range`, +inf where nothing is hit within `max_range`.
    """
    n, m = turned.shape
    near = np.empty((n, 2))
    limit = max_range / cell
    for i in range(n):
        x, y, heading = poses[i, 0], poses[i, 1], poses[i, 2]
        count = 0
        for k in range(n):
            to_x, to_y = poses[k, 0] - x, poses[k, 1] - y
            if k != i and math.hypot(to_x, to_y) <= limit + radius:
                near[count, 0], near[count, 1] = to_x, to_y
                count += 1
        for j in range(m):
            angle = heading + angles[j] + turned[i, j]
            dx, dy = math.cos(angle), math.sin(angle)
            t = cast(squares, x, y, dx, dy, limit)
            for k in range(count):
                t = min(t, cast_disc(dx, dy, near[k, 0], near[k, 1], radius))
            true = t * cell
            if true > max_range:
                ranges[i, j] = math.inf
                continue
            spread = sigma[0] + sigma[1] * true + math.sqrt(sigma[2] * true)
            reported = true + spread * noise[i, j]
            if reported < min_range:
                ranges[i, j] = 0.0
            elif reported > max_range:
                ranges[i, j] = math.inf
            else:
                ranges[i, j] = reported


@kernel
def sights(
    squares: ByteArray, poses: FloatArray, radius: float, limit: float, visible: BoolArray
) -> None:
    """`visible` (n×n): which robots see which, within `limit` (cells): no wall and no other disc
    on the segment between the centres."""
    n = poses.shape[0]
    for i in range(n):
        for k in range(i + 1, n):
            to_x, to_y = poses[k, 0] - poses[i, 0], poses[k, 1] - poses[i, 1]
            distance = math.hypot(to_x, to_y)
            seen = 0.0 < distance <= limit
            if seen:
                dx, dy = to_x / distance, to_y / distance
                seen = cast(squares, poses[i, 0], poses[i, 1], dx, dy, distance) == math.inf
                for other in range(n):
                    if seen and other not in (i, k):
                        by_x, by_y = poses[other, 0] - poses[i, 0], poses[other, 1] - poses[i, 1]
                        seen = cast_disc(dx, dy, by_x, by_y, radius) >= distance
            visible[i, k] = seen
            visible[k, i] = seen
