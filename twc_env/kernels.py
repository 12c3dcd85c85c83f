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
from numba import njit

from twc_env.kernel_packs import Lent, kind_of, parts_of

__all__ = ["BindsAnew", "Lent", "borrowing_kernel", "bound", "kernel", "parts_of", "rebound"]
NUMBA_MIN, NUMBA_MAX = (0, 62), (0, 68)
"""Whose insides `kernel_compiler` knows. With another numba kernels are compiled anew in every process."""


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function at its first call; later processes read it from disk.

    Division by zero gives what numpy gives (infinity or NaN). There are no bounds checks: clamp every index.
    """
    return _compiled(function)


def borrowing_kernel(function: Callable[..., Any]) -> Any:
    """The same for a function that only reads and fills the arrays it is given: it makes none, gets none from the
    kernels it calls and returns none. Nothing then counts who holds an array, so that calls with many cost less. What
    is `Lent` can be given to it.
    """
    return _compiled(function, _nrt=False)


def _compiled(function: Callable[..., Any], **others: bool) -> Any:
    for name in function.__code__.co_names:
        value = function.__globals__.get(name)
        if isinstance(value, ModuleType) and value.__name__.startswith("twc_env."):
            raise TypeError(f"kernel {function.__name__}: import names from {value.__name__}, not the module")
    options = {"boundscheck": None, "error_model": "numpy", "no_cfunc_wrapper": True, "_nrt": True, **others}
    if not is_numba_known():
        return njit(**options)(function)  # on disk numba alone could mistake an old state of the sources for this one
    from twc_env.kernel_compiler import KernelDispatcher  # another numba may lack what this imports

    compiled = KernelDispatcher(function, targetoptions={"nopython": True, **options})
    compiled.enable_caching()
    return compiled


def is_numba_known() -> bool:
    """Whether kernels stand on disk with this numba."""
    return NUMBA_MIN <= tuple(int(part) for part in numba.__version__.split(".")[:2]) <= NUMBA_MAX


_ENTRIES: dict[Any, Callable[..., Any]] = {}
"""Compiled code that was bound before, by kernel and kinds."""


def bound(function: Any, held: Any, *others: Any) -> Callable[..., Any]:
    """A kernel with its first argument filled in, to be called with others of the same kinds as these.

    A kernel that is called by its name looks at the type of all that it is given, which takes longer than the call
    itself, above all for a pack. This goes straight to the compiled code. Nothing is looked at then: arrays must be
    contiguous in memory like the first ones, and may not be read-only where those were not.
    Can be neither copied nor pickled, see `BindsAnew`.
    """
    values = held, *others
    kinds = function, kind_of(values)
    if kinds not in _ENTRIES:
        _ENTRIES[kinds] = function.compile(tuple(map(function.typeof_pyval, values)))
    return partial(_ENTRIES[kinds], held)


def rebound(call: Any, held: Any) -> Any:
    """What `bound` gave with another first argument of the same kind, for arrays that have grown; None stays None."""
    return None if call is None else partial(call.func, held)


class BindsAnew:
    """What derives from it keeps bound kernels, or None for want of them: its copies have None and bind their own."""

    def __getstate__(self) -> dict[str, Any]:
        return {name: None if isinstance(value, partial) else value for name, value in self.__dict__.items()}
