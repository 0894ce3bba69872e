"""Scans as bits: arithmetic coding (Witten, Neal, Cleary 1987) of whole numbers, each of which is
expected near what was foreseen for it, near the one before it, or near what is foreseen for the one
after it: a mixture whose weights follow who was right of late.

Nothing but + − × ÷ √ is done to numbers that decide a bit, which all processors round alike.
"""

import math

import numpy as np

from protocol.kernel import inlined, kernel

CODES = 512
WIDTHS = np.array([0.7, 3.0, 20.0])
"""Of the bells round each centre, in steps."""
POINT = 0.05
"""Width of the bells round a number that is no range: what is next is that, or anything."""
FIRST_CENTRE = 80.0
EDGE = 3.0
"""Where what is foreseen is so far from the number before, an edge is expected."""
# By case (nothing foreseen, foreseen, an edge foreseen): the bells of each width round what is
# foreseen, the number before, and what is foreseen next; and anything at all. As they came out for
# 961 scans of the office (maximum likelihood), rounded.
PRIOR = np.array(
    [
        [0.12, 0.08, 0.04, 0.11, 0.08, 0.04, 0.16, 0.18, 0.09, 0.10],
        [0.89, 0.005, 0.002, 0.028, 0.001, 0.001, 0.067, 0.002, 0.001, 0.003],
        [0.73, 0.08, 0.005, 0.05, 0.075, 0.017, 0.02, 0.01, 0.003, 0.01],
    ]
)
FORGETTING = 0.4
"""How much of the weights is the prior's again after each number."""

# Frequencies sum to 2¹⁶, at least one for each code; bounds of the interval have 32 bits.
TOTAL_BITS = 16
SPREAD = (1 << TOTAL_BITS) - 2 * CODES
WHOLE, HALF, QUARTER = (1 << 32) - 1, 1 << 31, 1 << 30


@inlined
def _bell(x, width):
    """A distribution that is algebraic, and falls off with the fifth power."""
    z = x / width
    z *= z
    root = math.sqrt(math.sqrt(1.0 + z * z))
    return 0.5 + 0.5 * (x / width) / root


@inlined
def _below(code, centres, weights):
    """The share of the mixture below a code."""
    total = weights[9] * code / CODES
    for k in range(3):
        for m in range(3):
            width = WIDTHS[m] if centres[k] > 1.5 else POINT
            total += weights[3 * k + m] * _bell(code - 0.5 - centres[k], width)
    return total


@inlined
def _frequency_below(code, centres, weights):
    """Two for each code, so that sums that are rounded cannot take the last one from any."""
    if code == 0:
        return 0
    if code == CODES:
        return 1 << TOTAL_BITS
    return 2 * code + int(SPREAD * min(1.0, max(0.0, _below(code, centres, weights))))


@inlined
def _look(codes, foreseen, i, centres):
    """Fill in the centres (3) for number i; returns the case."""
    n = len(codes)
    before = float(codes[i - 1]) if i > 0 else FIRST_CENTRE
    here, after = foreseen[i], foreseen[(i + 1) % n]
    centres[0] = before if math.isnan(here) else here
    centres[1] = before
    centres[2] = before if math.isnan(after) else after
    if math.isnan(here):
        return 0
    return 2 if abs(here - before) > EDGE else 1


@inlined
def _learn(code, centres, weights, prior):
    """Bayes' rule, and some of the prior again."""
    total = weights[9] / CODES
    share = np.empty(10)
    share[9] = total
    for k in range(3):
        for m in range(3):
            width = WIDTHS[m] if centres[k] > 1.5 else POINT
            x = code - centres[k]
            mass = weights[3 * k + m] * (_bell(x + 0.5, width) - _bell(x - 0.5, width))
            share[3 * k + m] = mass
            total += mass
    for e in range(10):
        weights[e] = (1.0 - FORGETTING) * share[e] / total + FORGETTING * prior[e]


