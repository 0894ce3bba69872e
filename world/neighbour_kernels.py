"""Compiled search for who is near whom, in time that grows with the robots, not their square."""

import math

import numpy as np
import numpy.typing as npt

from protocol.kernel import inlined, kernel
from protocol.pose import FloatArray

IntArray = npt.NDArray[np.int64]

MOST_BUCKETS = 64
"""Along a side: a short reach on a large map must not cost memory."""


@inlined
def bucket(place: float, lowest: float, side: float) -> int:
    """The number of a bucket along one axis; the first and the last one have no neighbours
    beyond."""
    return int((place - lowest) / side) + 1


@kernel
def neighbours(points: FloatArray, reach: float) -> tuple[IntArray, IntArray]:
    """Which of `points` (n×2 or more) lie up to `reach` from each other.

    Returns `starts` (n+1) and `others` (m): those near point i are others[starts[i]:starts[i+1]].
    """
    n = points.shape[0]
    low_x, low_y = points[:, 0].min(), points[:, 1].min()
    extent = max(points[:, 0].max() - low_x, points[:, 1].max() - low_y)
    side = max(reach, extent / MOST_BUCKETS, 1e-9)
    across = int(extent / side) + 3

    # Points in the order of their buckets: a counting sort.
    home = np.empty(n, np.int64)
    first = np.zeros(across * across + 1, np.int64)
    for i in range(n):
        row, column = bucket(points[i, 1], low_y, side), bucket(points[i, 0], low_x, side)
        home[i] = row * across + column
        first[home[i] + 1] += 1
    first = np.cumsum(first)
    members, filled = np.empty(n, np.int64), first.copy()
    for i in range(n):
        members[filled[home[i]]] = i
        filled[home[i]] += 1

    starts = np.zeros(n + 1, np.int64)
    others = np.empty(8 * n, np.int64)
    count = 0
    for i in range(n):
        for down in range(-1, 2):
            row = home[i] + down * across
            for place in range(first[row - 1], first[row + 2]):
                k = members[place]
                dx, dy = points[k, 0] - points[i, 0], points[k, 1] - points[i, 1]
                if k == i or abs(dx) > reach or math.hypot(dx, dy) > reach:
                    continue
                if count == others.shape[0]:
                    others = np.concatenate((others, np.empty(count, np.int64)))
                others[count] = k
                count += 1
        starts[i + 1] = count
    return starts, others[:count]
