"""What a cell of a field of lines says in four bytes: how far the wall nearest to it is, and which line that wall is.

The distance stands in the upper half, so that of two walls the nearer one is the smaller number.
"""

from __future__ import annotations

import numpy as np

from twc_env.kernels import borrowing_kernel

NO_WALL = np.uint32(0xFFFFFFFF)
"""A cell that knows no wall ..."""
LINES_MAX = 0xFFFF
"""... and the row of the lines that it names, which nobody fills: there are as many lines before it."""
FAR_M = 1e3
"""Its distance."""
_STEPS_PER_M = np.float32(2.0**17)
"""Distances are kept in steps of less than a hundredth of a millimetre, up to half a metre."""
_DISTANCE_BIT = np.uint32(16)


@borrowing_kernel
def wall_cell(distance, line):
    """A wall at a distance [m] below 0.5 (float32), on a line of this number (uint32)."""
    return np.uint32(np.uint32(np.uint32(np.int32(distance * _STEPS_PER_M)) << _DISTANCE_BIT) | line)


@borrowing_kernel
def distance_in(cell):
    """Distance [m] (float32) of the wall that a cell knows; `FAR_M` where it knows none."""
    steps = np.float32(np.int32(np.uint32(cell >> _DISTANCE_BIT)))
    return np.float32(FAR_M) if cell == NO_WALL else steps * np.float32(1.0 / _STEPS_PER_M)


@borrowing_kernel
def line_in(cell):
    """The line of that wall, or `LINES_MAX`; an index without sign."""
    return np.uint64(cell) & np.uint64(LINES_MAX)
