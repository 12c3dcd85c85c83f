"""Compiled loops over arrays: `@kernel` and `@borrowing_kernel`."""

from twc_env.kernels.compiled import BindsAnew, Lent, borrowing_kernel, bound, kernel, parts_of, rebound

__all__ = ["BindsAnew", "Lent", "borrowing_kernel", "bound", "kernel", "parts_of", "rebound"]
