"""What a kernel needs time and again, laid out once in memory as compiled code holds it: a call only gives the place.

Nothing is compiled for that: arrays and tuples get the fields that numba's data models give them.
"""

from __future__ import annotations

import ctypes
from struct import Struct
from typing import Any

import numba
import numpy as np
from numba.core import types
from numba.core.imputils import impl_ret_borrowed
from numba.extending import NativeValue, intrinsic, models, register_model, typeof_impl, unbox

_NUMBERS: dict[Any, str] = {bool: "?", int: "q", float: "d"}


class Lent(int):
    """Arrays and numbers, in tuples, for borrowing kernels, which find them by `parts_of`. Keeps them in memory.

    A tuple inside of it holds not only truth values. Can be neither copied nor pickled: make it anew. To compiled code
    it is the number of its place in memory: to ask an object for that takes twice as long as the rest of a call.
    """

    kind: Any
    numba_type: LentType
    _parts: tuple
    _memory: ctypes.Array

    def __new__(cls, parts: tuple) -> Lent:
        """Lay out these parts."""
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
        raise TypeError("what is lent to kernels stands at a place in memory: make it anew instead of copying it")


_LAYOUTS: dict[Any, tuple[Struct, LentType]] = {}
"""By the kinds of the parts."""


def kind_of(value: Any) -> Any:
    """Equal for values of one type to numba, which takes much longer to tell the type itself."""
    if isinstance(value, np.ndarray):
        return value.dtype, value.ndim, value.flags.num
    if isinstance(value, tuple):
        return tuple(map(kind_of, value))
    if isinstance(value, Lent):
        return Lent, value.kind
    return type(value) if isinstance(value, (bool, int, float, np.generic)) else numba.typeof(value)


def _layout_of(value: Any) -> str:
    """How compiled code holds a value, in the letters of `struct`.

    Of an array: two owners, which nobody asks for; numbers in all, bytes of each, place, shape and strides.
    """
    if isinstance(value, np.ndarray):
        return "PPnnP" + 2 * value.ndim * "n"
    if isinstance(value, tuple):
        return f"0n{''.join(map(_layout_of, value))}0n"
    return value.dtype.char if isinstance(value, np.generic) else _NUMBERS[type(value)]


def _list_fields(value: Any, fields: list[Any]) -> None:
    """What stands in these places."""
    if isinstance(value, np.ndarray):
        fields += 0, 0, value.size, value.itemsize, _place_of(value), *value.shape, *value.strides
    elif isinstance(value, tuple):
        for part in value:
            _list_fields(part, fields)
    else:
        fields.append(value)


def _place_of(array: Any) -> int:
    if array.size and array.flags.carray:
        return ctypes.addressof(ctypes.c_char.from_buffer(array))  # much quicker, but it takes not all arrays
    return array.__array_interface__["data"][0]


class LentType(types.Opaque):
    """To numba, something `Lent`."""

    def __init__(self, parts: types.Type, size: int):
        self.parts, self.size = parts, size
        super().__init__(f"place of {parts}")  # by this name kernels are found on disk


register_model(LentType)(models.OpaqueModel)


@typeof_impl.register(Lent)
def _type_of_lent(value: Lent, _context: Any) -> LentType:
    return value.numba_type


@unbox(LentType)
def _unbox_lent(_kind, value, context):
    return NativeValue(context.pyapi.long_as_voidptr(value))


@intrinsic
def parts_of(_context, lent):
    """What is `Lent`, in a borrowing kernel, where nobody counts who holds each of the parts."""

    def generate(context, builder, _signature, arguments):
        kind_in_memory = context.get_value_type(lent.parts)
        if context.get_abi_sizeof(kind_in_memory) != lent.size:
            raise TypeError(f"this numba lays out {lent.parts} in another way")
        found = builder.load(builder.bitcast(arguments[0], kind_in_memory.as_pointer()))
        return impl_ret_borrowed(context, builder, lent.parts, found)

    return lent.parts(lent), generate
