"""Arguments that a kernel needs repeatedly, laid out once in memory as compiled code reads them; calls pass a pointer.

This needs no compilation: arrays and tuples get the fields of numba's data models.
"""

from __future__ import annotations

import ctypes
from struct import Struct
from typing import Any

import numba
import numpy as np
from numba import types
from numba.extending import NativeValue, intrinsic, models, register_model, typeof_impl, unbox

_NUMBERS: dict[Any, str] = {bool: "?", int: "q", float: "d"}


class Lent(int):
    """Tuples of arrays and numbers for borrowing kernels, which get them by `parts_of`. Keeps the arrays alive.

    A tuple inside it must not consist of bools only. It can be neither copied nor pickled: make a new one. It is an int
    that holds its own address, because reading an attribute would take twice as long as the rest of a call.
    """

    kind: Any
    numba_type: LentType
    _parts: tuple
    _memory: ctypes.Array

    def __new__(cls, parts: tuple) -> Lent:
        """Lay out these parts in memory."""
        kind = kind_of(parts)
        if kind not in _LAYOUTS:
            layout = Struct(_layout_of(parts))
            _LAYOUTS[kind] = layout, LentType(numba.typeof(parts), layout.size)
        layout, numba_type = _LAYOUTS[kind]
        fields: list[Any] = []
        _list_fields(parts, fields)
        memory = ctypes.create_string_buffer(layout.pack(*fields), layout.size)
        lent = super().__new__(cls, ctypes.addressof(memory))
        lent.kind, lent.numba_type, lent._parts, lent._memory = kind, numba_type, parts, memory
        return lent

    def __reduce__(self):
        raise TypeError("a Lent holds memory addresses: make it anew instead of copying or pickling it")


_LAYOUTS: dict[Any, tuple[Struct, LentType]] = {}
"""Layouts by the kinds of the parts."""


def kind_of(value: Any) -> Any:
    """A key that is equal for values of one numba type; much faster than `numba.typeof`."""
    if isinstance(value, np.ndarray):
        return value.dtype, value.ndim, value.flags.num
    if isinstance(value, tuple):
        return tuple(map(kind_of, value))
    if isinstance(value, Lent):
        return Lent, value.kind
    return type(value) if isinstance(value, (bool, int, float, np.generic)) else numba.typeof(value)


def _layout_of(value: Any) -> str:
    """Layout of a value in compiled code, as a format of `struct`.

    Fields of an array: two owners (unused), number of elements, bytes per element, address, shape and strides.
    """
    if isinstance(value, np.ndarray):
        return "PPnnP" + 2 * value.ndim * "n"
    if isinstance(value, tuple):
        return f"0n{''.join(map(_layout_of, value))}0n"
    return value.dtype.char if isinstance(value, np.generic) else _NUMBERS[type(value)]


def _list_fields(value: Any, fields: list[Any]) -> None:
    """Append the values of these fields."""
    if isinstance(value, np.ndarray):
        fields += 0, 0, value.size, value.itemsize, _place_of(value), *value.shape, *value.strides
    elif isinstance(value, tuple):
        for part in value:
            _list_fields(part, fields)
    else:
        fields.append(value)


def _place_of(array: Any) -> int:
    if array.size and array.flags.carray:
        return ctypes.addressof(ctypes.c_char.from_buffer(array))  # much faster, but not possible for all arrays
    return array.__array_interface__["data"][0]


class LentType(types.Opaque):
    """Numba type of `Lent`."""

    def __init__(self, parts: types.Type, size: int):
        self.parts, self.size = parts, size
        super().__init__(f"place of {parts}")  # the name is part of the key of the disk cache


register_model(LentType)(models.OpaqueModel)


@typeof_impl.register(Lent)
def _type_of_lent(value: Lent, _context: Any) -> LentType:
    return value.numba_type


@unbox(LentType)
def _unbox_lent(_kind, value, context):
    return NativeValue(context.pyapi.long_as_voidptr(value))


@intrinsic
def parts_of(_context, lent):
    """The parts of a `Lent`; only in a borrowing kernel, because references are not counted."""

    def generate(context, builder, _signature, arguments):
        kind_in_memory = context.get_value_type(lent.parts)
        if context.get_abi_sizeof(kind_in_memory) != lent.size:
            raise TypeError(f"this numba lays out {lent.parts} in another way")
        return builder.load(builder.bitcast(arguments[0], kind_in_memory.as_pointer()))  # its arrays have no owners

    return lent.parts(lent), generate
