"""What a scan will look like from a little further on: returns of earlier scans, seen from there.

All that is decided by a comparison is rounded first, so that processors whose sines and logarithms
differ in the last bit foresee the same.
"""

import math

import numpy as np

from protocol.kernel import inlined, kernel

# Parts of a beam, and of a step of the range, to which is rounded.
GRAIN = 1048576.0
STEP_GRAIN = 256.0
SURFACE_STEPS = 8.0
"""Neighbouring returns that lie no more steps of the nearer one apart are of one surface."""
SAME_STEPS = 4.0
"""So far from what the newest scan says an older one may be and still speak of the same thing."""


@inlined
def _rounded(value, grain):
    return math.floor(value * grain + 0.5) / grain


@kernel
def foresee(ranges, T_now_then, angle_min, increment, step_m, step_share, out):
    """Write to `out` (n) in which step of the range each beam meets what an earlier scan (ranges,
    n, from a pose that is T_now_then (3) now) saw; NaN where that does not tell."""
    n = len(ranges)
    turn = 2.0 * math.pi / increment
    all_round = n * increment > 2.0 * math.pi - 1.5 * increment
    x, y, beam = np.empty(n), np.empty(n), np.empty(n)
    cos_t, sin_t = math.cos(T_now_then[2]), math.sin(T_now_then[2])
    for j in range(n):
        r = ranges[j]
        angle = angle_min + j * increment
        px, py = r * math.cos(angle), r * math.sin(angle)
        x[j] = T_now_then[0] + cos_t * px - sin_t * py
        y[j] = T_now_then[1] + sin_t * px + cos_t * py
        beam[j] = _rounded((math.atan2(y[j], x[j]) - angle_min) / increment, GRAIN)
    out[:] = np.nan
    for j in range(n if all_round else n - 1):
        k = (j + 1) % n
        if not (math.isfinite(ranges[j]) and math.isfinite(ranges[k])):
            continue
        nearer = min(ranges[j], ranges[k])
        if abs(ranges[j] - ranges[k]) > SURFACE_STEPS * (step_m + step_share * nearer):
            continue
        first, last = beam[j], beam[k]
        if last < first - 0.5 * turn:
            last += turn
        elif last > first + 0.5 * turn:
            last -= turn
        if not last - first < n:  # nor is there any if a stranger's numbers are none
            continue
        ux, uy = x[k] - x[j], y[k] - y[j]
        across = x[j] * uy - y[j] * ux
        for i in range(int(math.ceil(first)), int(math.floor(last)) + 1):
            angle = angle_min + i * increment
            slant = math.cos(angle) * uy - math.sin(angle) * ux
            if across <= 0.0 or slant <= 0.0:  # from behind: hidden by its other side
                continue
            at = i % n if all_round else i
            if not 0 <= at < n:
                continue
            steps = math.log1p(step_share / step_m * across / slant) / step_share
            steps = _rounded(steps, STEP_GRAIN)
            if not out[at] <= steps:
                out[at] = steps


@kernel
def agreed(foreseen, out):
    """Write to `out` (n) what earlier scans (m×n, the newest first) say together: the mean of those
    that agree with the newest that says anything."""
    for i in range(foreseen.shape[1]):
        newest, total, count = np.nan, 0.0, 0
        for j in range(foreseen.shape[0]):
            steps = foreseen[j, i]
            if math.isnan(steps):
                continue
            if count == 0:
                newest = steps
            if abs(steps - newest) < SAME_STEPS:
                total += steps
                count += 1
        out[i] = total / count if count else np.nan
