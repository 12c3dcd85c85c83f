"""Strict JSON: numpy values converted, no NaN, no key twice, and output paths checked in advance."""

from __future__ import annotations

import json
import math
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np

from twc_env.errors import DataError
from twc_env.records.whole_file import write_text

TERMINAL = Path("-")
"""Path that stands for standard output."""
LISTS_MAX = 250_000
"""Lists and tables of a JSON file; every corner of a map is one, and the largest known plans have twenty thousand."""


def table_of(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object, as the `object_pairs_hook` of `json.loads`; raises ValueError for a repeated key.

    Without it the last value would count, silently.
    """
    table: dict[str, Any] = {}
    for key, value in pairs:
        if key in table:
            raise ValueError(f"the key {key!r} stands twice in one table; keep one of its values")
        table[key] = value
    return table


def check_lists(raw: bytes | str) -> None:
    """Raise ValueError for a JSON text of so many lists and tables that reading it takes gigabytes: an empty one takes
    sixty bytes and more, and two in the text."""
    marks: Any = (b"[", b"{") if isinstance(raw, bytes) else ("[", "{")
    count = sum(map(raw.count, marks))
    if count > LISTS_MAX:
        raise ValueError(f"it holds {count} lists and tables, where {LISTS_MAX} are possible; cut it into parts")


def plain(value: Any) -> Any:
    """The value with numpy types converted to Python types, keys to text, and non-finite numbers to None."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_json(path: Path | None, values: Any) -> None:
    """Write values, folders included; nothing without a path, to the terminal for `-`.

    Raises DataError when the file cannot be written.
    """
    if path is None:
        return
    text = json.dumps(plain(values), indent=2, allow_nan=False) + "\n"
    if path == TERMINAL:
        sys.stdout.write(text)
        return
    write_text(path, text)


def check_writable(path: Path | None) -> None:
    """Raise DataError if `write_json` could not write to this path. Creates nothing."""
    if path is None or path == TERMINAL:
        return
    if path.is_dir():
        raise DataError(f"cannot write {path}: it is a folder; name a file in it")
    place = _nearest(path)
    if (place != path and not place.is_dir()) or not os.access(place, os.W_OK):
        raise DataError(f"cannot write {path}: {place} is no place to write to; choose another place")


def check_folder(folder: Path | None) -> None:
    """Raise DataError if this folder, which need not exist, could not be written to. Creates nothing."""
    if folder is None:
        return
    place = _nearest(folder)
    if not place.is_dir() or not os.access(place, os.W_OK):
        what = "cannot be written to" if place.is_dir() else "is a file"
        raise DataError(f"cannot write to the folder {folder}: {place} {what}; choose another folder")


def _nearest(path: Path) -> Path:
    """The path itself, or its nearest ancestor that exists."""
    while not os.path.lexists(path) and path != path.parent:
        path = path.parent
    return path
