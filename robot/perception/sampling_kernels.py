"""Compiled look-up of a field at all points of a scan: `field_kernels.look_up`, to the last bit.

One loop after the other, each over all points: those that only calculate become vector
instructions, and only fetching the nodes goes point by point.
"""

import numpy as np

from protocol.kernel import inlined
from robot.perception.field_kernels import SHARE


@inlined
def sample(field, u0, v0, c, s, x, y, cells, samples):
    """Values and gradients (per node) of a field at points (n) turned by (cos, sin) = (c, s) and
    moved by (u0, v0), all in nodes: rows 0–2 of `samples` (5×n), zero outside.

    Its rows 3 and 4 and `cells` (6×n, int32) are work space.
    """
    value, du, dv, fu, fv = samples[0], samples[1], samples[2], samples[3], samples[4]
    columns, rows = cells[0], cells[1]
    low_left, low_right, high_left, high_right = cells[2], cells[3], cells[4], cells[5]
    n = x.shape[0]
    for k in range(n):
        u = u0 + c * x[k] - s * y[k]
        v = v0 + s * x[k] + c * y[k]
        left = np.floor(u)
        below = np.floor(v)
        fu[k] = u - left
        fv[k] = v - below
        columns[k] = np.int32(left)
        rows[k] = np.int32(below)
    last_row = np.uint64(field.shape[0] - 1)
    last_column = np.uint64(field.shape[1] - 1)
    one = np.uint64(1)
    for k in range(n):
        # What is below 0 is very large as an unsigned number.
        row = np.uint64(np.uint32(rows[k]))
        column = np.uint64(np.uint32(columns[k]))
        if row < last_row and column < last_column:
            low_left[k] = field[row, column]
            low_right[k] = field[row, column + one]
            high_left[k] = field[row + one, column]
            high_right[k] = field[row + one, column + one]
        else:
            low_left[k] = low_right[k] = high_left[k] = high_right[k] = 0
    for k in range(n):
        along_low = np.float64(low_right[k] - low_left[k])
        along_high = np.float64(high_right[k] - high_left[k])
        low = np.float64(low_left[k]) + fu[k] * along_low
        high = np.float64(high_left[k]) + fu[k] * along_high
        value[k] = (low + fv[k] * (high - low)) * SHARE
        du[k] = ((1.0 - fv[k]) * along_low + fv[k] * along_high) * SHARE
        dv[k] = (high - low) * SHARE
