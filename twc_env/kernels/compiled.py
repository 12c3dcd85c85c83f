"""Compiled kernels: loops over arrays, written in Python and as fast as in C.

Numba compiles them at their first call and keeps them in `twc_env.kernels.cache_folder`. A kernel may call kernels of
other files and read their constants, imported by `from module import name`; what depends on a change compiles anew.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from types import ModuleType
from typing import Any

from numba import njit, typeof

from twc_env.kernels.cache_folder import caching_there
from twc_env.kernels.compilation import one_process_compiles
from twc_env.kernels.packs import Lent, kind_of, parts_of

__all__ = ["BindsAnew", "Lent", "borrowing_kernel", "bound", "kernel", "parts_of", "rebound"]


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function at its first call; later processes load it from disk.

    Division by zero gives infinity or NaN, as in numpy. There are no bounds checks: clamp every index.
    """
    return _compiled(function)


def borrowing_kernel(function: Callable[..., Any]) -> Any:
    """As `kernel`, for a function that only reads and fills its argument arrays: it allocates no array, gets none from
    the kernels it calls and returns none. Without reference counting, calls with many arrays cost less. It accepts
    `Lent` arguments.
    """
    return _compiled(function, _nrt=False)


def _compiled(function: Callable[..., Any], _nrt: bool = True) -> Any:
    for name in function.__code__.co_names:
        value = function.__globals__.get(name)
        if isinstance(value, ModuleType) and value.__name__.startswith("twc_env."):
            raise TypeError(f"kernel {function.__name__}: import names from {value.__name__}, not the module")
    one_process_compiles()
    own = {"no_cfunc_wrapper": True, "_nrt": _nrt} if _knows_own_options() else {}
    with caching_there(function):
        return njit(cache=True, error_model="numpy", boundscheck=None, **own)(function)


@cache
def _knows_own_options() -> bool:
    """Whether this numba knows two options of njit that it does not document; without them everything works, but
    slower: borrowing kernels count references."""
    try:
        njit(no_cfunc_wrapper=True, _nrt=False)(lambda: None)
    except (KeyError, TypeError, ValueError):
        return False
    return True


_ENTRIES: dict[Any, Callable[..., Any]] = {}
"""Compiled entry points that were bound before, by kernel and types of arguments."""


def bound(function: Any, held: Any, *others: Any) -> Callable[..., Any]:
    """A kernel with its first argument bound, to be called with other arguments of the same types as these.

    A normal call of a kernel checks the types of all arguments, which takes longer than the call itself, above all for
    tuples. This calls the compiled code directly, without checks: arrays must have the same memory layout as these, and
    must be writable if these were. The result can be neither copied nor pickled, see `BindsAnew`.
    """
    values = held, *others
    kinds = function, kind_of(values)
    if kinds not in _ENTRIES:
        entry = function.compile(tuple(map(typeof, values)))
        _ENTRIES[kinds] = entry if callable(entry) else function  # what `compile` returns is not documented
    return partial(_ENTRIES[kinds], held)


def rebound(call: Any, held: Any) -> Any:
    """A result of `bound` with another first argument of the same type, for arrays that have grown; None stays None."""
    return None if call is None else partial(call.func, held)


class BindsAnew:
    """Base class of objects that keep bound kernels (or None): their copies have None and bind their own."""

    def __getstate__(self) -> dict[str, Any]:
        return {name: None if isinstance(value, partial) else value for name, value in self.__dict__.items()}
