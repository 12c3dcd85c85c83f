"""Ctrl-C while the modules of a command are being imported: one line instead of a traceback."""

from __future__ import annotations

import os
import signal
import sys
import threading
from types import FrameType

_COMMANDS = ("twc_env.__main__",)
_SCRIPTS = ("twc-env", "twc-env.exe", "twc-env-script.py")
"""Names of the file that pip writes for our command, on all systems."""


def end_when_interrupted() -> None:
    """Until `begin_work`, Ctrl-C ends our commands at once; other programs get a KeyboardInterrupt."""
    if threading.current_thread() is not threading.main_thread():  # only that thread can set signal handlers
        return
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _end)


def begin_work() -> None:
    """From now on Ctrl-C raises KeyboardInterrupt, so that a command can clean up."""
    if signal.getsignal(signal.SIGINT) is _end:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def is_loading() -> bool:
    """Whether `python -m` is starting a package, or one of our commands runs in this process (not in its parent)."""
    name = getattr(getattr(sys.modules.get("__main__"), "__spec__", None), "name", None)
    if sys.argv[:1] == ["-m"] or name in _COMMANDS:
        return True
    processes = sys.modules.get("multiprocessing.process")
    is_worker = processes is not None and processes.parent_process() is not None
    return not is_worker and os.path.basename(sys.argv[0] if sys.argv else "") in _SCRIPTS


def _end(number: int, frame: FrameType | None) -> None:
    if not is_loading():
        signal.default_int_handler(number, frame)
    os.write(2, b"interrupted\n")
    os._exit(130)
