"""A lock that processes hold one at a time."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

if sys.platform != "win32":
    import fcntl

_TRIES, _LOOK_AGAIN_S = 100, 0.02


class FileLock:
    """The lock of a path, in a folder that exists. A process that has died holds nothing."""

    def __init__(self, path: Path):
        self._path = path
        self._descriptor: int | None = None

    def take(self) -> bool | None:
        """Whether this process holds it now; None where the system cannot tell."""
        if sys.platform == "win32":
            return None
        if self._descriptor is not None:
            return True
        for _ in range(_TRIES):
            try:
                descriptor = os.open(self._path, os.O_CREAT | os.O_WRONLY)
            except OSError:
                return None
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                os.close(descriptor)
                return False if isinstance(error, BlockingIOError) else None
            if os.fstat(descriptor).st_nlink:
                self._descriptor = descriptor
                return True
            os.close(descriptor)  # its holder gave it up in between: who comes next makes a file of the same name
        return None

    @contextlib.contextmanager
    def held(self, patience_s: float) -> Iterator[bool | None]:
        """Wait for it so long at most; in here is what `take` gave last, and afterwards the next one may have it."""
        end = time.monotonic() + patience_s
        while (is_taken := self.take()) is False and time.monotonic() < end:
            time.sleep(_LOOK_AGAIN_S)
        try:
            yield is_taken
        finally:
            self.release()

    def release(self) -> None:
        """Let the next one have it; who does not hold it does nothing."""
        descriptor, self._descriptor = self._descriptor, None
        if descriptor is not None:
            with contextlib.suppress(OSError):
                self._path.unlink()
            os.close(descriptor)
