"""Files that are written whole or not at all: beside their place first, then moved there."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from twc_env.errors import DataError

_NAME_MAX = 100
"""Characters kept of the file's name."""
PART_BYTES_MAX = 255
"""Bytes of one part of a path, on all usual file systems."""


def file_path(name: Any) -> Path:
    """The path that a caller names. Raises DataError if it is no name of a file."""
    if not isinstance(name, (str, os.PathLike)) or "\x00" in str(name):
        raise DataError(f"a file is named by text or a Path, without null characters; got {name!r:.100}")
    if any(len(part.encode(errors="surrogatepass")) > PART_BYTES_MAX for part in Path(name).parts):
        raise DataError(f"a name of a file or folder has at most {PART_BYTES_MAX} bytes; got {str(name)!r:.100}")
    return Path(name)


@contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """The path to write to, which becomes `path` at the end; after an exception `path` is as before.

    Its name has the same suffix. Devices, and files in folders where none can be made, are written in place.
    """
    path = Path(path).resolve()
    if (path.exists() and not path.is_file()) or not os.access(path.parent, os.W_OK):
        yield path
        return
    beside = path.with_name(f".part-{os.getpid()}-{path.name[-_NAME_MAX:]}")
    try:
        yield beside
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> Path:
    """Write a text whole or not at all, folders included; returns the path. Raises DataError if that fails."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as beside:
            beside.write_text(text, encoding="utf-8")
    except OSError as error:
        raise DataError(f"cannot write {path}: {error.strerror}; choose another place") from error
    return path
