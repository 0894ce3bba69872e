"""The compiled decision of the radio gate, and its bookkeeping."""

import math

import numpy as np
import numpy.typing as npt

from protocol.kernel import kernel
from protocol.pose import FloatArray

BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]

# Verdicts, as `world.radio.Verdict` names them.
DELIVERED, RANGE, LOSS, CAPACITY, ABSENT, FADE = 0, 1, 2, 3, 4, 5
NOBODY = -1


@kernel
def judge(
    points: FloatArray,
    present: BoolArray,
    faded: BoolArray,
    reach: float,
    capacity: int,
    loss: float,
    luck: FloatArray,
    senders: IntArray,
    recipients: IntArray,
    sizes: IntArray,
    used: IntArray,
    verdicts: IntArray,
) -> None:
    """Decide over every offer of one tick, in the order of the frames.

    `points` (n×2, m) and `present` (n) are of the robots, `faded` (n×n) of their pairs. Frame f
    goes from senders[f] to recipients[f], −1 for all others, −2 for nobody; it is sizes[f] bytes
    long. luck[f, r] is uniform in [0, 1) and decides loss. `used` (n×n) counts bytes per directed
    pair and tick.
    `verdicts` (f×n) comes filled with NOBODY and is set where a robot is offered a frame.
    """
    for f in range(senders.shape[0]):
        s = senders[f]
        for r in range(points.shape[0]):
            if r == s or (recipients[f] != -1 and recipients[f] != r):
                continue
            if not present[r]:
                verdicts[f, r] = ABSENT
            elif math.hypot(points[r, 0] - points[s, 0], points[r, 1] - points[s, 1]) > reach:
                verdicts[f, r] = RANGE
            elif faded[s, r]:
                verdicts[f, r] = FADE
            elif used[s, r] + sizes[f] > capacity:
                verdicts[f, r] = CAPACITY
            else:
                # A frame that is lost on the way was sent, and took its share of the link.
                used[s, r] += sizes[f]
                verdicts[f, r] = LOSS if loss > 0.0 and luck[f, r] < loss else DELIVERED


@kernel
def book_sent(
    verdicts: IntArray,
    senders: IntArray,
    sizes: IntArray,
    kinds: IntArray,
    offered: IntArray,
    in_flight: IntArray,
    ended: IntArray,
    kinds_offered: IntArray,
    kinds_ended: IntArray,
) -> None:
    """Book verdicts (f×n) over frames that were sent: what passed is in flight, the rest ended.

    offered and in_flight are n×n×2 (sender, receiver; frames, bytes), `ended` n×n×v×2; the same by
    kind in place of the pair: k×2 and k×v×2.
    """
    for f in range(verdicts.shape[0]):
        s, k = senders[f], kinds[f]
        for r in range(verdicts.shape[1]):
            v = verdicts[f, r]
            if v == NOBODY:
                continue
            for unit in range(2):
                amount = 1 if unit == 0 else sizes[f]
                offered[s, r, unit] += amount
                kinds_offered[k, unit] += amount
                if v == DELIVERED:
                    in_flight[s, r, unit] += amount
                else:
                    ended[s, r, v, unit] += amount
                    kinds_ended[k, v, unit] += amount


@kernel
def book_arrived(
    verdicts: IntArray,
    senders: IntArray,
    sizes: IntArray,
    kinds: IntArray,
    in_flight: IntArray,
    ended: IntArray,
    kinds_ended: IntArray,
) -> None:
    """Book verdicts (f×n) over frames that were in flight until now; arrays as in `book_sent`."""
    for f in range(verdicts.shape[0]):
        s, k = senders[f], kinds[f]
        for r in range(verdicts.shape[1]):
            v = verdicts[f, r]
            if v == NOBODY:
                continue
            for unit in range(2):
                amount = 1 if unit == 0 else sizes[f]
                in_flight[s, r, unit] -= amount
                ended[s, r, v, unit] += amount
                kinds_ended[k, v, unit] += amount
