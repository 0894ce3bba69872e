"""Whole numbers that lie near each other, as bits: the differences between neighbours in
exponential Golomb codes (Teuhola 1978) whose order follows what the last few differences were.

The code of order k for z ≥ 0, with m = (z >> k) + 1 of n bits: n − 1 zeros, m, the k low bits of z.
"""

from protocol.kernel import inlined, kernel

# The level is four times the mean of the last few differences, each up to a limit, for a jump to
# another wall says little of what follows.
FIRST_LEVEL, DECAY, MAX_STEP = 16, 2, 16
ORDER_SHARE = 8
MAX_ORDER = 8
MAX_ZEROS = 24


@inlined
def _order(level):
    k = 0
    while k < MAX_ORDER and (ORDER_SHARE << k) < level:
        k += 1
    return k


@inlined
def _put(out, at, value, bits):
    """Write the low `bits` of a value, most significant first, from bit `at` of zeroed bytes."""
    for n in range(bits - 1, -1, -1):
        if (value >> n) & 1:
            out[at >> 3] |= 128 >> (at & 7)
        at += 1
    return at


@kernel
def encode(codes, out):
    """Write whole numbers (n) to zeroed bytes, 8 for each of them; returns how many are used."""
    at = 0
    level = FIRST_LEVEL
    before = 0
    for i in range(len(codes)):
        difference = codes[i] - before
        before = codes[i]
        z = 2 * difference if difference >= 0 else -2 * difference - 1
        k = _order(level)
        m = (z >> k) + 1
        n = 0
        while m >> (n + 1):
            n += 1
        at = _put(out, at + n, m, n + 1)
        at = _put(out, at, z & ((1 << k) - 1), k)
        level += min(z, MAX_STEP) - (level >> DECAY)
    return (at + 7) >> 3


@kernel
def decode(data, codes):
    """Read as many numbers as there is room for in `codes` (n); False unless the bytes are what
    `encode` makes of them."""
    at = 0
    end = 8 * len(data)
    level = FIRST_LEVEL
    before = 0
    for i in range(len(codes)):
        zeros = 0
        while at < end and not data[at >> 3] & (128 >> (at & 7)):
            zeros += 1
            at += 1
        k = _order(level)
        if zeros > MAX_ZEROS or at + zeros + 1 + k > end:
            return False
        m = 0
        for _ in range(zeros + 1):
            m = (m << 1) | ((data[at >> 3] >> (7 - (at & 7))) & 1)
            at += 1
        z = 0
        for _ in range(k):
            z = (z << 1) | ((data[at >> 3] >> (7 - (at & 7))) & 1)
            at += 1
        z |= (m - 1) << k
        before += z >> 1 if not z & 1 else -((z + 1) >> 1)
        codes[i] = before
        level += min(z, MAX_STEP) - (level >> DECAY)
    if end - at > 7:
        return False
    while at < end:
        if data[at >> 3] & (128 >> (at & 7)):
            return False
        at += 1
    return True
