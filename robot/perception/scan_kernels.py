"""Compiled loop over the ranges of a scan, for which NumPy's calls cost more than the work."""

import math

from protocol.kernel import kernel


@kernel
def clean(ranges, least, most):
    """Ranges (n) below `least` and NaN become NaN, those above `most` +inf, in place."""
    for k in range(ranges.shape[0]):
        if ranges[k] > most:
            ranges[k] = math.inf
        elif not ranges[k] >= least:
            ranges[k] = math.nan
