"""One thread for each process that is started: matrix libraries that share cores wait for each other more than work."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""What the libraries below numpy and scipy read when they are loaded."""


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
