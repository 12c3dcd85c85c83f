"""Files that are read: regular ones only, and packed ones up to a share of their own size.

A path may come from a stranger's settings: a device has no end, and a pipe waits for a writer that never comes.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import Any, BinaryIO

from twc_env.errors import DataError
from twc_env.records.whole_file import file_path

PACKED_BYTES_FREE = 4_000_000
"""A packed text of this size, unpacked, may be packed as tightly as it likes."""
PACKED_RATIO_MAX = 64
"""Larger ones may be so many times the size of their file: logs are 4 to 13 times, tables of fingerprints up to 56
times, a repeated piece a thousand times."""
_KINDS = {
    stat.S_ISCHR: "a device",
    stat.S_ISBLK: "a device",
    stat.S_ISFIFO: "a pipe",
    stat.S_ISSOCK: "a socket",
}


def input_path(name: Any) -> Path:
    """The path of a file or folder that is to be read, or of none. Raises DataError for a device, pipe or socket."""
    path = file_path(name)
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):
        return path  # whoever opens it says why it cannot be
    if kind := next((kind for is_kind, kind in _KINDS.items() if is_kind(mode)), None):
        raise DataError(f"{path} is {kind}, which may have no end; copy its content to a file and name that")
    return path


def unpacked_bytes_max(packed: BinaryIO, limit: int) -> int:
    """Bytes that an open packed file of text may have, unpacked, where plain ones have at most `limit`."""
    return min(limit, max(PACKED_BYTES_FREE, PACKED_RATIO_MAX * os.fstat(packed.fileno()).st_size))
