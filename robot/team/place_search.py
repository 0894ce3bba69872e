"""Where one place may lie in another: a search over all poses.

Branch and bound over all offsets of 10 cm, and the rotations at which walls of both face the same
ways. Landmarks count for a pose where it puts them on walls, against it where the other place is
known to be free, and neither way where nothing is known: of a place that is half in what the other
has seen half the landmarks say nothing, and all of it may lie on walls elsewhere by chance.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from protocol.pose import FloatArray, Pose2
from robot.perception import search_kernels
from robot.perception.field import RESOLUTION_M, SIGMA_M
from robot.perception.search import (
    MAX_LEVELS,
    SAME_PEAK_M,
    SEARCH_RESOLUTION_M,
    Blocks,
)
from robot.perception.search_kernels import NODES_PER_CELL
from robot.team.place import DIRECTION_BINS, Place

# Rotations are tried degree by degree where the walls' directions agree to this share of the best.
SAME_DIRECTIONS = 0.85
SAME_PEAK_DEG = 15
# A landmark on free ground takes away twice what one on a wall gives, at best.
WALL, UNKNOWN, FREE = 63, 128, 2
# Peaks are looked at down to this score, and so many, in so many steps.
SEARCH_FLOOR, MAX_PEAKS = 0.2, 4
MAX_NODES = 15_000
# Of a peak's landmarks that lie where the other knows the place, so many lie on walls.
MIN_HITS = 0.7


@dataclass(frozen=True, slots=True)
class SearchGround:
    """What searches in a place go through; worth keeping.

    `levels` (levels×rows×columns): maxima over larger and larger blocks of cells, of which the
    first lies at `origin`; −126 free, 0 unknown, up to 63 wall.
    """

    place: Place
    levels: npt.NDArray[np.int8]
    origin: FloatArray

    @staticmethod
    def of(place: Place) -> "SearchGround":
        """Of what is known of a place and its surroundings."""
        field = place.surroundings
        walls = Blocks.of(field).maxima
        # A coarse node of free ground stands for what is nearest to it, half in the cell before.
        free = field.free.astype(bool)
        free = free[:-1, :-1] & free[1:, :-1] & free[:-1, 1:] & free[1:, 1:]
        rows, columns = (min(a, b) for a, b in zip(walls.shape, free.shape, strict=True))
        cells = np.full(walls.shape, UNKNOWN, dtype=np.uint8)
        cells[:rows, :columns][free[:rows, :columns]] = FREE
        cells = np.where(walls > 0, UNKNOWN + walls // 4, cells)
        # Beyond the edge nothing is known, which a block that reaches there has to show.
        cells = np.pad(cells, 1, constant_values=UNKNOWN)
        count = min(MAX_LEVELS, max(2, math.ceil(math.log2(max(cells.shape)))))
        levels = search_kernels.build_pyramid(cells, count)
        # 128 less: the other sign.
        return SearchGround(
            place, (levels ^ UNKNOWN).view(np.int8), field.origin - SEARCH_RESOLUTION_M
        )


@dataclass(frozen=True, slots=True)
class Peak:
    """A pose that a search found, with the score of the best one elsewhere by its own."""

    T_a_b: Pose2
    ambiguity: float


def find_peaks(ground: SearchGround, b: Place) -> list[Peak]:
    """The best poses of place b in place a, each the best of those around. Rotations are about the
    middle of b, offsets from that of a."""
    if len(b.landmarks) == 0:
        return []
    a, field = ground.place, ground.place.surroundings
    sigma2 = b.landmarks.values[:, 5] ** 2
    full = WALL * float((SIGMA_M / np.sqrt(SIGMA_M**2 + 2.0 * sigma2)).sum())
    shape = np.array(field.nodes.shape)
    middle = field.origin + 0.5 * RESOLUTION_M * shape[::-1]
    half_rows, half_columns = (shape // (2 * NODES_PER_CELL) + 1).tolist()
    degrees = rotations(a.directions, b.directions)
    angles = np.radians(degrees)
    found = search_kernels.find_peaks(
        ground.levels,
        _cells(b.landmarks.points - b.centre, angles, middle - ground.origin),
        degrees,
        half_rows,
        half_columns,
        round(SAME_PEAK_M / SEARCH_RESOLUTION_M),
        SAME_PEAK_DEG,
        int(SEARCH_FLOOR * full),
        0.0,
        MAX_PEAKS,
        MAX_NODES,
    )
    peaks = []
    for total, angle, row, column in found.tolist():
        x, y = middle + SEARCH_RESOLUTION_M * np.array([column, row])
        T_a_centre = _within_cell(a, b, np.array([x, y, angles[angle]]))
        T_a_b = T_a_centre @ Pose2(-float(b.centre[0]), -float(b.centre[1]), 0.0)
        if field.hits(T_a_b.apply(b.landmarks.points.copy())) >= MIN_HITS:
            peaks.append((total, T_a_b))
    totals = [total for total, _ in peaks]
    return [
        Peak(T_a_b, min(1.0, max([SEARCH_FLOOR * full, *totals[:k], *totals[k + 1 :]]) / total))
        for k, (total, T_a_b) in enumerate(peaks)
    ]


def _within_cell(a: Place, b: Place, T_a_centre: FloatArray) -> Pose2:
    """The best pose between the nodes of the cell, and the degrees, that a search ended in."""
    pose = T_a_centre.copy()
    search_kernels.best_nearby(
        a.surroundings.nodes,
        a.surroundings.origin,
        RESOLUTION_M,
        np.ascontiguousarray(b.landmarks.points - b.centre),
        T_a_centre,
        0.5 * SEARCH_RESOLUTION_M,
        NODES_PER_CELL // 2,
        math.radians(0.5),
        pose,
    )
    return Pose2.from_array(pose)


def rotations(a: FloatArray, b: FloatArray) -> FloatArray:
    """The whole degrees by which walls with the directions b (180) may be turned to face as those
    with the directions a do.

    Directions lack their sign, so each is there twice, half a turn apart.
    """
    agreement = np.fft.irfft(np.fft.rfft(a) * np.conj(np.fft.rfft(b)), DIRECTION_BINS)
    good = agreement >= SAME_DIRECTIONS * agreement.max()
    # And one to either side: the best of a range may lie beyond its last whole degree.
    good |= np.roll(good, 1) | np.roll(good, -1)
    degrees = np.flatnonzero(good)
    return np.concatenate([degrees, degrees + DIRECTION_BINS]).astype(np.float64)


def _cells(points: FloatArray, angles: FloatArray, middle: FloatArray) -> np.ndarray:
    """Rows and columns (angles×n×2, search cells) of points turned and moved to the middle."""
    c, s = np.cos(angles)[:, None], np.sin(angles)[:, None]
    x, y = points[:, 0][None, :], points[:, 1][None, :]
    nodes = np.stack([middle[1] + s * x + c * y, middle[0] + c * x - s * y], axis=-1) / RESOLUTION_M
    # Search cell k holds the nodes n·k … n·k + n − 1.
    cells = np.floor_divide(np.floor(nodes + 0.5), NODES_PER_CELL)
    return np.ascontiguousarray(cells.astype(np.int64))
