"""What stands in a map, one small number per cell: what pictures of it look up, instead of several log-odds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twc_env.kernels import kernel

Array = NDArray

UNKNOWN, FREE, WALL = range(3)


@kernel
def _kind(highest, lowest):
    return np.uint8(WALL) if highest > 0 else (np.uint8(FREE) if lowest < 0 else np.uint8(UNKNOWN))


@kernel
def note_kinds(log_odds, first_row, first_column, end_row, end_column, kinds):
    """Write what stands in the square of four cells from each of these cells on, upwards and to the right.

    A square with a wall in it is `WALL`, any other with free space in it `FREE`; so a thin wall is hardly ever missed.
    Cells of the last row and column stand for themselves and for what is beside them.
    """
    rows, columns = log_odds.shape
    for r in range(max(first_row, 0), min(end_row, rows)):
        here, above, out = log_odds[r], log_odds[min(r + 1, rows - 1)], kinds[r]
        for c in range(max(first_column, 0), min(end_column, columns - 1)):
            highest = max(max(here[c], here[c + 1]), max(above[c], above[c + 1]))
            lowest = min(min(here[c], here[c + 1]), min(above[c], above[c + 1]))
            out[c] = _kind(highest, lowest)
        if end_column >= columns > 0:
            c = columns - 1
            out[c] = _kind(max(here[c], above[c]), min(here[c], above[c]))


def kinds_of(log_odds: Array) -> Array:
    """(rows, columns) uint8 of a whole map (rows, columns) int16, as `note_kinds` has it."""
    kinds = np.empty(log_odds.shape, np.uint8)
    note_kinds(log_odds, 0, 0, *log_odds.shape, kinds)
    return kinds
