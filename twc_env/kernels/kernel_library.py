"""Code libraries of kernels: how LLVM optimises them."""

from __future__ import annotations

from numba.core.codegen import JITCodeLibrary

_TIDYING = 1
"""LLVM's optimisation level for single functions; a whole kernel is optimised again together with its parts."""


class KernelLibrary(JITCodeLibrary):
    """Code of a kernel that Python calls."""

    def _optimize_functions(self, ll_module) -> None:
        ll_module.data_layout = self._codegen._data_layout
        passes, builder = self._codegen._function_pass_manager(opt=_TIDYING)
        for function in ll_module.functions:
            if not function.is_declaration:
                passes.run(function, builder)


class PartLibrary(KernelLibrary):
    """Code of a part. It is linked into its callers, and optimised and turned into machine code only there."""

    def _optimize_final_module(self) -> None:
        passes, builder = self._codegen._module_pass_manager(
            loop_vectorize=False, slp_vectorize=False, opt=0, cost="cheap"
        )
        passes.run(self._final_module, builder)

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True
