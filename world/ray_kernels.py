"""Compiled loops over the terrain: rays and scans.

All lengths inside are in cells and cell (r, c) covers [c, c+1) × [r, r+1). The grid has a rim of
solid cells, so that a ray cannot leave it. The square of a cell in a quadrant, 0 (+x, +y), 1 (−x,
+y), 2 (+x, −y) or 3 (−x, −y), is the largest one of free cells that has the cell as its corner and
extends into that quadrant; its side is 0 where the cell is solid. `squares` (4×⌈h/8⌉×⌈w/8⌉×64,
uint8) holds the sides by quadrant in tiles of 8 × 8 cells; `side_at` finds one.
"""

import math

import numpy as np
import numpy.typing as npt

from protocol.kernel import inlined, kernel
from protocol.pose import FloatArray

BoolArray = npt.NDArray[np.bool_]
ByteArray = npt.NDArray[np.uint8]
IntArray = npt.NDArray[np.int64]

# Far above what rounding does to coordinates of any map, in cells, and far below a cell.
BESIDE = 1e-7
# A direction with less of an axis in it does not move along that axis.
PARALLEL = 1e-12


@inlined
def side_at(field: ByteArray, r: int, c: int) -> int:
    """The side of the square of cell (r, c), of one quadrant's tiles.

    A tile is a line of the processor's cache: whichever way a ray goes, most of its next look-ups
    are near by, and in few pages of memory.
    """
    return int(field[r >> 3, c >> 3, (r & 7) << 3 | (c & 7)])


@kernel
def tiled(sides: ByteArray) -> ByteArray:
    """`squares`, from what `free_squares` gives."""
    quadrants, height, width = sides.shape
    squares = np.zeros((quadrants, (height + 7) >> 3, (width + 7) >> 3, 64), np.uint8)
    for q in range(quadrants):
        for r in range(height):
            for c in range(width):
                squares[q, r >> 3, c >> 3, (r & 7) << 3 | (c & 7)] = sides[q, r, c]
    return squares


@kernel
def free_squares(solid: BoolArray) -> ByteArray:
    """The sides (4×h×w) of a boolean grid h×w whose rim is solid, at most 255."""
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
def cell_beside(
    start: float,
    inverse_slope: float,
    cell: int,
    step: int,
    most: int,
    t: float,
    inclusive: bool,
) -> int:
    """The row (or column) at t of a ray beside a border; it was in `cell` and crosses at most
    `most` borders.

    Rounding could put the ray on either side. The very numbers decide that a walk cell by cell
    compares, so that skipping cells changes not a bit.
    """
    border = cell + (step + 1) // 2
    for _ in range(most):
        reached = (border - start) * inverse_slope
        if reached > t or (reached == t and not inclusive):
            break
        cell += step
        border += step
    return cell


@inlined
def leap(
    x: float,
    y: float,
    dx: float,
    dy: float,
    ix: float,
    iy: float,
    c: int,
    r: int,
    side: int,
) -> tuple[float, int, int]:
    """Where a ray leaves the free square of `side` cells ahead of cell (r, c): t, and the column
    and row that it enters. A ray through a corner enters the row first."""
    # Selections in place of branches: which border comes first is a toss-up for the processor.
    left, down = int(dx < -PARALLEL), int(dy < -PARALLEL)
    sx, sy = 1 - 2 * left, 1 - 2 * down
    next_c, next_r = c + sx * side, r + sy * side
    tx = (next_c + left - x) * ix
    ty = (next_r + down - y) * iy
    sideways = tx < ty
    t = tx if sideways else ty
    start, slope = (y, dy) if sideways else (x, dx)
    at = start + slope * t
    along = int(at)
    if not BESIDE < at - along < 1.0 - BESIDE:
        if sideways:
            along = cell_beside(y, iy, r, sy, side - 1, t, True)
        else:
            along = cell_beside(x, ix, c, sx, side - 1, t, False)
    return t, (next_c if sideways else along), (along if sideways else next_r)


@inlined
def inverse(slope: float) -> float:
    """1 / slope; rays that are nearly parallel to an axis never cross the other one's borders."""
    return 1.0 / slope if abs(slope) > PARALLEL else math.inf


