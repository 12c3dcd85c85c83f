"""Compilation at the first start on a machine: a log message, and a helper process that shares the work.

Compiled kernels are cached on disk for all processes, and no two processes compile the same kernel at once
(`twc_env.kernels.kernel_compiler`). While this process compiles the kernels of world and observations, the helper
(`twc_env.exploration.warm_up`) starts with those of the engine; each loads what the other has already compiled. The
helper then compiles kernels that only later steps need. It ends with the process that started it.
"""

from __future__ import annotations

import atexit
import contextlib
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

from twc_env.kernels.cell_rows import look_up
from twc_env.kernels.compiled import NUMBA_MAX, NUMBA_MIN, is_numba_known
from twc_env.running.file_lock import FileLock
from twc_env.running.threads import THREADS

_LOG = logging.getLogger("twc_env")


class FirstStart:
    """Starts and ends the helper process of a process that has to compile kernels."""

    def __init__(self) -> None:
        self.is_engine_wanted = False
        """Whether an environment with an engine was made, so that the engine's kernels are needed."""
        self.may_call = True
        """Whether a helper may be started: at most once per process, and never by a helper."""
        self._helper: subprocess.Popen | None = None
        self._owner = 0

    @property
    def is_helped(self) -> bool:
        """Whether a helper of this process is running."""
        return self._helper is not None and self._owner == os.getpid() and self._helper.poll() is None

    def prepare(self) -> None:
        """Called before a kernel is compiled: the first time, start a helper if an engine is needed, there is a second
        core and a writable cache folder, and no other helper is running for it."""
        if not (self.may_call and self.is_engine_wanted):
            return
        self.may_call = False
        if core_count() > 1 and helpers_lock() is not None and not is_another_helper_at_work():
            self._call_helper()

    def _call_helper(self) -> None:
        package = str(Path(__file__).parents[2])
        path = os.pathsep.join([package, *filter(None, [os.environ.get("PYTHONPATH")])])
        with contextlib.suppress(OSError):  # without a helper this process compiles everything
            self._helper = subprocess.Popen(
                [sys.executable, "-m", "twc_env.exploration.warm_up"],
                env={**os.environ, **dict.fromkeys(THREADS, "1"), "PYTHONPATH": path},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            self._owner = os.getpid()
            atexit.register(self.dismiss)

    def await_helper(self) -> None:
        """Wait for the end of the helper; then all kernels are on disk except some of rare events."""
        if self.is_helped:
            assert self._helper is not None
            self._helper.wait()

    def dismiss(self) -> None:
        """Kill the helper. Cache files are written atomically, so an unfinished kernel is just compiled again later."""
        if self.is_helped:
            assert self._helper is not None
            self._helper.kill()
            self._helper.wait()


FIRST_START = FirstStart()


def _what_of_later_starts() -> str:
    if look_up._cache.cache_path is not None:
        return "later starts read them from disk (beside the sources, or in NUMBA_CACHE_DIR)"
    if not is_numba_known():
        least, most = (".".join(map(str, version)) for version in (NUMBA_MIN, NUMBA_MAX))
        return f"later starts too, with this numba ({least} to {most} keep them)"
    return "later starts too, as they can be kept nowhere: name a folder in NUMBA_CACHE_DIR"


def helpers_lock() -> FileLock | None:
    """The lock that a helper holds while it runs; None if there is no writable cache folder."""
    folder = look_up._cache.cache_path
    return None if folder is None else FileLock(Path(folder, "helper.lock"))


def is_another_helper_at_work() -> bool:
    """Whether a helper is running for the same cache folder.

    If locks are not supported, True in worker processes of `multiprocessing`, so that each does not start its own.
    """
    lock = helpers_lock()
    if lock is None:
        return False
    is_free = lock.take()
    if is_free is None:
        return multiprocessing.parent_process() is not None
    lock.release()
    return not is_free


class _Announcer(event.Listener):
    """Logs a message at the first compilation of a kernel of this package; not called for kernels loaded from disk.

    Garbage collection is off during a compilation: numba creates many small objects, nearly all of which survive it.
    """

    def __init__(self, prepare: Callable[[], None] = lambda: None) -> None:
        self._is_said, self._prepare = False, prepare
        self._depth, self._collects = 0, False

    def on_start(self, event: Any) -> None:
        """Called by numba at the start of a compilation, which may be nested in another."""
        if self._depth == 0:
            self._collects = gc.isenabled()
            gc.disable()
        self._depth += 1
        module = event.data["dispatcher"].py_func.__module__ or ""  # None for functions that numba generates
        if not module.startswith("twc_env."):
            return
        if not self._is_said:
            self._is_said = True
            _LOG.warning("compiling kernels for first use, some 10 to 30 s in all; %s", _what_of_later_starts())
        self._prepare()

    def on_end(self, event: Any) -> None:
        """Called by numba at the end of a compilation, also after an error."""
        self._depth -= 1
        if self._depth == 0 and self._collects:
            if gc.get_freeze_count() == 0:
                gc.freeze()
                gc.unfreeze()  # moves all objects to the oldest generation, which is not collected at once
            gc.enable()


def core_count() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def announce_compilation() -> None:
    """From now on, log a message and start the helper when the first kernel of this process has to be compiled."""
    event.register("numba:compile", _Announcer(FIRST_START.prepare))
