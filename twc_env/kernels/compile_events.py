"""What numba tells of its work while it compiles (`numba.core.event`, which it calls experimental).

A numba without this module compiles all the same: nobody is told, and nobody waits for another process.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

try:
    from numba.core import event as _events
except ImportError:
    _events = None

ARE_KNOWN = _events is not None
"""Whether this numba tells anything."""
LOCK, COMPILATION = "numba:compiler_lock", "numba:compile"
"""Taking its lock before it looks for a function on disk; the compilation of one function."""
Listener: Any = object if _events is None else _events.Listener
"""Base class of who is told: has methods `on_start(event)` and `on_end(event)`."""


def register(kind: str, listener: Any) -> None:
    """From now on tell the listener of all events of a kind."""
    if _events is not None:
        _events.register(kind, listener)


@contextlib.contextmanager
def registered(kind: str, listener: Any) -> Iterator[None]:
    """Tell the listener of all events of a kind during this block."""
    register(kind, listener)
    try:
        yield
    finally:
        if _events is not None:
            _events.unregister(kind, listener)
