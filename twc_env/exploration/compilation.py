"""Say once what takes so long when kernels are compiled for the first time on a machine."""

from __future__ import annotations

import logging
from functools import cache
from typing import Any

from numba.core import event

_LOG = logging.getLogger("twc_env")


class _FirstCompilation(event.Listener):
    """Told of every kernel that is really compiled, not read from disk; speaks up at the first of this package."""

    def __init__(self) -> None:
        self._is_said = False

    def on_start(self, event: Any) -> None:
        """A compilation begins."""
        function = event.data["dispatcher"].py_func
        if self._is_said or not function.__module__.startswith("twc_env."):
            return
        self._is_said = True
        _LOG.warning(
            "compiling kernels for first use, some 10 to 30 s in all; later starts read them from disk "
            "(beside the sources, or in NUMBA_CACHE_DIR)"
        )

    def on_end(self, event: Any) -> None:
        """A compilation ended."""


@cache
def announce_compilation() -> None:
    """From now on, log one message when the first kernel of this process has to be compiled."""
    event.register("numba:compile", _FirstCompilation())
