"""A clock that stands still while kernels are compiled or read from disk, which happens once per installation."""

from __future__ import annotations

import time
from contextlib import ExitStack
from typing import Any

from twc_env.kernels.compile_events import LOCK, Listener, registered


class Clock(Listener):
    """Within its `with` block it stands still while numba holds its lock; if numba does not tell, it runs on."""

    def __init__(self) -> None:
        self._depth, self._begin_s, self._stood_s = 0, 0.0, 0.0
        self._listening = ExitStack()

    def __enter__(self) -> Clock:
        self._listening.enter_context(registered(LOCK, self))
        return self

    def __exit__(self, *_: object) -> None:
        self._listening.close()

    def now_s(self) -> float:
        """The time on this clock, of which only differences mean something."""
        return time.perf_counter() - self._stood_s

    def on_start(self, event: Any) -> None:
        """Called by numba before it takes its lock, which may be nested."""
        if self._depth == 0:
            self._begin_s = time.perf_counter()
        self._depth += 1

    def on_end(self, event: Any) -> None:
        """Called by numba after it has released its lock."""
        self._depth -= 1
        if self._depth == 0:
            self._stood_s += time.perf_counter() - self._begin_s
