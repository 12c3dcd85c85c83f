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
from numba import njit, types
from numba.experimental import structref

NUMBA_MIN, NUMBA_MAX = (0, 62), (0, 68)
"""Whose insides `kernel_compiler` knows. With another numba kernels are compiled anew in every process."""


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function at its first call; later processes read it from disk.

    Division by zero gives what numpy gives (infinity or NaN). There are no bounds checks: clamp every index.
    """
    return _compiled(function, counts_references=True)


def borrowing_kernel(function: Callable[..., Any]) -> Any:
    """The same for a function that only reads and fills the arrays it is given: it makes none, gets none from the
    kernels it calls and returns none. Nothing then counts who holds an array, so that calls with many cost less.
    """
    return _compiled(function, counts_references=False)


def _compiled(function: Callable[..., Any], counts_references: bool) -> Any:
    for name in function.__code__.co_names:
        value = function.__globals__.get(name)
        if isinstance(value, ModuleType) and value.__name__.startswith("twc_env."):
            raise TypeError(f"kernel {function.__name__}: import names from {value.__name__}, not the module")
    options: dict[str, Any] = {"boundscheck": None, "error_model": "numpy", "no_cfunc_wrapper": True}
    options["_nrt"] = counts_references
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


@kernel
def pack(parts):
    """Put the arrays and numbers of a tuple together for kernels that are called time and again with them."""
    return Pack(parts)


def bound(function: Any, held: Any, *others: Any) -> Callable[..., Any]:
    """A kernel with its first argument filled in, to be called with others of the same kinds as these.

    A kernel that is called by its name looks at the type of all that it is given, which takes longer than the call
    itself, above all for a pack. This goes straight to the compiled code. Nothing is looked at then: arrays must be
    contiguous in memory like the first ones, and may not be read-only where those were not.
    Can be neither copied nor pickled, as a pack.
    """
    kinds = tuple(function.typeof_pyval(value) for value in (held, *others))
    return partial(function.compile(kinds), held)


def rebound(call: Any, held: Any) -> Any:
    """What `bound` gave with another first argument of the same kind, for arrays that have grown; None stays None."""
    return None if call is None else partial(call.func, held)
