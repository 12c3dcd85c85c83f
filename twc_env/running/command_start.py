"""Ctrl-C and SIGTERM: one line instead of a traceback during imports, then a chance to save what a command has."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from types import FrameType

_COMMANDS = ("twc_env.__main__",)
_SCRIPTS = ("twc-env", "twc-env.exe", "twc-env-script.py")
"""Names of the file that pip writes for our command, on all systems."""
_TWICE_S = 0.2
"""A second Ctrl-C that comes sooner is the first one, sent twice (GNU timeout signals a process and its group)."""
_received: list[tuple[int, float]] = []
"""The signal that has interrupted the present command, and when."""


def end_when_interrupted() -> None:
    """Until `begin_work`, Ctrl-C ends our commands at once; other programs get a KeyboardInterrupt."""
    if threading.current_thread() is not threading.main_thread():  # only that thread can set signal handlers
        return
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _end)


def begin_work() -> None:
    """From now on Ctrl-C and SIGTERM raise KeyboardInterrupt, so that a command can save what it has and clean up; a
    second Ctrl-C ends the process at once. Until `end_work`, and unless the caller handles these signals."""
    _received.clear()
    if threading.current_thread() is not threading.main_thread():
        return
    if signal.getsignal(signal.SIGINT) in (_end, signal.default_int_handler):
        signal.signal(signal.SIGINT, _interrupt)
    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        signal.signal(signal.SIGTERM, _interrupt)


def end_work() -> None:
    """Handle signals as before `begin_work`."""
    for number, usual in ((signal.SIGINT, signal.default_int_handler), (signal.SIGTERM, signal.SIG_DFL)):
        if signal.getsignal(number) is _interrupt:
            signal.signal(number, usual)


def interrupted_status() -> int:
    """Exit status of a command that was interrupted: 143 by SIGTERM, 130 by Ctrl-C."""
    return 128 + (_received[0][0] if _received else signal.SIGINT)


def is_interruption(error: BaseException) -> bool:
    """Whether an error is a signal's KeyboardInterrupt, which compiled code may turn into a SystemError."""
    return isinstance(error, KeyboardInterrupt) or (isinstance(error, SystemError) and bool(_received))


def is_loading() -> bool:
    """Whether `python -m` is starting a package, or one of our commands runs in this process (not in its parent)."""
    name = getattr(getattr(sys.modules.get("__main__"), "__spec__", None), "name", None)
    if sys.argv[:1] == ["-m"] or name in _COMMANDS:
        return True
    processes = sys.modules.get("multiprocessing.process")
    is_worker = processes is not None and processes.parent_process() is not None
    return not is_worker and os.path.basename(sys.argv[0] if sys.argv else "") in _SCRIPTS


def _interrupt(number: int, _frame: FrameType | None) -> None:
    if not _received:
        _received.append((number, time.monotonic()))
        raise KeyboardInterrupt
    if number == signal.SIGINT and time.monotonic() - _received[0][1] >= _TWICE_S:
        os.write(2, b"\ninterrupted again: ended at once\n")
        os._exit(128 + number)


def _end(number: int, frame: FrameType | None) -> None:
    if not is_loading():
        signal.default_int_handler(number, frame)
    os.write(2, b"interrupted\n")
    os._exit(130)
