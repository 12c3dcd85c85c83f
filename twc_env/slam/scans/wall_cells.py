"""Encoding of a line field cell in 32 bits: distance to the nearest wall and index of its line.

The distance is in the upper half, so that the minimum of two cells is the nearer wall.
"""

from __future__ import annotations

import numpy as np

from twc_env.kernels.compiled import borrowing_kernel

NO_WALL = np.uint32(0xFFFFFFFF)
"""A cell without a wall ..."""
LINES_MAX = 0xFFFF
"""... and its line index, one past the last valid line."""
FAR_M = 1e3
"""Its distance."""
_STEPS_PER_M = np.float32(2.0**17)
"""Distances have a resolution below a hundredth of a millimetre, up to half a metre."""
_DISTANCE_BIT = np.uint32(16)


@borrowing_kernel
def wall_cell(distance, line):
    """Encode a wall at a distance [m] below 0.5 (float32), on the line of this index (uint32)."""
    return np.uint32(np.uint32(np.uint32(np.int32(distance * _STEPS_PER_M)) << _DISTANCE_BIT) | line)


@borrowing_kernel
def distance_in(cell):
    """Distance [m] (float32) of the cell's wall; `FAR_M` without one."""
    steps = np.float32(np.int32(np.uint32(cell >> _DISTANCE_BIT)))
    return np.float32(FAR_M) if cell == NO_WALL else steps * np.float32(1.0 / _STEPS_PER_M)


@borrowing_kernel
def line_in(cell):
    """Index of the line of that wall, or `LINES_MAX`; unsigned."""
    return np.uint64(cell) & np.uint64(LINES_MAX)
