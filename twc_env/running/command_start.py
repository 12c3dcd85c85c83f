"""Ctrl-C and SIGTERM: one line instead of a traceback during imports, then a chance to save what a command has."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from types import FrameType
from typing import Any

_COMMANDS = ("twc_env.__main__",)
_SCRIPTS = ("twc-env", "twc-env.exe", "twc-env-script.py")
"""Names of the file that pip writes for our command, on all systems."""
_TWICE_S = 0.2
"""A second Ctrl-C that comes sooner is the first one, sent twice (GNU timeout signals a process and its group)."""
_AGAIN_S = 0.02
"""After so long a signal is raised again whose exception was lost, until it is received."""
_received: list[tuple[int, float]] = []
"""The signal that has interrupted the present command, and when."""
_lost: list[int] = []
"""The signal whose exception was dropped, until it has come once more."""
_ended = threading.Event()
"""Set when the present command has ended."""
_usual_hooks: list[Callable[[Any], object]] = []
"""What told of dropped exceptions before `begin_work`."""


def end_when_interrupted() -> None:
    """Until `begin_work`, Ctrl-C ends our commands at once; other programs get a KeyboardInterrupt."""
    if threading.current_thread() is not threading.main_thread():  # only that thread can set signal handlers
        return
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _end)


def begin_work() -> None:
    """From now on Ctrl-C and SIGTERM raise KeyboardInterrupt, so that a command can save what it has and clean up; a
    second Ctrl-C ends the process at once. Until `end_work`, and unless the caller handles these signals.

    Where Python drops exceptions (finalisers, callbacks from C, such as LLVM's), the signal comes once more."""
    global _ended
    _received.clear()
    _lost.clear()
    _ended = threading.Event()  # threads of an earlier command keep theirs
    if threading.current_thread() is not threading.main_thread():
        return
    if sys.unraisablehook is not _raise_again:
        _usual_hooks.append(sys.unraisablehook)
        sys.unraisablehook = _raise_again
    if signal.getsignal(signal.SIGINT) in (_end, signal.default_int_handler):
        signal.signal(signal.SIGINT, _interrupt)
    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        signal.signal(signal.SIGTERM, _interrupt)


def no_more_signals() -> None:
    """The command has ended by a signal: one that was to come once more does not."""
    _ended.set()


def end_work() -> None:
    """Handle signals as before `begin_work`; one that was to come once more does not."""
    _ended.set()
    if sys.unraisablehook is _raise_again:
        sys.unraisablehook = _usual_hooks.pop()
    for number, usual in ((signal.SIGINT, signal.default_int_handler), (signal.SIGTERM, signal.SIG_DFL)):
        if signal.getsignal(number) is _interrupt:
            signal.signal(number, usual)


def interrupted_status() -> int:
    """Exit status of a command that was interrupted: 143 by SIGTERM, 130 by Ctrl-C."""
    return 128 + (_received[0][0] if _received else _lost[0] if _lost else signal.SIGINT)


def is_interruption(error: BaseException) -> bool:
    """Whether an error is a signal's KeyboardInterrupt, which compiled code may turn into a SystemError, or what came
    of its loss: a compiler that was interrupted in a callback has no result."""
    return isinstance(error, KeyboardInterrupt) or (isinstance(error, SystemError) and bool(_received)) or bool(_lost)


class Interruption:
    """A block that a signal may end early, so that what there is can be saved; other errors leave it as usual."""

    came = False
    """Whether it was ended."""

    def __enter__(self) -> Interruption:
        return self

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> bool:
        self.came = error is not None and is_interruption(error)
        return self.came


def is_loading() -> bool:
    """Whether `python -m` is starting a package, or one of our commands runs in this process (not in its parent)."""
    name = getattr(getattr(sys.modules.get("__main__"), "__spec__", None), "name", None)
    if sys.argv[:1] == ["-m"] or name in _COMMANDS:
        return True
    processes = sys.modules.get("multiprocessing.process")
    is_worker = processes is not None and processes.parent_process() is not None
    return not is_worker and os.path.basename(sys.argv[0] if sys.argv else "") in _SCRIPTS


def _interrupt(number: int, frame: FrameType | None) -> None:
    if not _received:
        if _is_told_of_loss(frame) or (_lost and _ended.is_set()):
            return
        _received.append((number, time.monotonic()))
        _lost.clear()
        raise KeyboardInterrupt
    if number == signal.SIGINT and time.monotonic() - _received[0][1] >= _TWICE_S:
        os.write(2, b"\ninterrupted again: ended at once\n")
        os._exit(128 + number)


def _is_told_of_loss(frame: FrameType | None) -> bool:
    """Whether `_raise_again` is running, where an exception would be lost too; it makes the signal come again."""
    while frame is not None and frame.f_code is not _raise_again.__code__:
        frame = frame.f_back
    return frame is not None


def _raise_again(lost: Any) -> None:
    if not _received or not isinstance(lost.exc_value, KeyboardInterrupt):
        _usual_hooks[-1](lost)
        return
    number, _ = _received.pop()
    _lost.append(number)
    threading.Thread(target=_signal_again, args=(number, _ended), daemon=True).start()


def _signal_again(number: int, ended: threading.Event) -> None:
    """Signal the main thread, so that what it waits for is interrupted too, until it has received a signal: a wait that
    begins at that moment is not interrupted."""
    while not ended.wait(_AGAIN_S) and not _received:
        if hasattr(signal, "pthread_kill"):
            signal.pthread_kill(threading.main_thread().ident or 0, number)
        else:
            signal.raise_signal(number)


def _end(number: int, frame: FrameType | None) -> None:
    if not is_loading():
        signal.default_int_handler(number, frame)
    os.write(2, b"interrupted\n")
    os._exit(130)
