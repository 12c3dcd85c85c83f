"""Room for rows of numbers that come one at a time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels import kernel

ROOM, SPARE = 1024, 64
"""Rows to begin with, enough for a usual episode; and empty ones, at least, where only some are left."""
READINGS_ROOM = 32 * ROOM
"""Transmitters heard at all of these, to begin with."""
MANY = 4096
"""From so many rows on arrays grow by a quarter at a time."""


def grown(rows: Array) -> Array:
    """The rows, with empty ones behind them, to which the system gives memory once they are written to.

    As many again; a quarter where they are `MANY`, for it may have cleared old memory for them and give it at once.
    """
    count = len(rows)
    out = np.zeros((2 * count if count < MANY else count + count // 4, *rows.shape[1:]), rows.dtype)
    out[:count] = rows
    return out


def only(rows: Array, kept: Array | slice) -> Array:
    """Some of the rows, by indices or bool, with as many empty ones behind them, `SPARE` at least."""
    chosen = rows[kept]
    return np.concatenate([chosen, np.zeros((max(len(chosen), SPARE), *rows.shape[1:]), rows.dtype)])


@kernel
def enlarged(values, size):
    """The numbers, with as many places behind them as there are, or up to this size, of which nothing is known."""
    bigger = np.empty(max(size, 2 * len(values)), values.dtype)
    bigger[: len(values)] = values
    return bigger
