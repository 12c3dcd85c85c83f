"""Compiled kernels: loops over arrays in the words of Python, as quick as in C.

How they are compiled and where they stand on disk: `twc_env.kernel_compiler`. A kernel may call kernels of other files
and read constants that stand there, taken by `from module import name`; a change of any of them compiles it anew.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from types import ModuleType
from typing import Any

import numba
import numpy as np
from numba import njit, types
from numba.core.cgutils import create_struct_proxy
from numba.core.imputils import impl_ret_borrowed
from numba.experimental import structref
from numba.extending import NativeValue, intrinsic, models, register_model, typeof_impl, unbox

NUMBA_MIN, NUMBA_MAX = (0, 62), (0, 68)
"""Whose insides `kernel_compiler` knows. With another numba kernels are compiled anew in every process."""


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function at its first call; later processes read it from disk.

    Division by zero gives what numpy gives (infinity or NaN). There are no bounds checks: clamp every index.
    """
    return _compiled(function)


def rare_kernel(function: Callable[..., Any]) -> Any:
    """The same for what is called so rarely that it need not be quick, only there soon."""
    return _compiled(function, _dbg_optnone=True)


def borrowing_kernel(function: Callable[..., Any]) -> Any:
    """The same for a function that only reads and fills the arrays it is given: it makes none, gets none from the
    kernels it calls and returns none. Nothing then counts who holds an array, so that calls with many cost less. A pack
    is given to it as `Lent`.
    """
    return _compiled(function, _nrt=False)


def _compiled(function: Callable[..., Any], **others: bool) -> Any:
    for name in function.__code__.co_names:
        value = function.__globals__.get(name)
        if isinstance(value, ModuleType) and value.__name__.startswith("twc_env."):
            raise TypeError(f"kernel {function.__name__}: import names from {value.__name__}, not the module")
    options = {"boundscheck": None, "error_model": "numpy", "no_cfunc_wrapper": True, "_nrt": True, **others}
    if not NUMBA_MIN <= _version(numba.__version__) <= NUMBA_MAX:
        return njit(**options)(function)  # on disk numba alone could mistake an old state of the sources for this one
    from twc_env.kernel_compiler import KernelDispatcher  # another numba may lack what this imports

    compiled = KernelDispatcher(function, targetoptions={"nopython": True, **options})
    compiled.enable_caching()
    return compiled


def _version(text: str) -> tuple[int, ...]:
    return tuple(int(part) for part in text.split(".")[:2])


@structref.register
class _PackType(types.StructRef):
    pass


class Pack(structref.StructRefProxy):
    """Arrays and numbers that a kernel finds in `parts`, a tuple. Can be neither copied nor pickled: make it anew."""

    _numba_type_ = structref.StructRefProxy._type
    """As of the parent, where a property in Python gives it: with every call."""


structref.define_boxing(_PackType, Pack)
structref.define_constructor(Pack, _PackType, ["parts"])
structref.define_attributes(_PackType)


@rare_kernel
def pack(parts):
    """Put the arrays and numbers of a tuple together for kernels that are called time and again with them."""
    return Pack(parts)


class Lent:
    """A pack as a borrowing kernel takes it, which finds its parts by `parts_of`. Keeps the pack in memory."""

    def __init__(self, owner: Pack):
        self.owner, self.address = owner, owner._meminfo.data


class _LentType(types.Opaque):
    def __init__(self, kind: _PackType):
        self.kind = kind
        super().__init__(f"lent {kind}")


register_model(_LentType)(models.OpaqueModel)


@typeof_impl.register(Lent)
def _type_of_lent(value: Lent, _context: Any) -> _LentType:
    return _LentType(value.owner._numba_type_)


@unbox(_LentType)
def _unbox_lent(_kind, value, context):
    number = context.pyapi.object_getattr_string(value, "address")
    address = context.pyapi.long_as_voidptr(number)
    context.pyapi.decref(number)
    return NativeValue(address)


@intrinsic
def parts_of(_context, lent):
    """What `pack` was given, in a borrowing kernel, where nobody counts who holds each of the parts."""
    parts, payload = lent.kind.field_dict["parts"], lent.kind.get_data_type()

    def generate(context, builder, _signature, arguments):
        kind_in_memory = context.data_model_manager[payload].get_value_type()
        address = builder.bitcast(arguments[0], kind_in_memory.as_pointer())
        found = create_struct_proxy(payload)(context, builder, ref=address).parts
        return impl_ret_borrowed(context, builder, parts, found)

    return parts(lent), generate


_ENTRIES: dict[Any, Callable[..., Any]] = {}
"""Compiled code that was bound before, by kernel and kinds."""


def bound(function: Any, held: Any, *others: Any) -> Callable[..., Any]:
    """A kernel with its first argument filled in, to be called with others of the same kinds as these.

    A kernel that is called by its name looks at the type of all that it is given, which takes longer than the call
    itself, above all for a pack. This goes straight to the compiled code. Nothing is looked at then: arrays must be
    contiguous in memory like the first ones, and may not be read-only where those were not.
    Can be neither copied nor pickled, as a pack.
    """
    values = held, *others
    kinds = function, _kind(values)
    if kinds not in _ENTRIES:
        _ENTRIES[kinds] = function.compile(tuple(map(function.typeof_pyval, values)))
    return partial(_ENTRIES[kinds], held)


def _kind(value: Any) -> Any:
    """Equal for values of one type to numba, which takes much longer to tell the type itself."""
    if isinstance(value, np.ndarray):
        return value.dtype, value.ndim, value.flags.num
    if isinstance(value, tuple):
        return tuple(map(_kind, value))
    if isinstance(value, (Lent, Pack)):
        return type(value), (value.owner if isinstance(value, Lent) else value)._numba_type_
    return type(value) if isinstance(value, (bool, int, float, np.generic)) else numba.typeof(value)


def rebound(call: Any, held: Any) -> Any:
    """What `bound` gave with another first argument of the same kind, for arrays that have grown; None stays None."""
    return None if call is None else partial(call.func, held)