@inlined
def quadrant(dx: float, dy: float) -> int:
    """The quadrant of `squares` that a ray points into."""
    return int(dx < -PARALLEL) + 2 * int(dy < -PARALLEL)


@inlined
def cast(squares: ByteArray, x: float, y: float, dx: float, dy: float, limit: float) -> float:
    """The range (cells) at which a ray enters its first solid cell, +inf beyond `limit`.

    Amanatides and Woo, "A fast voxel traversal algorithm", 1987, over squares of free cells in
    place of single ones.
    """
    c, r = math.floor(x), math.floor(y)
    ix, iy = inverse(dx), inverse(dy)
    field = squares[quadrant(dx, dy)]
    t = 0.0
    side = side_at(field, r, c)
    while side > 0:
        t, c, r = leap(x, y, dx, dy, ix, iy, c, r, side)
        if t > limit:
            return math.inf
        side = side_at(field, r, c)
    return t


@inlined
def cast_fan(
    squares: ByteArray,
    x: float,
    y: float,
    limit: float,
    slopes: FloatArray,
    cells: IntArray,
    ranges: FloatArray,
) -> None:
    """`cast` for many rays from one point, all of them one leap at a time.

    The leaps of one ray wait for each other's memory and comparisons; those of different rays do
    not, and the processor works at several of them together. `slopes` (4×m) comes with dx and dy
    in its first rows; the rest of it and `cells` (4×m) are work space. `ranges` (m) is the result.
    """
    m = ranges.shape[0]
    column, row = math.floor(x), math.floor(y)
    for j in range(m):
        dx, dy = slopes[0, j], slopes[1, j]
        slopes[2, j], slopes[3, j] = inverse(dx), inverse(dy)
        cells[0, j], cells[1, j] = column, row
        cells[2, j] = side_at(squares[quadrant(dx, dy)], row, column)
        cells[3, j] = j
        ranges[j] = 0.0
    active = m if side_at(squares[0], row, column) > 0 else 0
    while active > 0:
        left = 0
        for k in range(active):
            j = cells[3, k]
            dx, dy = slopes[0, j], slopes[1, j]
            t, c, r = leap(
                x, y, dx, dy, slopes[2, j], slopes[3, j], cells[0, j], cells[1, j], cells[2, j]
            )
            side = side_at(squares[quadrant(dx, dy)], r, c) if t <= limit else 0
            cells[0, j], cells[1, j], cells[2, j] = c, r, side
            ranges[j] = t if t <= limit else math.inf
            cells[3, left] = j
            left += side > 0
        active = left


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
    n = angles.shape[0]
    slopes, cells = np.empty((4, n)), np.empty((4, n), np.int64)
    for i in range(n):
        slopes[0, i], slopes[1, i] = math.cos(angles[i]), math.sin(angles[i])
    cast_fan(squares, x, y, limit, slopes, cells, ranges)


@inlined
def cast_disc(dx: float, dy: float, to_x: float, to_y: float, radius: float) -> float:
    """The range at which a ray enters a disc at (to_x, to_y) from its start; +inf if it misses."""
    along = dx * to_x + dy * to_y
    aside2 = to_x * to_x + to_y * to_y - along * along
    half2 = radius * radius - aside2
    if half2 <= 0.0 or along <= 0.0:
        return math.inf
    return max(along - math.sqrt(half2), 0.0)


@inlined
def hide_behind(
    heading: float,
    angles: FloatArray,
    astray: float,
    to_x: float,
    to_y: float,
    radius: float,
    slopes: FloatArray,
    ranges: FloatArray,
) -> None:
    """Shorten the `ranges` (m) of beams that meet the disc at (to_x, to_y).

    Nominal `angles` (m) from `heading` are evenly spaced and beams point up to `astray` off them,
    so that few come into question; `slopes` holds what they truly are.
    """
    first, spacing = angles[0], angles[1] - angles[0]
    distance = math.hypot(to_x, to_y)
    half = math.pi if distance <= radius else math.asin(radius / distance)
    half += astray + 1e-6
    bearing = math.atan2(to_y, to_x) - heading - first
    turn = 2.0 * math.pi
    bearing -= turn * math.floor((bearing + half) / turn)  # the last turn that ends after `first`
    while bearing - half <= spacing * (angles.shape[0] - 1):
        low = max(math.ceil((bearing - half) / spacing), 0)
        high = min(math.floor((bearing + half) / spacing), angles.shape[0] - 1)
        for j in range(low, high + 1):
            t = cast_disc(slopes[0, j], slopes[1, j], to_x, to_y, radius)
            ranges[j] = min(ranges[j], t)
        bearing += turn


