"""Arrays with spare rows, for data that arrive row by row."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import kernel

ROOM, SPARE = 1024, 64
"""Initial rows, enough for a typical episode; least number of spare rows after a removal."""
READINGS_ROOM = 32 * ROOM
"""Initial room for RSSI readings of all fingerprints."""
MANY = 4096
"""Arrays with as many rows grow by a quarter, smaller ones double."""


def grown(rows: Array) -> Array:
    """A larger copy with zero rows at the end.

    They usually take memory only once written to, but not if the allocator clears old memory for them: large arrays
    therefore grow by a quarter only.
    """
    count = len(rows)
    out = np.zeros((2 * count if count < MANY else count + count // 4, *rows.shape[1:]), rows.dtype)
    out[:count] = rows
    return out


def only(rows: Array, kept: Array | slice) -> Array:
    """Some of the rows (indices, bool or slice), followed by as many zero rows, `SPARE` at least."""
    chosen = rows[kept]
    return np.concatenate([chosen, np.zeros((max(len(chosen), SPARE), *rows.shape[1:]), rows.dtype)])


@kernel
def enlarged(values, size):
    """A copy of at least this size and twice the old one; the new elements are uninitialised."""
    bigger = np.empty(max(size, 2 * len(values)), values.dtype)
    bigger[: len(values)] = values
    return bigger
