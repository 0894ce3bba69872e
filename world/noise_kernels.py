"""Compiled random numbers by address: no state, so that any of them can be had at any time.

An address is a 64-bit `key` (whose numbers they are), a `tick`, an `item` of that tick, and the
place in the item's row. Philox4x32-10 (Salmon et al., "Parallel random numbers: as easy as 1, 2,
3", 2011) turns it into 128 bits, which are two numbers.
"""

import math

import numpy as np
import numpy.typing as npt

from protocol.kernel import inlined, kernel
from protocol.pose import FloatArray

WordArray = npt.NDArray[np.uint64]
IntArray = npt.NDArray[np.int64]

LOW = np.uint64(0xFFFFFFFF)
HALF = np.uint64(32)
FACTOR_0, FACTOR_2 = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
WEYL_0, WEYL_1 = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)
ROUNDS = 10

MORE = np.uint64(1 << 24)
UNIT = 2.0**-53


@inlined
def philox(key, tick, item, block):
    """128 random bits as two words, of an address (all uint64)."""
    c0, c1 = block & LOW, item & LOW
    c2, c3 = tick & LOW, tick >> HALF
    k0, k1 = key & LOW, key >> HALF
    for _ in range(ROUNDS):
        product_0, product_2 = FACTOR_0 * c0, FACTOR_2 * c2
        c0, c1, c2, c3 = (
            (product_2 >> HALF) ^ c1 ^ k0,
            product_2 & LOW,
            (product_0 >> HALF) ^ c3 ^ k1,
            product_0 & LOW,
        )
        k0, k1 = (k0 + WEYL_0) & LOW, (k1 + WEYL_1) & LOW
    return c0 | (c1 << HALF), c2 | (c3 << HALF)


@inlined
def unit(word):
    """A word as a number in [0, 1)."""
    return float(word >> np.uint64(11)) * UNIT


@inlined
def normal(word, key, tick, item, block, layers):
    """A standard normal number from a word of an address, by the ziggurat method: Marsaglia and
    Tsang, "The ziggurat method for generating random variables", 2000.

    Where the word alone does not decide, more are drawn from `block`, which is nobody else's.
    """
    while True:
        layer = int(word & np.uint64(0xFF))
        sign = -1.0 if word & np.uint64(0x100) else 1.0
        share = float(word >> np.uint64(12))
        x = share * layers[0, layer]
        if share < layers[1, layer]:
            return sign * x
        if layer == 0:
            break
        word, other = philox(key, tick, item, block)
        block += MORE
        low, high = layers[2, layer], layers[2, layer - 1]
        if low + unit(other) * (high - low) < math.exp(-0.5 * x * x):
            return sign * x
    edge = layers[0, 0] * layers[1, 0]
    while True:  # the tail beyond the widest layer
        word, other = philox(key, tick, item, block)
        block += MORE
        beyond = -math.log1p(-unit(word)) / edge
        if -2.0 * math.log1p(-unit(other)) > beyond * beyond:
            return sign * (edge + beyond)


@kernel
def fill_normals(
    keys: WordArray, tick: int, items: IntArray, layers: FloatArray, numbers: FloatArray
) -> None:
    """`numbers` (n×m, m ≤ 2^24): the first m standard normal numbers of each of `items` (n) of
    this tick, under `keys` (n).

    `layers` (3×256) are those of `world.noise.ziggurat`.
    """
    n, m = numbers.shape
    words = np.empty(m + 1, np.uint64)
    when = np.uint64(tick)
    for i in range(n):
        key, item = keys[i], np.uint64(items[i])
        for j in range(0, m, 2):
            words[j], words[j + 1] = philox(key, when, item, np.uint64(j >> 1))
        for j in range(m):
            word = words[j]
            layer = int(word & np.uint64(0xFF))
            share = float(word >> np.uint64(12))
            if share < layers[1, layer]:  # 99 of 100; the call costs more than all of this
                x = share * layers[0, layer]
                numbers[i, j] = -x if word & np.uint64(0x100) else x
            else:
                # The low 24 bits of a block name the number, the others count what it draws.
                numbers[i, j] = normal(word, key, when, item, np.uint64(j) | MORE, layers)


@kernel
def fill_uniforms(keys: WordArray, tick: int, items: IntArray, numbers: FloatArray) -> None:
    """`numbers` (n×m): the same with uniform numbers in [0, 1)."""
    n, m = numbers.shape
    when = np.uint64(tick)
    for i in range(n):
        for j in range(0, m, 2):
            words = philox(keys[i], when, np.uint64(items[i]), np.uint64(j >> 1))
            numbers[i, j] = unit(words[0])
            if j + 1 < m:
                numbers[i, j + 1] = unit(words[1])
