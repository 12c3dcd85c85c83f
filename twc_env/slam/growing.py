"""Arrays that grow row by row."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray


class Growing:
    """Rows of numbers that grow one at a time without copying each time."""

    def __init__(self, *shape: int, dtype: type = np.float64):
        self._data: Array = np.zeros((64, *shape), dtype)
        self.count = 0

    def append(self, row) -> None:
        """Add one row."""
        if self.count == len(self._data):
            self._data = doubled(self._data)
        self._data[self.count] = row
        self.count += 1

    @property
    def rows(self) -> Array:
        """All rows so far; may be written to."""
        return self._data[: self.count]


def doubled(rows: Array) -> Array:
    """The rows, with as many empty ones behind them, to which the system gives memory once they are written to."""
    grown = np.zeros((2 * len(rows), *rows.shape[1:]), rows.dtype)
    grown[: len(rows)] = rows
    return grown
