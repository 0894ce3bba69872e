"""What a range finder reports where it met nothing, found in its own log.

CARMEN's FLASER lines do not say how far a scanner measures. Where nothing was met they hold its
limit: 81.83 or 81.91 m, but also 50 m or, of a SICK in its fine mode, 8.19 m. Taken for a return
that is a wall which surrounds the robot wherever it goes.
"""

import dataclasses
import math

import numpy as np

from protocol.pose import FloatArray
from station.scan_log import LoggedScan, ScanLog

# The codes of a scanner lie within this share of the greatest one.
CODES = 0.01
# They are readings that repeat to the last digit, where distances thin out towards the farthest.
LEAST, SAME, CROWDED = 20, 0.5, 10.0


def without_codes(scans: list[LoggedScan]) -> ScanLog:
    """A log whose scans say +inf where nothing was met, and how far its scanner measures."""
    reach_m = reach_of(np.concatenate([scan.ranges for scan in scans]))
    told = [
        dataclasses.replace(scan, ranges=np.where(scan.ranges > reach_m, np.inf, scan.ranges))
        for scan in scans
    ]
    return ScanLog(told, reach_m=reach_m)


def reach_of(ranges: FloatArray) -> float:
    """Up to where readings (all of a log, m) are distances; infinite if they all are."""
    known = ranges[np.isfinite(ranges) & (ranges > 0.0)]
    if len(known) == 0:
        return math.inf
    reach = (1.0 - CODES) * float(known.max())
    codes = known[known > reach]
    before = np.count_nonzero(known > (1.0 - CODES) * reach) - len(codes)
    _, repeats = np.unique(codes, return_counts=True)
    same = repeats.max() >= SAME * len(codes)
    crowded = len(codes) >= LEAST + CROWDED * before
    return reach if same and crowded else math.inf
