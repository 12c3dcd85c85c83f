"""Rows of evenly spaced samples of a rotated grid.

Cell indices are stepped in fixed point, so that a step is an addition and a shift without conversion.
"""

from __future__ import annotations

import numpy as np

from twc_env.kernels.compiled import borrowing_kernel, kernel

FIXED_BITS = 32
FIXED_POINT = 2.0**FIXED_BITS
"""Fixed-point units per cell."""


@kernel
def span_inside(start, step, limit, count):
    """First and last + 1 of the j in 0..count-1 with 0 <= start + j step < limit; all integers."""
    if step == 0:
        return (0, count) if 0 <= start < limit else (0, 0)
    if step < 0:  # mirrored: limit - 1 - value grows with j
        start, step = limit - 1 - start, -step
    first = 0 if start >= 0 else (-start + step - 1) // step
    last = 0 if start >= limit else (limit - 1 - start) // step + 1
    return first, min(last, count)


@borrowing_kernel
def number_row(width, row, column, row_step, column_step, count, numbers):
    """Write to numbers (uint32) the flat cell indices of `count` samples, all of which lie in the grid (rows, width).

    The first sample is at (row, column), in fixed point.
    """
    bits, stride = np.uint64(FIXED_BITS), np.uint64(width)
    r, k, up, right = np.uint64(row), np.uint64(column), np.uint64(row_step), np.uint64(column_step)
    for j in range(count):
        numbers[j] = np.uint32((r >> bits) * stride + (k >> bits))
        r += up
        k += right


@borrowing_kernel
def number_square(width, firsts, row_step, column_step, room, numbers):
    """`number_row` for each row of a square of samples: numbers (size * size,); room: scratch, (6, size) uint32.

    firsts (2, size): row and column of the first sample of each row. Relative to the first sample, the cell indices are
    the same in every row, or one more where the fractions of both add up to a cell. So they are computed once, and 32
    bits are enough for all others.
    """
    bits, size, across, one = FIXED_BITS, firsts.shape[1], np.uint32(width), np.uint32(1)
    steps, row_parts, column_parts, starts, row_gaps, column_gaps = room[0], room[1], room[2], room[3], room[4], room[5]
    for j in range(size):
        r, k = j * row_step, j * column_step
        steps[j], row_parts[j], column_parts[j] = (
            np.uint32((r >> bits) * width + (k >> bits)),
            np.uint32(r),
            np.uint32(k),
        )
    for i in range(size):
        r, k = firsts[0, i], firsts[1, i]
        starts[i], row_gaps[i], column_gaps[i] = (
            np.uint32((r >> bits) * width + (k >> bits)),
            np.uint32(~r),
            np.uint32(~k),
        )
    for i in range(size):
        start, row_gap, column_gap = starts[i], row_gaps[i], column_gaps[i]
        out = numbers[i * size : (i + 1) * size]
        for j in range(size):
            number = np.uint32(start + steps[j])
            number = np.uint32(number + across) if row_parts[j] > row_gap else number
            out[j] = np.uint32(number + one) if column_parts[j] > column_gap else number


@borrowing_kernel
def look_up(cells, numbers, count, levels):
    """Write to levels the values of `count` cells with these numbers; cells: a grid as one row.

    Two numbers are read at once, the first in the lower half. Unsigned numbers index without a sign check.
    """
    even = count // 2 * 2
    pairs, bits, lower = numbers[:even].view(np.uint64), np.uint64(32), np.uint64(2**32 - 1)
    for k in range(even // 2):
        pair, j = pairs[k], np.uint64(2 * k)
        levels[j] = cells[pair & lower]
        levels[j + np.uint64(1)] = cells[pair >> bits]
    if even < count:
        levels[even] = cells[np.uint64(numbers[even])]


@borrowing_kernel
def look_up_row(cells, width, row, column, row_step, column_step, count, numbers, levels):
    """Write to levels the values of the samples of `number_row`; numbers: scratch, at least (count,).

    All indices are computed before the look-ups, which lets the compiler vectorise them.
    """
    number_row(width, row, column, row_step, column_step, count, numbers)
    look_up(cells, numbers, count, levels)
