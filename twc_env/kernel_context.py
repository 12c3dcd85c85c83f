"""What numba does time and again while it compiles, done once. The code that comes out is the same.

Between the typed code of a kernel and LLVM's stands a target context, of which each compilation has its own:
`KernelContext`. What numba works out from the start at each place is remembered, or left: `nothing_twice`.
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

from twc_env.kernel_library import PartLibrary

_SIZES: dict[Any, int] = {}
"""Bytes that a value of an LLVM type takes; numba has LLVM read a text for each."""
_OPERATORS = {getattr(operator, name) for name in operator.__all__ if name != "contains"} | {abs, bool}
_OPERANDS = (types.Number, types.Boolean, types.Array)
_SIGNATURES: dict[Any, Any] = {}
"""By operator and types of what it is given."""


class KernelContext(CPUContext):
    """Numba's, for one compilation."""

    @classmethod
    def take(cls, context: CPUContext) -> None:
        """Make numba's context of a compilation one of these."""
        context.__class__ = cls
        context.__dict__.pop("nrt", None)

    @cached_property
    def nrt(self) -> NRTContext:
        """Counts who holds an array."""
        return _References(self, self.enable_nrt)

    def load_additional_registries(self) -> None:
        """Nothing: numba has done so at the start of the compilation."""

    def get_abi_sizeof(self, ty: Any) -> int:
        """Bytes of a value."""
        if ty not in _SIZES:
            _SIZES[ty] = super().get_abi_sizeof(ty)
        return _SIZES[ty]

    def _compile_subroutine_no_cache(self, builder, impl, sig, locals=None, flags=None):
        """Compile one of numba's own functions that lowering asks for, as a part."""
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
    """Numba's; of an array it takes apart what is counted, not shape and strides as well."""

    def get_meminfos(self, builder, ty, val):
        """Types and pointers of all that is counted in a value."""
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
    """In here numba tries the meanings of an operator once for the same types, looks at which variables live where only
    when it frees them, and paints no errors.
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
