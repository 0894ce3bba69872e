"""Compiled loop over finished submaps: which of them come near."""

import math

from protocol.kernel import kernel
from protocol.pose_kernels import apply_inverse


@kernel
def distances(nodes, indices, x0, y0, circles, starts, ways, reach, out):
    """How near the way of each submap (k) comes to (x0, y0), ∞ where not within `reach`; how many
    of them are.

    `nodes[indices[i]]` is `T_map_submap` of submap i (of `nodes`, m×3); `ways[starts[i] :
    starts[i + 1]]` is where its scans were taken, in its frame, and `circles[i]` (x, y, radius)
    holds them.
    """
    within = 0
    for i in range(indices.shape[0]):
        out[i] = math.inf
        x, y = apply_inverse(nodes[indices[i]], x0, y0)
        apart = math.sqrt((x - circles[i, 0]) ** 2 + (y - circles[i, 1]) ** 2)
        if apart - circles[i, 2] > reach:
            continue
        least = math.inf
        for k in range(starts[i], starts[i + 1]):
            least = min(least, (ways[k, 0] - x) ** 2 + (ways[k, 1] - y) ** 2)
        away = math.sqrt(least)
        if away <= reach:
            out[i] = away
            within += 1
    return within
