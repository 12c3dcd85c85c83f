"""The first start on a machine: say what takes so long, and have a second process compile the engine's kernels.

Kernels stand on disk once they are compiled, for all processes. So while this one compiles those of the world and of
the observations, a helper runs the engine on made-up frames (`twc_env.slam.warm_up`); then both halves are there.
"""

from __future__ import annotations

import gc
import logging
import multiprocessing
import os
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from numba.core import event

from twc_env.threads import THREADS
from twc_env.world.floor_cells import rasterise

_LOG = logging.getLogger("twc_env")
FIRST_MODULE = rasterise.__module__
"""Its kernels come first in every start: where they must be compiled, so must all."""
_HELP_MAX_S = 120.0


class _FirstCompilation(event.Listener):
    """Told of every kernel that is really compiled, not read from disk; speaks up at the first of this package.

    Numba makes so many small objects which all live until it is done that looking for garbage among them takes an
    eighth of the time; so nobody looks while it is at work.
    """

    def __init__(self, call_help: Callable[[], None] = lambda: None) -> None:
        self._is_said, self._call_help = False, call_help
        self._depth, self._collects = 0, False

    def on_start(self, event: Any) -> None:
        """A compilation begins, maybe inside another."""
        if self._depth == 0:
            self._collects = gc.isenabled()
            gc.disable()
        self._depth += 1
        module = event.data["dispatcher"].py_func.__module__ or ""  # None in functions that numba makes up
        if self._is_said or not module.startswith("twc_env."):
            return
        self._is_said = True
        _LOG.warning(
            "compiling kernels for first use, some 10 to 30 s in all; later starts read them from disk "
            "(beside the sources, or in NUMBA_CACHE_DIR)"
        )
        if module == FIRST_MODULE:
            self._call_help()

    def on_end(self, event: Any) -> None:
        """A compilation ended, be it with an error."""
        self._depth -= 1
        if self._depth == 0 and self._collects:
            gc.enable()


class Helper:
    """The process that compiles the engine's kernels, where there is one."""

    def __init__(self) -> None:
        self.is_wanted = False
        """An environment with an engine will need those kernels."""
        self._process: subprocess.Popen | None = None

    def start(self) -> None:
        """Start it, if it is wanted, there is a second core, and this is no worker process among others."""
        if not self.is_wanted or core_count() < 2 or multiprocessing.parent_process() is not None:
            return
        package = str(Path(__file__).parents[2])
        path = os.pathsep.join([package, *filter(None, [os.environ.get("PYTHONPATH")])])
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "twc_env.slam.warm_up"],
                env={**os.environ, **dict.fromkeys(THREADS, "1"), "PYTHONPATH": path},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
        except OSError:  # then this process compiles everything
            self._process = None

    def join(self, compile_meanwhile: Callable[[], object]) -> None:
        """Where it is at work: do one's own share, then wait for it."""
        process, self._process = self._process, None
        if process is None:
            return
        compile_meanwhile()
        try:
            process.wait(_HELP_MAX_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


HELPER = Helper()


def core_count() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def announce_compilation() -> None:
    """From now on, log one message when the first kernel of this process has to be compiled."""
    event.register("numba:compile", _FirstCompilation(HELPER.start))
