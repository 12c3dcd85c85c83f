"""Standard output of `python -u` and PYTHONUNBUFFERED: what the system takes in part only is written to the end.

Without a buffer, Python writes a text by one call and does not look at how much of it was written: on a full disk, the
rest is missing without an error.
"""

from __future__ import annotations

import contextlib
import io
import sys
from collections.abc import Iterator
from typing import Any, cast


class _WholeWrites(io.RawIOBase):
    """Writes all that it gets to a raw file, or raises OSError; closing it leaves that file open."""

    def __init__(self, raw: io.RawIOBase):
        self._raw = raw

    def writable(self) -> bool:
        return True

    def fileno(self) -> int:
        return self._raw.fileno()

    def isatty(self) -> bool:
        return not self._raw.closed and self._raw.isatty()  # some library may ask at the very end

    def write(self, data: Any) -> int:
        """The number of bytes, which is that of the data."""
        rest = memoryview(data).cast("B")
        total = len(rest)
        while len(rest):
            written = self._raw.write(rest)
            if written is None:
                raise BlockingIOError("the output takes nothing at present")
            rest = rest[written:]
        return total


@contextlib.contextmanager
def whole_output() -> Iterator[None]:
    """While it lasts, standard output is written whole or an OSError tells of it."""
    usual = sys.stdout
    raw = getattr(usual, "buffer", None)
    if not isinstance(usual, io.TextIOWrapper) or not isinstance(raw, io.RawIOBase):
        yield
        return
    whole = io.TextIOWrapper(
        cast(Any, _WholeWrites(raw)),
        encoding=usual.encoding,
        errors=usual.errors,
        write_through=True,
    )
    sys.stdout = whole
    try:
        yield
    finally:
        if sys.stdout is whole:
            sys.stdout = usual
