"""Compiled loop over finished submaps: which of them come near."""

import math

from protocol.kernel import kernel
from protocol.pose_kernels import apply_inverse


@kernel
def distances(frames, here, circles, starts, ways, reach, out):
    """How near the way of each submap (k) comes to `here` (x, y), ∞ where not within `reach`.

    `frames` (k×3) are `T_map_submap`; `ways[starts[i] : starts[i + 1]]` is where the scans of
    submap i were taken, in its frame, and `circles[i]` (x, y, radius) holds them.
    """
    for i in range(frames.shape[0]):
        out[i] = math.inf
        x, y = apply_inverse(frames[i], here[0], here[1])
        apart = math.sqrt((x - circles[i, 0]) ** 2 + (y - circles[i, 1]) ** 2)
        if apart - circles[i, 2] > reach:
            continue
        least = math.inf
        for k in range(starts[i], starts[i + 1]):
            least = min(least, (ways[k, 0] - x) ** 2 + (ways[k, 1] - y) ** 2)
        away = math.sqrt(least)
        if away <= reach:
            out[i] = away
