"""The first start on a machine: say what takes so long, share it with a second process, and let no third repeat it.

Kernels stand on disk once they are compiled, for all processes. So while this one compiles those of the world and of
the observations, a helper runs the engine on made-up frames (`twc_env.slam.warm_up`); then both halves are there. Of
several processes that begin at once, as workers do, one compiles and the others wait until it has.
"""

from __future__ import annotations

import contextlib
import gc
import logging
import multiprocessing
import os
import subprocess
import sys
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from numba.core import event

from twc_env.threads import THREADS

if sys.platform != "win32":
    import fcntl

_LOG = logging.getLogger("twc_env")
_HELP_MAX_S, _LOOK_AGAIN_S = 120.0, 0.2


class FirstStart:
    """The first reset of this process in which kernels have to be compiled: `with` it, environments are reset."""

    def __init__(self) -> None:
        self.is_engine_wanted = False
        """An environment with an engine will need its kernels."""
        self._is_resetting = self._is_prepared = False
        self._lock: int | None = None
        self._helper: subprocess.Popen | None = None

    def __enter__(self) -> None:
        self._is_resetting = True

    def __exit__(self, *_: object) -> None:
        self._is_resetting = False
        self._unlock()

    def prepare(self, folder: str | None) -> None:
        """A kernel is about to be compiled that will stand in this folder, if in any. In a reset, the first time: wait
        until no other process is in its own first start, or, where none is, call a helper."""
        if not self._is_resetting or self._is_prepared:
            return
        self._is_prepared = True
        alone = self._try_lock(folder)
        if alone:
            self._call_helper()
        elif alone is None:  # nobody can tell: no crowd of helpers then
            if multiprocessing.parent_process() is None:
                self._call_helper()
        else:
            _LOG.warning("another process compiles them at this moment: waiting for it")
            given_up_s = time.monotonic() + _HELP_MAX_S
            while time.monotonic() < given_up_s and not self._try_lock(folder):
                time.sleep(_LOOK_AGAIN_S)
            self._unlock()  # all that waited go on at once

    def join(self, compile_meanwhile: Callable[[], object]) -> None:
        """Where a helper is at work: do one's own share, then wait for it."""
        process, self._helper = self._helper, None
        if process is None:
            return
        compile_meanwhile()
        try:
            process.wait(_HELP_MAX_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def _try_lock(self, folder: str | None) -> bool | None:
        """Whether this process is the only one; None where that cannot be known. A dead process holds no lock."""
        if sys.platform == "win32" or folder is None:
            return None
        try:
            Path(folder).mkdir(parents=True, exist_ok=True)
            self._lock = os.open(Path(folder, "first_start.lock"), os.O_CREAT | os.O_WRONLY)
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._unlock()
            return False
        except OSError:
            self._unlock()
            return None
        return True

    def _unlock(self) -> None:
        lock, self._lock = self._lock, None
        if lock is not None:
            os.close(lock)

    def _call_helper(self) -> None:
        """Start it, if there is an engine to compile and a second core."""
        if not self.is_engine_wanted or core_count() < 2:
            return
        package = str(Path(__file__).parents[2])
        path = os.pathsep.join([package, *filter(None, [os.environ.get("PYTHONPATH")])])
        with contextlib.suppress(OSError):  # then this process compiles everything
            self._helper = subprocess.Popen(
                [sys.executable, "-m", "twc_env.slam.warm_up"],
                env={**os.environ, **dict.fromkeys(THREADS, "1"), "PYTHONPATH": path},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )


FIRST_START = FirstStart()


class _Announcer(event.Listener):
    """Told of every kernel that is really compiled, not read from disk; speaks up at the first of this package.

    Numba makes many small objects of which nearly all live until it is done: nobody looks for garbage among them while
    it is at work.
    """

    def __init__(self, prepare: Callable[[str | None], None] = lambda _folder: None) -> None:
        self._is_said, self._prepare = False, prepare
        self._depth, self._collects = 0, False

    def on_start(self, event: Any) -> None:
        """A compilation begins, maybe inside another."""
        if self._depth == 0:
            self._collects = gc.isenabled()
            gc.disable()
        self._depth += 1
        dispatcher = event.data["dispatcher"]
        module = dispatcher.py_func.__module__ or ""  # None in functions that numba makes up
        if not module.startswith("twc_env."):
            return
        if not self._is_said:
            self._is_said = True
            _LOG.warning(
                "compiling kernels for first use, some 10 to 30 s in all; later starts read them from disk "
                "(beside the sources, or in NUMBA_CACHE_DIR)"
            )
        self._prepare(dispatcher._cache.cache_path)

    def on_end(self, event: Any) -> None:
        """A compilation ended, be it with an error."""
        self._depth -= 1
        if self._depth == 0 and self._collects:
            gc.enable()


def core_count() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def announce_compilation() -> None:
    """From now on, log one message when the first kernel of this process has to be compiled."""
    event.register("numba:compile", _Announcer(FIRST_START.prepare))
