"""Compiled loops of the sparse Cholesky factorisation of matrices made of 3×3 blocks.

Row by row ("up-looking"; Davis, *Direct Methods for Sparse Linear Systems*, 2006, chapter 4), with
blocks in the place of numbers. A block is a row of 9 numbers. L is stored by columns; for every
row, in ascending order, there is the list of its columns and of their places in that storage.
"""

import math

import numpy as np

from protocol.kernel import inlined, kernel


@kernel
def minimum_degree(count, pairs):
    """Where each of `count` blocks should stand so that little fills in: always the one next that
    is tied to the fewest (of equal ones the first). Takes count² bits, and time in proportion."""
    words = (count + 63) // 64
    ties = np.zeros((count, words), dtype=np.uint64)
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        ties[i, j >> 6] |= np.uint64(1) << np.uint64(j & 63)
        ties[j, i >> 6] |= np.uint64(1) << np.uint64(i & 63)
    degrees = np.zeros(count, dtype=np.int64)
    for i in range(count):
        degrees[i] = _ones(ties[i])
    order = np.full(count, -1, dtype=np.int64)
    for place in range(count):
        chosen = -1
        for i in range(count):
            if order[i] < 0 and (chosen < 0 or degrees[i] < degrees[chosen]):
                chosen = i
        order[chosen] = place
        # Those that it was tied to are tied to each other from now on.
        row = ties[chosen]
        for i in range(count):
            if row[i >> 6] >> np.uint64(i & 63) & np.uint64(1):
                for word in range(words):
                    ties[i, word] |= row[word]
                ties[i, i >> 6] &= ~(np.uint64(1) << np.uint64(i & 63))
                ties[i, chosen >> 6] &= ~(np.uint64(1) << np.uint64(chosen & 63))
                degrees[i] = _ones(ties[i])
    return order


