"""The first start on a machine: say what takes so long, and let a second process share it.

Kernels stand on disk once they are compiled, for all processes, and no two processes compile the same one at once
(`twc_env.kernel_compiler`). So while this one compiles those of the world and of the observations, a helper begins with
the engine's (`twc_env.exploration.warm_up`); whoever is done takes what the other has not begun. The helper then goes
on with kernels that only later steps need. It ends with the process that called it.
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

from twc_env.cell_rows import look_up
from twc_env.file_lock import FileLock
from twc_env.kernels import NUMBA_MAX, NUMBA_MIN, is_numba_known
from twc_env.threads import THREADS

_LOG = logging.getLogger("twc_env")


class FirstStart:
    """The helper of a process that has to compile kernels."""

    def __init__(self) -> None:
        self.is_engine_wanted = False
        """An environment with an engine will need its kernels."""
        self.may_call = True
        """Whether a helper may be called; not by a helper."""
        self._helper: subprocess.Popen | None = None
        self._owner = 0

    @property
    def is_helped(self) -> bool:
        """Whether a helper of this process is at work."""
        return self._helper is not None and self._owner == os.getpid() and self._helper.poll() is None

    def prepare(self) -> None:
        """A kernel is about to be compiled: call a helper, the first time, where there is an engine to compile, a
        second core and a folder to share, and no other process has one."""
        if not (self.may_call and self.is_engine_wanted):
            return
        self.may_call = False
        if core_count() > 1 and helpers_lock() is not None and not is_another_helper_at_work():
            self._call_helper()

    def _call_helper(self) -> None:
        package = str(Path(__file__).parents[2])
        path = os.pathsep.join([package, *filter(None, [os.environ.get("PYTHONPATH")])])
        with contextlib.suppress(OSError):  # then this process compiles everything
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
        """Wait until the helper is done: all kernels are there then but those for what happens rarely."""
        if self.is_helped:
            assert self._helper is not None
            self._helper.wait()

    def dismiss(self) -> None:
        """End the helper. Files are only ever put in place whole: what it was compiling is compiled another time."""
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
    """What a helper holds as long as it is at work; None where kernels stand in no folder."""
    folder = look_up._cache.cache_path
    return None if folder is None else FileLock(Path(folder, "helper.lock"))


def is_another_helper_at_work() -> bool:
    """Whether there is one for the same files. Where nobody can tell, workers hold that there is: no crowd then."""
    lock = helpers_lock()
    if lock is None:
        return False
    is_free = lock.take()
    if is_free is None:
        return multiprocessing.parent_process() is not None
    lock.release()
    return not is_free


class _Announcer(event.Listener):
    """Told of every kernel that is really compiled, not read from disk; speaks up at the first of this package.

    Numba makes many small objects of which nearly all live until it is done: nobody looks for garbage among them while
    it is at work.
    """

    def __init__(self, prepare: Callable[[], None] = lambda: None) -> None:
        self._is_said, self._prepare = False, prepare
        self._depth, self._collects = 0, False

    def on_start(self, event: Any) -> None:
        """A compilation begins, maybe inside another."""
        if self._depth == 0:
            self._collects = gc.isenabled()
            gc.disable()
        self._depth += 1
        module = event.data["dispatcher"].py_func.__module__ or ""  # None in functions that numba makes up
        if not module.startswith("twc_env."):
            return
        if not self._is_said:
            self._is_said = True
            _LOG.warning("compiling kernels for first use, some 10 to 30 s in all; %s", _what_of_later_starts())
        self._prepare()

    def on_end(self, event: Any) -> None:
        """A compilation ended, be it with an error."""
        self._depth -= 1
        if self._depth == 0 and self._collects:
            if gc.get_freeze_count() == 0:
                gc.freeze()
                gc.unfreeze()  # all that is there counts as old now: it need not be looked through at once
            gc.enable()


def core_count() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def announce_compilation() -> None:
    """From now on, log one message when the first kernel of this process has to be compiled."""
    event.register("numba:compile", _Announcer(FIRST_START.prepare))
