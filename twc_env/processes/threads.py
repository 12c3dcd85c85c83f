"""Limit worker processes to one thread each: matrix libraries with several threads compete for the cores."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables that the matrix libraries of numpy and scipy read when they are loaded."""


@contextlib.contextmanager
def single_threaded() -> Iterator[None]:
    """Processes spawned in this block compute with one thread each."""
    held = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        yield
    finally:
        for name, value in held.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
