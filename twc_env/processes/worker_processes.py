"""Run independent parts of a computation in worker processes; an interruption ends all of them silently."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from twc_env.errors import DataError
from twc_env.processes.threads import single_threaded


def in_processes(work: Callable[[Any], Any], parts: Sequence, count: int) -> Iterator[tuple[int, Any]]:
    """Yield (k, work(parts[k])) as each part is done, by `count` spawned processes with one thread each.

    `work` and the parts must be picklable. Leaving the loop, also by Ctrl-C, an error or the death of this process,
    ends the worker processes. Raises DataError if one of them died. With a count of 1 or less no process is started.
    """
    if count <= 1:
        yield from enumerate(map(work, parts))
        return
    before = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), initializer=end_with_parent)
    try:
        with single_threaded(), deaf_to_interrupts():
            waiting = {pool.submit(work, part): k for k, part in enumerate(parts)}
        for done in as_completed(waiting):
            yield waiting[done], done.result()
        pool.shutdown()
    except BaseException as error:
        pool.shutdown(wait=False, cancel_futures=True)
        for process in set(multiprocessing.active_children()) - before:
            process.terminate()
        if isinstance(error, BrokenProcessPool):
            raise DataError("a worker process has died (out of memory or killed): run the same again") from None
        raise


def end_with_parent() -> None:
    """End this process when its parent process dies, which sends it no signal."""
    parent = multiprocessing.parent_process()

    def wait() -> None:
        if parent is not None:
            parent.join()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


@contextlib.contextmanager
def deaf_to_interrupts() -> Iterator[None]:
    """Processes started in this block ignore Ctrl-C, which a terminal sends to all; their parent process handles it."""
    if threading.current_thread() is not threading.main_thread():  # only that thread can set signal handlers
        yield
        return
    held = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, held)