@inlined
def _put(out, at, bit, pending):
    """Write a bit and as many of the other kind after it as were pending."""
    if bit:
        out[at >> 3] |= 128 >> (at & 7)
    at += 1
    for _ in range(pending):
        if not bit:
            out[at >> 3] |= 128 >> (at & 7)
        at += 1
    return at


@kernel
def encode(codes, foreseen, out):
    """Write codes (n, below CODES), for which `foreseen` (n) was foreseen or NaN, to zeroed bytes,
    of which there are 2 n + 8; returns how many are used."""
    weights = PRIOR.copy()
    centres = np.empty(3)
    low, high, at, pending = 0, WHOLE, 0, 0
    for i in range(len(codes)):
        case = _look(codes, foreseen, i, centres)
        below = _frequency_below(codes[i], centres, weights[case])
        above = _frequency_below(codes[i] + 1, centres, weights[case])
        span = high - low + 1
        high = low + ((span * above) >> TOTAL_BITS) - 1
        low = low + ((span * below) >> TOTAL_BITS)
        while True:
            if high < HALF:
                at, pending = _put(out, at, False, pending), 0
            elif low >= HALF:
                at, pending = _put(out, at, True, pending), 0
                low, high = low - HALF, high - HALF
            elif low >= QUARTER and high < 3 * QUARTER:
                pending += 1
                low, high = low - QUARTER, high - QUARTER
            else:
                break
            low, high = 2 * low, 2 * high + 1
        _learn(codes[i], centres, weights[case], PRIOR[case])
    # Whatever follows the last bits, it lies in the interval; zeros need not be written.
    at = _put(out, at, low >= QUARTER, pending + 1)
    used = (at + 7) >> 3
    while used > 0 and out[used - 1] == 0:
        used -= 1
    return used


@inlined
def _find(wanted, centres, weights):
    """The code whose share holds a frequency: in growing strides from the first centre, then by
    halves."""
    first, last = 0, CODES
    middle, stride = min(max(int(centres[0] + 0.5), 1), CODES - 1), 1
    while last - first > 1:
        if _frequency_below(middle, centres, weights) <= wanted:
            first = middle
            middle = first + stride if last == CODES else (first + last) >> 1
        else:
            last = middle
            middle = last - stride if first == 0 else (first + last) >> 1
        stride *= 2
        middle = min(max(middle, first + 1), last - 1)
    return first


@inlined
def _bit(data, at):
    """A bit, zero beyond the end."""
    if at >= 8 * len(data):
        return 0
    return (data[at >> 3] >> (7 - (at & 7))) & 1


@kernel
def decode(data, foreseen, codes):
    """Read as many codes as there is room for in `codes` (n); whatever the bytes are, some come."""
    weights = PRIOR.copy()
    centres = np.empty(3)
    low, high, at, value = 0, WHOLE, 32, 0
    for i in range(32):
        value = 2 * value + _bit(data, i)
    for i in range(len(codes)):
        case = _look(codes, foreseen, i, centres)
        span = high - low + 1
        wanted = (((value - low + 1) << TOTAL_BITS) - 1) // span
        first = _find(wanted, centres, weights[case])
        codes[i] = first
        below = _frequency_below(first, centres, weights[case])
        above = _frequency_below(first + 1, centres, weights[case])
        high = low + ((span * above) >> TOTAL_BITS) - 1
        low = low + ((span * below) >> TOTAL_BITS)
        while True:
            if high < HALF:
                pass
            elif low >= HALF:
                low, high, value = low - HALF, high - HALF, value - HALF
            elif low >= QUARTER and high < 3 * QUARTER:
                low, high, value = low - QUARTER, high - QUARTER, value - QUARTER
            else:
                break
            low, high, value = 2 * low, 2 * high + 1, 2 * value + _bit(data, at)
            at += 1
        _learn(first, centres, weights[case], PRIOR[case])
