"""Copies that preserve shared memory: views of an array are views of its copy.

Python's own copies detach a view from its array, so that writes to one no longer appear in the other.
"""

from __future__ import annotations

import io
import pickle
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import DataError


class SharingPickler(pickle.Pickler):
    """Pickles arrays such that those that share memory still share it after loading."""

    def dump(self, value: Any) -> None:
        """See `pickle.Pickler`. Raises DataError that names the attribute that cannot be copied."""
        try:
            super().dump(value)
        except (TypeError, AttributeError, ValueError, pickle.PicklingError) as error:
            owner = _culprit(value, type(value).__name__, {}) or type(value).__name__
            raise DataError(
                f"{owner} cannot be copied ({error}): let {owner.partition('.')[0]}.__getstate__ leave it out, and "
                "__setstate__ make it anew"
            ) from error

    def reducer_override(self, value: Any) -> Any:
        """See `pickle.Pickler`."""
        if isinstance(value, CopiedWhole):  # may share arrays with the object that holds it
            return object.__reduce_ex__(value, pickle.HIGHEST_PROTOCOL)
        if type(value) is not np.ndarray or not isinstance(value.base, np.ndarray) or value.dtype.hasobject:
            return NotImplemented
        whole = value.base
        while isinstance(whole.base, np.ndarray):
            whole = whole.base
        # The base of an array that was loaded before is a buffer; its views must share memory in the next copy too.
        if not (whole.flags.c_contiguous or whole.flags.f_contiguous):
            return NotImplemented
        offset = value.__array_interface__["data"][0] - whole.__array_interface__["data"][0]
        return _part_of, (whole, value.dtype, value.shape, value.strides, offset, value.flags.writeable)


class CopiedWhole:
    """Base class of objects that are copied and pickled by `SharingPickler`."""

    def __reduce_ex__(self, protocol: Any) -> tuple:
        buffer = io.BytesIO()
        SharingPickler(buffer, pickle.HIGHEST_PROTOCOL).dump(self)
        return pickle.loads, (buffer.getvalue(),)


def _part_of(whole: Array, dtype: np.dtype, shape: tuple, strides: tuple, offset: int, is_writeable: bool) -> Array:
    """A view of an array with the given layout."""
    part: Array = np.ndarray(shape, dtype, whole.reshape(-1, order="A").view(np.uint8), offset, strides)
    part.flags.writeable = is_writeable and whole.flags.writeable
    return part


def _culprit(value: Any, place: str, seen: dict[int, Any]) -> str | None:
    """Class.attribute of the part that makes a value uncopyable; `place` is that of the value itself."""
    is_whole = True
    for name, part in _parts(value):
        if _can_be_copied(part):
            continue
        is_whole = False
        if id(part) not in seen:
            seen[id(part)] = part
            if (found := _culprit(part, f"{type(value).__name__}.{name}" if name else place, seen)) is not None:
                return found
    return place if is_whole else None


def _can_be_copied(value: Any) -> bool:
    try:
        pickle.Pickler.dump(SharingPickler(io.BytesIO(), pickle.HIGHEST_PROTOCOL), value)
    except Exception:
        return False
    return True


def _parts(value: Any) -> Iterator[tuple[str, Any]]:
    """The parts that are copied with a value: attributes with their names, elements with an empty name."""
    if isinstance(value, (list, tuple, set, frozenset)):
        yield from (("", part) for part in value)
    elif isinstance(value, dict):
        yield from (("", part) for item in value.items() for part in item)
    else:
        try:
            protocol = pickle.HIGHEST_PROTOCOL
            is_whole = isinstance(value, CopiedWhole)
            how = object.__reduce_ex__(value, protocol) if is_whole else value.__reduce_ex__(protocol)
            _, arguments, state, *items = (*how, None)[:5]
        except Exception:  # it raises when copied
            return
        yield from (("", part) for part in arguments)
        for attributes in state if isinstance(state, tuple) else (state,):
            yield from attributes.items() if isinstance(attributes, dict) else (("", attributes),)
        yield from (("", part) for held in items if held is not None for part in held)
