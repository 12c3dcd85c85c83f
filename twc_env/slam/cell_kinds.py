"""What stands in a map, one small number per cell: what pictures of it look up, instead of several log-odds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels import borrowing_kernel, kernel

UNKNOWN, FREE, WALL = range(3)


@kernel
def _kind(highest, lowest):
    return np.uint8(WALL) if highest > 0 else (np.uint8(FREE) if lowest < 0 else np.uint8(UNKNOWN))


@borrowing_kernel
def note_kinds(log_odds, first_row, first_column, end_row, end_column, kinds):
    """Write what stands in the square of four cells from each of these cells on, upwards and to the right.

    A square with a wall in it is `WALL`, any other with free space in it `FREE`; so a thin wall is hardly ever missed.
    Cells of the last row and column stand for themselves and for what is beside them.
    """
    rows, columns = log_odds.shape
    first, end = max(first_column, 0), min(end_column, columns - 1)
    for r in range(max(first_row, 0), min(end_row, rows)):
        above = min(r + 1, rows - 1)
        if first < end:
            a, b, out = log_odds[r, first : end + 1], log_odds[above, first : end + 1], kinds[r, first:end]
            for c in range(out.shape[0]):  # many cells at once
                highest = max(max(a[c], a[c + 1]), max(b[c], b[c + 1]))
                lowest = min(min(a[c], a[c + 1]), min(b[c], b[c + 1]))
                out[c] = _kind(highest, lowest)
        if end_column >= columns > 0:
            last = columns - 1
            here, there = log_odds[r, last], log_odds[above, last]
            kinds[r, last] = _kind(max(here, there), min(here, there))


def kinds_of(log_odds: Array) -> Array:
    """(rows, columns) uint8 of a whole map (rows, columns) int16, as `note_kinds` has it."""
    kinds = np.empty(log_odds.shape, np.uint8)
    note_kinds(log_odds, 0, 0, *log_odds.shape, kinds)
    return kinds
