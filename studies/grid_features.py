"""The usual way of merging two occupancy maps: features of images and RANSAC, with OpenCV.

As multirobot_map_merge (m-explore) does it: features of both pictures, matches by the ratio of the
two nearest, both ways, a rotation with shift and scale by RANSAC, and a confidence by inliers
(Brown and Lowe, "Automatic panoramic image stitching using invariant features", 2007, eq. 13) that
must reach 1. What is not nearly of scale 1 is no alignment of maps.
"""

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from maps.grid import OccupancyGrid
from protocol.pose import FloatArray, Pose2

DETECTORS = ("orb", "sift")
# A match must be so much nearer than the second nearest.
NEAREST_SHARE = 0.7
MIN_MATCHES = 6
MIN_CONFIDENCE = 1.0
MAX_SCALE_ERROR = 0.1
RANSAC_PIXELS, RANSAC_TRIES, RANSAC_SEED = 3.0, 2000, 1


@dataclass(frozen=True, slots=True)
class FeatureMerge:
    """`T_a_b` between the frames of two grids with its confidence, accepted or not."""

    T_a_b: Pose2
    confidence: float
    accepted: bool


def merge_by_features(a: OccupancyGrid, b: OccupancyGrid, detector: str) -> FeatureMerge | None:
    """Lay grid b on grid a of the same resolution; None where too little matches."""
    points_a, described_a = _features(a, detector)
    points_b, described_b = _features(b, detector)
    if min(len(points_a), len(points_b)) < MIN_MATCHES:
        return None
    pairs = _matches(described_a, described_b, detector)
    if len(pairs) < MIN_MATCHES:
        return None
    of, to = np.array(pairs).T
    cv2.setRNGSeed(RANSAC_SEED)
    matrix, inside = cv2.estimateAffinePartial2D(
        points_b[to],
        points_a[of],
        method=cv2.RANSAC,
        ransacReprojThreshold=RANSAC_PIXELS,
        maxIters=RANSAC_TRIES,
    )
    if matrix is None:
        return None
    confidence = float(inside.sum()) / (8.0 + 0.3 * len(pairs))
    scale = math.hypot(matrix[0, 0], matrix[1, 0])
    turn = math.atan2(matrix[1, 0], matrix[0, 0])
    # Without the scale, about the middle of what matches.
    middle = points_b[to][inside[:, 0] > 0].mean(axis=0)
    there = _metres(a, matrix[:, :2] @ middle + matrix[:, 2])
    T_turned = Pose2(0.0, 0.0, turn).apply(_metres(b, middle)[None])[0]
    accepted = confidence >= MIN_CONFIDENCE and abs(scale - 1.0) <= MAX_SCALE_ERROR
    shift = there - T_turned
    return FeatureMerge(Pose2(float(shift[0]), float(shift[1]), turn), confidence, accepted)


def _metres(grid: OccupancyGrid, pixel: FloatArray) -> FloatArray:
    """Column and row of a picture to x and y."""
    origin = np.array([grid.origin_x, grid.origin_y])
    return np.asarray(origin + grid.resolution * (pixel + 0.5), dtype=np.float64)


def _features(grid: OccupancyGrid, detector: str) -> tuple[FloatArray, Any]:
    """Points (n×2, column and row) and what they look like."""
    picture = np.full(grid.cells.shape, 127, dtype=np.uint8)
    picture[grid.cells >= 0] = 255
    picture[grid.cells >= 50] = 0
    found, described = _make(detector).detectAndCompute(picture, None)
    return np.array([point.pt for point in found]).reshape(-1, 2), described


def _make(detector: str) -> Any:
    # OpenCV 5 has no AKAZE in its main modules any more.
    return cv2.ORB.create(nfeatures=2000) if detector == "orb" else cv2.SIFT.create()


def _matches(described_a: Any, described_b: Any, detector: str) -> list[tuple[int, int]]:
    """Pairs of numbers of points, by the ratio test, of either way."""
    matcher = cv2.BFMatcher(cv2.NORM_L2 if detector == "sift" else cv2.NORM_HAMMING)
    pairs = set()
    for query, train, turned in (
        (described_a, described_b, False),
        (described_b, described_a, True),
    ):
        for two in matcher.knnMatch(query, train, k=2):
            if len(two) == 2 and two[0].distance < NEAREST_SHARE * two[1].distance:
                pair = (two[0].queryIdx, two[0].trainIdx)
                pairs.add(pair[::-1] if turned else pair)
    return sorted(pairs)
