"""Copies that are whole: arrays that lie in the memory of others still do so afterwards.

Python's own copies part a view from the array that it shows: what is then written to one is not seen in the other.
"""

from __future__ import annotations

import io
import pickle
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array


class SharingPickler(pickle.Pickler):
    """Keeps arrays that share memory sharing it."""

    def reducer_override(self, value: Any) -> Any:
        """See `pickle.Pickler`."""
        if isinstance(value, CopiedWhole):  # a part of something larger, with which it may share arrays
            return object.__reduce_ex__(value, pickle.HIGHEST_PROTOCOL)
        if type(value) is not np.ndarray or not isinstance(value.base, np.ndarray) or value.dtype.hasobject:
            return NotImplemented
        whole = value.base
        while isinstance(whole.base, np.ndarray):
            whole = whole.base
        if whole.base is not None or not (whole.flags.c_contiguous or whole.flags.f_contiguous):
            return NotImplemented
        offset = value.__array_interface__["data"][0] - whole.__array_interface__["data"][0]
        return _part_of, (whole, value.dtype, value.shape, value.strides, offset, value.flags.writeable)


class CopiedWhole:
    """What derives from it is copied and pickled by `SharingPickler`."""

    def __reduce_ex__(self, protocol: Any) -> tuple:
        buffer = io.BytesIO()
        SharingPickler(buffer, pickle.HIGHEST_PROTOCOL).dump(self)
        return pickle.loads, (buffer.getvalue(),)


def _part_of(whole: Array, dtype: np.dtype, shape: tuple, strides: tuple, offset: int, is_writeable: bool) -> Array:
    """The view of an array that another array was."""
    part: Array = np.ndarray(shape, dtype, whole.reshape(-1, order="A").view(np.uint8), offset, strides)
    part.flags.writeable = is_writeable and whole.flags.writeable
    return part
