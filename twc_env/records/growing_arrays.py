"""Arrays with spare rows, for data that arrive row by row."""

from __future__ import annotations

import math
import mmap

import numpy as np
from numpy.typing import DTypeLike
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import kernel

ROOM, SPARE = 1024, 64
"""Initial rows, enough for a typical episode; least number of spare rows after a removal."""
READINGS_ROOM = 32 * ROOM
"""Initial room for RSSI readings of all fingerprints."""
LARGE = 2**17
"""Size [bytes] from which `lazy_zeros` asks the system for memory of their own."""
_OF_THIS_PROCESS = {"flags": mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS} if hasattr(mmap, "MAP_PRIVATE") else {}


def lazy_zeros(shape: tuple[int, ...], dtype: DTypeLike = float) -> Array:
    """Zeros of which, if there are many, each page takes memory only once it is written to.

    Those of NumPy do so too, but not where the allocator clears memory for them that was in use before: that of the
    last episode, say.
    """
    size = math.prod(shape) * np.dtype(dtype).itemsize
    if size < LARGE:
        return np.zeros(shape, dtype)
    return np.frombuffer(mmap.mmap(-1, size, **_OF_THIS_PROCESS), dtype).reshape(shape)


def grown(rows: Array) -> Array:
    """A copy with as many zero rows at the end."""
    out = lazy_zeros((2 * len(rows), *rows.shape[1:]), rows.dtype)
    out[: len(rows)] = rows
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
