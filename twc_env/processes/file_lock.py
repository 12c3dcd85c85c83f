"""A lock file that one process holds at a time."""

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
    """A lock at a path in an existing folder. It is released when the process that holds it dies."""

    def __init__(self, path: Path):
        self._path = path
        self._descriptor: int | None = None

    def take(self) -> bool | None:
        """Whether this process holds the lock now; None if the system does not support locks."""
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
            os.close(descriptor)  # its holder has deleted the file in between: try again with a new one
        return None

    def await_it(self, patience_s: float) -> bool | None:
        """Wait for the lock at most `patience_s`; the last result of `take`."""
        end = time.monotonic() + patience_s
        while (is_taken := self.take()) is False and time.monotonic() < end:
            time.sleep(_LOOK_AGAIN_S)
        return is_taken

    @contextlib.contextmanager
    def held(self, patience_s: float) -> Iterator[bool | None]:
        """`await_it`; yields its result, and releases the lock."""
        try:
            yield self.await_it(patience_s)
        finally:
            self.release()

    def release(self) -> None:
        """Release the lock, if this process holds it."""
        descriptor, self._descriptor = self._descriptor, None
        if descriptor is not None:
            with contextlib.suppress(OSError):
                self._path.unlink()
            os.close(descriptor)
