"""Repeated work of numba's compiler done once, which saves a sixth of a cold start. The resulting code is the same.

`KernelContext` replaces the target context, which lowers typed code to LLVM's; each compilation has its own.
`nothing_twice` caches or skips results that numba computes again at each place.
"""

from __future__ import annotations

import contextlib
import operator
from collections.abc import Iterator
from functools import cached_property
from types import BuiltinFunctionType
from typing import Any

from numba.core import errors, types
from numba.core.compiler import Flags, compile_internal
from numba.core.cpu import CPUContext
from numba.core.postproc import PostProcessor, VariableLifetime
from numba.core.runtime.context import NRTContext
from numba.core.targetconfig import ConfigStack
from numba.core.transforms import canonicalize_cfg
from numba.core.types.functions import BaseFunction
from numba.core.typing.context import BaseContext

from twc_env.kernels.kernel_library import PartLibrary

_SIZES: dict[Any, int] = {}
"""Size in bytes of values of an LLVM type; numba has LLVM parse a text for each query."""
_OPERATORS = {getattr(operator, name) for name in operator.__all__ if name != "contains"} | {abs, bool}
_OPERANDS = (types.Number, types.Boolean, types.Array)
_SIGNATURES: dict[Any, Any] = {}
"""Signatures by operator and types of arguments."""


class KernelContext(CPUContext):
    """Numba's target context, for one compilation."""

    @classmethod
    def take(cls, context: CPUContext) -> None:
        """Turn numba's context of a compilation into a KernelContext."""
        context.__class__ = cls
        context.__dict__.pop("nrt", None)

    @cached_property
    def nrt(self) -> NRTContext:
        """Reference counting of arrays."""
        return _References(self, self.enable_nrt)

    def load_additional_registries(self) -> None:
        """Do nothing: numba has loaded them at the start of the compilation."""

    def get_abi_sizeof(self, ty: Any) -> int:
        """Size of a value in bytes."""
        if ty not in _SIZES:
            _SIZES[ty] = super().get_abi_sizeof(ty)
        return _SIZES[ty]

    def _compile_subroutine_no_cache(self, builder, impl, sig, locals=None, flags=None):
        """Compile one of numba's own functions that lowering requests, as a part."""
        flags = Flags() if flags is None else flags
        flags.nrt = flags.nrt or getattr(ConfigStack.top_or_none(), "nrt", False)
        flags.no_compile = flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
        library = PartLibrary(self.codegen(), impl.__name__)
        compiled = compile_internal(
            self.typing_context, self, library, impl, sig.args, sig.return_type, flags, locals=locals or {}
        )
        self.active_code_library.add_linking_library(library)
        return compiled


class _References(NRTContext):
    """Numba's reference counting, which unpacks only the counted fields of an array, not shape and strides."""

    def get_meminfos(self, builder, ty, val):
        """Types and pointers of all reference-counted fields of a value."""
        model = self._context.data_model_manager[ty]
        found = [(ty, model.get_nrt_meminfo(builder, val))] if model.has_nrt_meminfo() else []
        for kind, getter in model.traverse(builder):
            if _is_counted(self._context, kind):
                found.extend(self.get_meminfos(builder, kind, getter(val)))
        return found


_COUNTED: dict[types.Type, bool] = {}


def _is_counted(context: CPUContext, kind: types.Type) -> bool:
    if kind not in _COUNTED:
        _COUNTED[kind] = context.data_model_manager[kind].contains_nrt_meminfo()
    return _COUNTED[kind]


@contextlib.contextmanager
def nothing_twice() -> Iterator[None]:
    """Within this context numba resolves an operator once per types of operands, computes lifetimes of variables only
    when it frees them, and does not colour errors.
    """
    functions: Any = BaseFunction
    processor: Any = PostProcessor
    colours: Any = errors.termcolor()
    typing: Any = BaseContext
    find, process, look_up = functions.get_call_type, processor.run, typing.resolve_value_type
    operators: dict[Any, Any] = {}

    def remember(self, context, args, kws):
        if kws or self.typing_key not in _OPERATORS or not isinstance(args[0], _OPERANDS):
            return find(self, context, args, kws)
        key = self.typing_key, tuple(args)
        if key not in _SIGNATURES:
            _SIGNATURES[key] = find(self, context, args, kws)
        return _SIGNATURES[key]

    def name(self, value):
        if type(value) is not BuiltinFunctionType or value not in _OPERATORS:
            return look_up(self, value)
        if value not in operators:
            operators[value] = look_up(self, value)
        return operators[value]

    def tidy(self, emit_dels=False, extend_lifetimes=False):
        code = self.func_ir
        if code.is_generator:
            return process(self, emit_dels, extend_lifetimes)
        code.blocks = canonicalize_cfg(code.blocks)
        code.variable_lifetime = VariableLifetime(code.blocks)
        code.generator_info = None
        if emit_dels:
            self._insert_var_dels(extend_lifetimes=extend_lifetimes)

    functions.get_call_type, processor.run, typing.resolve_value_type = remember, tidy, name
    colours.errmsg = str
    try:
        yield
    finally:
        functions.get_call_type, processor.run, typing.resolve_value_type = find, process, look_up
        del colours.errmsg