@kernel
def scan_all(
    squares: ByteArray,
    poses: FloatArray,
    order: IntArray,
    starts: IntArray,
    others: IntArray,
    radius: float,
    angles: FloatArray,
    astray: float,
    noise: FloatArray,
    min_range: float,
    max_range: float,
    sigma: FloatArray,
    cell: float,
    ranges: npt.NDArray[np.float32],
) -> None:
    """Eq. 14 of the paper: what range finders at `poses` (n×3: cells, cells, rad) report.

    Beam j of robot i nominally points at angles[j], which are evenly spaced and rise. With
    standard normal `noise` (n×2×m) it really points `astray` · noise[i, 0, j] off, and noise[i, 1]
    is for ranges: σ_r = sigma[0] + sigma[1] r + √(sigma[2] r) at range r. The other robots are
    discs of `radius` (cells), of which `starts` and `others` name those in reach, as `neighbours`
    gives them. `cell` is metres per cell; the other lengths and `ranges` (n×m,
    float32) are metres: 0 below `min_range`, +inf where nothing is hit within `max_range`. Robots
    are gone through in an `order` (n) that changes nothing but the time it takes.
    """
    m = ranges.shape[1]
    slopes, cells, exact = np.empty((4, m)), np.empty((4, m), np.int64), np.empty(m)
    limit = max_range / cell
    for i in order:
        x, y, heading = poses[i, 0], poses[i, 1], poses[i, 2]
        farthest = 0.0
        for j in range(m):
            turned = astray * noise[i, 0, j]
            angle = heading + angles[j] + turned
            slopes[0, j], slopes[1, j] = math.cos(angle), math.sin(angle)
            farthest = max(farthest, abs(turned))
        cast_fan(squares, x, y, limit, slopes, cells, exact)
        for k in others[starts[i] : starts[i + 1]]:
            to_x, to_y = poses[k, 0] - x, poses[k, 1] - y
            hide_behind(heading, angles, farthest, to_x, to_y, radius, slopes, exact)
        for j in range(m):
            true = exact[j] * cell
            if true > max_range:
                ranges[i, j] = math.inf
                continue
            spread = sigma[0] + sigma[1] * true + math.sqrt(sigma[2] * true)
            reported = true + spread * noise[i, 1, j]
            if reported < min_range:
                ranges[i, j] = 0.0
            elif reported > max_range:
                ranges[i, j] = math.inf
            else:
                ranges[i, j] = reported


@kernel
def sights(
    squares: ByteArray,
    poses: FloatArray,
    starts: IntArray,
    others: IntArray,
    radius: float,
    limit: float,
    visible: BoolArray,
) -> None:
    """Which robots at `poses` (n×3) see which, within `limit` (cells): no wall and no third disc
    on the segment between the centres.

    `starts` and `others` (m) name those up to limit + radius away, as `neighbours` gives them;
    `visible` (m) is set for pairs of which the first robot has the lower number.
    """
    for i in range(poses.shape[0]):
        x, y = poses[i, 0], poses[i, 1]
        near = others[starts[i] : starts[i + 1]]
        for place in range(near.shape[0]):
            k = near[place]
            visible[starts[i] + place] = False
            to_x, to_y = poses[k, 0] - x, poses[k, 1] - y
            distance = math.hypot(to_x, to_y)
            if k < i or not 0.0 < distance <= limit:
                continue
            dx, dy = to_x / distance, to_y / distance
            seen = cast(squares, x, y, dx, dy, distance) == math.inf
            for by in near:
                if seen and by != k:
                    to_x, to_y = poses[by, 0] - x, poses[by, 1] - y
                    seen = cast_disc(dx, dy, to_x, to_y, radius) >= distance
            visible[starts[i] + place] = seen
