"""What happens while kernels are compiled: one process at a time, without garbage collection, and the user sees it.

Numba tells of both where it knows events (`compile_events`); if not, kernels are compiled without all of this.
"""

from __future__ import annotations

import gc
import logging
import sys
import threading
import time
from functools import cache
from typing import Any

from tqdm import tqdm

from twc_env.kernels.cache_folder import cache_folder, check_folders, is_empty, is_kept, write_checksums
from twc_env.kernels.compile_events import COMPILATION, LOCK, Listener, register
from twc_env.processes.file_lock import FileLock

_LOG = logging.getLogger("twc_env")
SILENT_S, WAIT_MAX_S = 5.0, 300.0
"""Wait for another process that compiles until this one says so, and the longest one; then this one compiles too."""
FIRST_STEP, EPISODE, EVERYTHING = 180, 300, 660
"""Functions compiled until the first step of the default environment, for one episode, and by `twc-env warm-up`: the
lengths of bars."""


class OneProcess(Listener):
    """Holds a lock file while this process looks for a kernel on disk and, if it is not there, compiles it.

    So of several processes that start together one compiles each kernel, and the others wait and read it. The lock ends
    with the process that holds it.
    """

    def __init__(self) -> None:
        self._threads, self._depth = threading.RLock(), 0
        self._lock: FileLock | None = None
        self._waits = True
        """Whether it waits for others: not again for one that has not ended in time."""
        self._has_said_so = False
        self.compiled_modules: set[str] = set()
        """Modules with kernels compiled since the lock was taken, whose checksums are still to be written."""

    def on_start(self, event: Any) -> None:
        """Called by numba before it takes its lock, which may be nested."""
        self._threads.acquire()
        self._depth += 1
        if self._depth == 1:
            self._lock = FileLock(cache_folder() / "compiling.lock")
            self._await(self._lock)
            check_folders()

    def _await(self, lock: FileLock) -> None:
        is_taken = lock.await_it(SILENT_S if self._waits else 0.0)
        if is_taken is False and self._waits:
            if not self._has_said_so:  # it may wait for each kernel in turn
                _LOG.warning("waiting for another process that compiles kernels, %.0f s at most each", WAIT_MAX_S)
                self._has_said_so = True
            self._waits = lock.await_it(WAIT_MAX_S - SILENT_S) is not False
            if not self._waits:
                _LOG.warning("it has not ended (is it stopped?): this process compiles for itself what it needs")

    def on_end(self, event: Any) -> None:
        """Called by numba after it has released its lock."""
        self._depth -= 1
        if self._depth == 0 and self._lock is not None:
            self.write_checksums()
            self._lock.release()
        self._threads.release()

    def write_checksums(self) -> None:
        """Of all modules that have new files. A kill before it costs the kernels of these modules."""
        while self.compiled_modules:
            write_checksums(self.compiled_modules.pop())


class CompiledModules(Listener):
    """Tells `OneProcess` the modules of what is compiled, and has it write checksums between two kernels."""

    def __init__(self, process: OneProcess) -> None:
        self._process = process

    def on_start(self, event: Any) -> None:
        """Called by numba at the start of a compilation: what was compiled before it is on disk by now."""
        self._process.write_checksums()

    def on_end(self, event: Any) -> None:
        """Called by numba at the end of a compilation, before it writes the result to disk."""
        self._process.compiled_modules.add(event.data["dispatcher"].py_func.__module__ or "")


class Announcer(Listener):
    """Says at the first compilation of a kernel of this package that it takes a while, and shows a bar on a terminal.

    Kernels that are read from disk are no compilation. Garbage collection is off meanwhile: numba creates many small
    objects, nearly all of which survive it.
    """

    def __init__(self) -> None:
        self.total = FIRST_STEP
        """Expected number of compilations."""
        self.count = 0
        """Functions compiled so far."""
        self._is_said, self._depth, self._collects = False, 0, False
        self._begin_s = time.time()
        self._bar: tqdm | None = None

    def on_start(self, event: Any) -> None:
        """Called by numba at the start of a compilation, which may be nested in another."""
        if self._depth == 0:
            self._collects = gc.isenabled()
            gc.disable()
        self._depth += 1
        module = event.data["dispatcher"].py_func.__module__ or ""  # None for functions that numba generates
        if not self._is_said and module.startswith("twc_env."):
            self._is_said = True
            while_ = "some minutes" if self.total >= EVERYTHING else "half a minute or more"
            what = f"compiling kernels for first use, {while_}" if is_empty() else "compiling further kernels"
            _LOG.warning("%s; %s", what, _of_later_starts())
            self._begin_s = time.time()
        if self._is_said and self._bar is None and sys.stderr.isatty():
            self._bar = tqdm(total=self.total, initial=self.count, desc="compiling", unit="kernel", leave=False)
            self._bar.start_t = self._begin_s

    def on_end(self, event: Any) -> None:
        """Called by numba at the end of a compilation, also after an error."""
        self._depth -= 1
        self.count += 1
        if self._bar is not None:
            self._bar.total = self.total = max(self.total, self.count)
            self._bar.update()
        if self._depth > 0:
            return
        if self._bar is not None:  # the next compilation may be long in coming: leave the line to others
            self._bar.close()
            self._bar = None
        if self._collects:
            if gc.get_freeze_count() == 0:
                gc.freeze()
                gc.unfreeze()  # moves all objects to the oldest generation, which is not collected at once
            gc.enable()


def _of_later_starts() -> str:
    if is_kept():
        return f"later starts read them from {cache_folder()}"
    return "later starts too, as they can be kept nowhere: name a folder that can be written in NUMBA_CACHE_DIR"


@cache
def announcer() -> Announcer:
    """From now on the first compilation of this process is announced."""
    found = Announcer()
    register(COMPILATION, found)
    return found


@cache
def one_process_compiles() -> None:
    """From now on this process and others compile in turn."""
    process = OneProcess()
    register(LOCK, process)
    register(COMPILATION, CompiledModules(process))
