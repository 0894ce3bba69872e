"""Where in a known map may a scan have been taken? All places, at all headings, the best first."""

import math
from dataclasses import dataclass

import numpy as np

from protocol.pose import Pose2, wrap_angle
from robot.localisation import kernels
from robot.localisation.known_map import KnownMap
from robot.perception.field import RESOLUTION_M, SIGMA_M
from robot.perception.returns import Returns
from robot.perception.search import (
    MAX_ANGLE_STEP_RAD,
    MIN_ANGLE_STEP_RAD,
    SEARCH_RESOLUTION_M,
)
from robot.perception.search_kernels import NODES_PER_CELL

SEARCH_POINTS = 90
# Peaks nearer to each other than this are one.
SAME_PEAK_M = 0.5
SAME_PEAK_RAD = math.radians(10.0)
MAX_NODES = 1_500_000


@dataclass(frozen=True, slots=True)
class Place:
    """A pose (`T_map_base`, to half a search cell) and the share of its walls that a scan meets."""

    pose: Pose2
    score: float


@dataclass(frozen=True, slots=True)
class Places:
    """Peaks, best first; `complete` when nothing that reaches the least score is missing."""

    peaks: tuple[Place, ...]
    complete: bool


def find_everywhere(
    known: KnownMap, returns: Returns, floor: float, share: float, most: int
) -> Places:
    """Every pose whose score reaches `floor` and `share` of the best one's, up to so many.

    Branch and bound over the whole map and a full turn (`kernels.find_peaks`), in cells of 10 cm.
    """
    few = returns.thinned(SEARCH_POINTS)
    if len(few) == 0:
        return Places((), True)
    sigma2 = few.values[:, 5] ** 2
    full = 255.0 * float((SIGMA_M / np.sqrt(SIGMA_M**2 + 2.0 * sigma2)).sum())
    reach = float(np.quantile(np.hypot(few.points[:, 0], few.points[:, 1]), 0.9))
    step = SEARCH_RESOLUTION_M / max(reach, SEARCH_RESOLUTION_M)
    count = math.ceil(math.tau / min(max(step, MIN_ANGLE_STEP_RAD), MAX_ANGLE_STEP_RAD))
    angles = np.arange(count) * (math.tau / count)
    found, complete, _ = kernels.find_peaks(
        known.pyramid.levels,
        known.open_cells,
        _cells(few, angles),
        int(floor * full),
        share,
        round(SAME_PEAK_M / SEARCH_RESOLUTION_M),
        max(1, math.ceil(SAME_PEAK_RAD / (math.tau / count))),
        most,
        MAX_NODES,
    )
    x, y = known.field.origin + _middle_m()
    return Places(
        tuple(
            Place(
                Pose2(
                    x + column * SEARCH_RESOLUTION_M,
                    y + row * SEARCH_RESOLUTION_M,
                    wrap_angle(float(angles[angle])),
                ),
                total / full,
            )
            for total, angle, row, column in found.tolist()
        ),
        bool(complete),
    )


def _middle_m() -> float:
    """From the first node of a search cell to its middle."""
    return 0.5 * (NODES_PER_CELL - 1) * RESOLUTION_M


def _cells(few: Returns, angles: np.ndarray) -> np.ndarray:
    """Rows and columns (angles×n×2) of returns, for a robot in the middle of search cell (0, 0)."""
    c, s = np.cos(angles)[:, None], np.sin(angles)[:, None]
    x, y = few.points[:, 0][None, :], few.points[:, 1][None, :]
    points = np.stack([s * x + c * y, c * x - s * y], axis=-1) + _middle_m()
    nodes = np.floor(points / RESOLUTION_M + 0.5)
    return np.ascontiguousarray(np.floor_divide(nodes, NODES_PER_CELL).astype(np.int64))