@inlined
def _ones(words):
    """How many bits are set."""
    total = 0
    for word in words:
        rest = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
        rest = (rest & np.uint64(0x3333333333333333)) + (
            (rest >> np.uint64(2)) & np.uint64(0x3333333333333333)
        )
        rest = (rest + (rest >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
        total += np.int64((rest * np.uint64(0x0101010101010101)) >> np.uint64(56))
    return total


@kernel
def analyse(count, starts, columns):
    """The pattern of L for a matrix whose row k has blocks at `columns[starts[k]:starts[k + 1]]`.

    All of them are left of the diagonal. Returns (column starts, row of each place, row starts,
    column of each entry of a row, its place).
    """
    parent = np.full(count, -1, dtype=np.int64)
    mark = np.full(count, -1, dtype=np.int64)
    row_starts = np.zeros(count + 1, dtype=np.int64)
    column_starts = np.zeros(count + 1, dtype=np.int64)
    for k in range(count):
        mark[k] = k
        for p in range(starts[k], starts[k + 1]):
            i = columns[p]
            while mark[i] != k:
                if parent[i] < 0:
                    parent[i] = k
                mark[i] = k
                row_starts[k + 1] += 1
                column_starts[i + 1] += 1
                i = parent[i]
    for k in range(count):
        row_starts[k + 1] += row_starts[k]
        column_starts[k + 1] += column_starts[k]
    filled = row_starts[count]
    row_columns = np.empty(filled, dtype=np.int64)
    row_places = np.empty(filled, dtype=np.int64)
    column_rows = np.empty(filled, dtype=np.int64)
    following = column_starts.copy()
    mark[:] = -1
    for k in range(count):
        mark[k] = k
        end = row_starts[k]
        for p in range(starts[k], starts[k + 1]):
            i = columns[p]
            while mark[i] != k:
                mark[i] = k
                row_columns[end] = i
                end += 1
                i = parent[i]
        row_columns[row_starts[k] : end].sort()
        for q in range(row_starts[k], end):
            i = row_columns[q]
            row_places[q] = following[i]
            column_rows[following[i]] = k
            following[i] += 1
    return column_starts, column_rows, row_starts, row_columns, row_places


@inlined
def _invert_factor(d, out):
    """out = C⁻¹ for the lower triangular C with C Cᵀ = d; False unless d is positive definite."""
    if not d[0] > 0.0:
        return False
    c00 = math.sqrt(d[0])
    c10 = d[3] / c00
    c20 = d[6] / c00
    rest = d[4] - c10 * c10
    if not rest > 1e-14 * d[4]:
        return False
    c11 = math.sqrt(rest)
    c21 = (d[7] - c20 * c10) / c11
    rest = d[8] - c20 * c20 - c21 * c21
    if not rest > 1e-14 * d[8]:
        return False
    c22 = math.sqrt(rest)
    out[0] = 1.0 / c00
    out[4] = 1.0 / c11
    out[8] = 1.0 / c22
    out[1] = 0.0
    out[2] = 0.0
    out[5] = 0.0
    out[3] = -c10 * out[0] / c11
    out[7] = -c21 * out[4] / c22
    out[6] = -(c20 * out[0] + c21 * out[3]) / c22
    return True


@kernel
def factorise(
    diagonal,
    lower,
    starts,
    columns,
    damping,
    floor,
    column_starts,
    column_rows,
    row_starts,
    row_columns,
    row_places,
    blocks,
    inverses,
    work,
):
    """L Lᵀ = A + damping · diag(A) + floor · 1; False where that is not positive definite.

    A is `diagonal` (n×9) and `lower` (m×9, the blocks that `analyse` was told of). `blocks` takes
    L below its diagonal by columns, `inverses` (n×9) the inverses of its diagonal blocks. `work`
    (n×9) must be zero and is so again at the end.
    """
    count = diagonal.shape[0]
    d = np.empty(9)
    for k in range(count):
        for p in range(starts[k], starts[k + 1]):
            work[columns[p]] = lower[p]
        d[:] = diagonal[k]
        for a in range(3):
            d[4 * a] += damping * d[4 * a] + floor
        for q in range(row_starts[k], row_starts[k + 1]):
            i = row_columns[q]
            place = row_places[q]
            # L_ki = x_i C_i⁻ᵀ, where C_i⁻¹ is lower triangular.
            v = inverses[i]
            w = work[i]
            l00 = w[0] * v[0]
            l01 = w[0] * v[3] + w[1] * v[4]
            l02 = w[0] * v[6] + w[1] * v[7] + w[2] * v[8]
            l10 = w[3] * v[0]
            l11 = w[3] * v[3] + w[4] * v[4]
            l12 = w[3] * v[6] + w[4] * v[7] + w[5] * v[8]
            l20 = w[6] * v[0]
            l21 = w[6] * v[3] + w[7] * v[4]
            l22 = w[6] * v[6] + w[7] * v[7] + w[8] * v[8]
            w[:] = 0.0
            for p in range(column_starts[i], place):
                x = work[column_rows[p]]
                b = blocks[p]
                x[0] -= l00 * b[0] + l01 * b[1] + l02 * b[2]
                x[1] -= l00 * b[3] + l01 * b[4] + l02 * b[5]
                x[2] -= l00 * b[6] + l01 * b[7] + l02 * b[8]
                x[3] -= l10 * b[0] + l11 * b[1] + l12 * b[2]
                x[4] -= l10 * b[3] + l11 * b[4] + l12 * b[5]
                x[5] -= l10 * b[6] + l11 * b[7] + l12 * b[8]
                x[6] -= l20 * b[0] + l21 * b[1] + l22 * b[2]
                x[7] -= l20 * b[3] + l21 * b[4] + l22 * b[5]
                x[8] -= l20 * b[6] + l21 * b[7] + l22 * b[8]
            b = blocks[place]
            b[0] = l00
            b[1] = l01
            b[2] = l02
            b[3] = l10
            b[4] = l11
            b[5] = l12
            b[6] = l20
            b[7] = l21
            b[8] = l22
            d[0] -= l00 * l00 + l01 * l01 + l02 * l02
            d[3] -= l10 * l00 + l11 * l01 + l12 * l02
            d[4] -= l10 * l10 + l11 * l11 + l12 * l12
            d[6] -= l20 * l00 + l21 * l01 + l22 * l02
            d[7] -= l20 * l10 + l21 * l11 + l22 * l12
            d[8] -= l20 * l20 + l21 * l21 + l22 * l22
        if not _invert_factor(d, inverses[k]):
            work[:] = 0.0
            return False
    return True


@kernel
def solve(column_starts, column_rows, blocks, inverses, x):
    """x (n×3) becomes A⁻¹ x."""
    count = inverses.shape[0]
    for k in range(count):
        v = inverses[k]
        a = v[0] * x[k, 0]
        b = v[3] * x[k, 0] + v[4] * x[k, 1]
        c = v[6] * x[k, 0] + v[7] * x[k, 1] + v[8] * x[k, 2]
        x[k, 0] = a
        x[k, 1] = b
        x[k, 2] = c
        for p in range(column_starts[k], column_starts[k + 1]):
            m = blocks[p]
            y = x[column_rows[p]]
            y[0] -= m[0] * a + m[1] * b + m[2] * c
            y[1] -= m[3] * a + m[4] * b + m[5] * c
            y[2] -= m[6] * a + m[7] * b + m[8] * c
    for back in range(count):
        k = count - 1 - back
        a = x[k, 0]
        b = x[k, 1]
        c = x[k, 2]
        for p in range(column_starts[k], column_starts[k + 1]):
            m = blocks[p]
            y = x[column_rows[p]]
            a -= m[0] * y[0] + m[3] * y[1] + m[6] * y[2]
            b -= m[1] * y[0] + m[4] * y[1] + m[7] * y[2]
            c -= m[2] * y[0] + m[5] * y[1] + m[8] * y[2]
        v = inverses[k]
        x[k, 0] = v[0] * a + v[3] * b + v[6] * c
        x[k, 1] = v[4] * b + v[7] * c
        x[k, 2] = v[8] * c


@kernel
def spread(column_starts, column_rows, blocks, inverses, first, J, second, K, work, out):
    """out (3×3) = [J K] A⁻¹ [J K]ᵀ, J and K (3×3) at the block columns `first` and `second`.

    −1 stands for a column that is not there. Only the two paths to the root of the elimination
    tree are walked. `work` (n×9) must be zero and is so again at the end.
    """
    out[:, :] = 0.0
    for r in range(3):
        for c in range(3):
            if first >= 0:
                work[first, 3 * r + c] += J[c, r]
            if second >= 0:
                work[second, 3 * r + c] += K[c, r]
    a = first
    b = second
    y = np.empty(9)
    while a >= 0 or b >= 0:
        # The lower of the two paths steps on; where they meet they are one.
        k = a if b < 0 or (0 <= a < b) else b
        v = inverses[k]
        x = work[k]
        for c in range(3):
            y[c] = v[0] * x[c]
            y[3 + c] = v[3] * x[c] + v[4] * x[3 + c]
            y[6 + c] = v[6] * x[c] + v[7] * x[3 + c] + v[8] * x[6 + c]
        x[:] = 0.0
        for r in range(3):
            for c in range(3):
                out[r, c] += y[r] * y[c] + y[3 + r] * y[3 + c] + y[6 + r] * y[6 + c]
        for p in range(column_starts[k], column_starts[k + 1]):
            m = blocks[p]
            x = work[column_rows[p]]
            for r in range(3):
                for c in range(3):
                    x[3 * r + c] -= (
                        m[3 * r] * y[c] + m[3 * r + 1] * y[3 + c] + m[3 * r + 2] * y[6 + c]
                    )
        # The first row below the diagonal is the parent.
        parent = column_rows[column_starts[k]] if column_starts[k] < column_starts[k + 1] else -1
        if a == k:
            a = parent
        if b == k:
            b = parent
