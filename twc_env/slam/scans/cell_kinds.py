"""Class of each map cell (unknown, free, wall) as one uint8: map images look up one value instead of four log-odds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import borrowing_kernel, kernel

UNKNOWN, FREE, WALL = range(3)


@kernel
def _kind(highest, lowest):
    return np.uint8(WALL) if highest > 0 else (np.uint8(FREE) if lowest < 0 else np.uint8(UNKNOWN))


@borrowing_kernel
def note_kinds(log_odds, first_row, first_column, end_row, end_column, kinds):
    """Write to kinds, in place, the class of the 2 x 2 cells that extend up and right from each cell of a region.

    `WALL` if any of the four is a wall, else `FREE` if any is free: a thin wall is rarely missed when the image is
    subsampled. In the last row and column the missing neighbours are ignored. Empty kinds stay empty.
    """
    rows, columns = log_odds.shape
    if kinds.shape[0] < rows:
        return
    first, end = max(first_column, 0), min(end_column, columns - 1)
    for r in range(max(first_row, 0), min(end_row, rows)):
        above = min(r + 1, rows - 1)
        if first < end:
            a, b, out = log_odds[r, first : end + 1], log_odds[above, first : end + 1], kinds[r, first:end]
            for c in range(out.shape[0]):  # vectorised by the compiler
                highest = max(max(a[c], a[c + 1]), max(b[c], b[c + 1]))
                lowest = min(min(a[c], a[c + 1]), min(b[c], b[c + 1]))
                out[c] = _kind(highest, lowest)
        if end_column >= columns > 0:
            last = columns - 1
            here, there = log_odds[r, last], log_odds[above, last]
            kinds[r, last] = _kind(max(here, there), min(here, there))


def kinds_of(log_odds: Array) -> Array:
    """(rows, columns) uint8 classes of a complete map of log-odds (rows, columns) int16, see `note_kinds`."""
    kinds = np.empty(log_odds.shape, np.uint8)
    note_kinds(log_odds, 0, 0, *log_odds.shape, kinds)
    return kinds
