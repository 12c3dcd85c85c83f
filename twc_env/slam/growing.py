"""Room for rows of numbers that come one at a time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray


def doubled(rows: Array) -> Array:
    """The rows, with as many empty ones behind them, to which the system gives memory once they are written to."""
    grown = np.zeros((2 * len(rows), *rows.shape[1:]), rows.dtype)
    grown[: len(rows)] = rows
    return grown
