"""Text files, plain or compressed."""

from __future__ import annotations

import gzip
import lzma
import zlib
from pathlib import Path
from typing import BinaryIO

from twc_env.errors import DataError
from twc_env.records.whole_file import file_path

TEXT_BYTES_MAX = 250_000_000
"""Maximum size of a text, unpacked: a packed file of a few megabytes can hold any number of equal bytes."""
_PACKED = {".gz": (b"\x1f\x8b",), ".xz": (b"\xfd7zXZ\x00",)}
"""First bytes of packed files, by their suffix."""
_UNREADABLE = (OSError, EOFError, zlib.error, lzma.LZMAError)


def _unpacked(suffix: str, packed: BinaryIO) -> BinaryIO | gzip.GzipFile | lzma.LZMAFile:
    if suffix == ".gz":
        return gzip.GzipFile(fileobj=packed)
    return lzma.LZMAFile(packed) if suffix == ".xz" else packed


def first_bytes(path: str | Path, count: int) -> tuple[bytes, bool]:
    """Up to `count` bytes of a file, and whether they were unpacked: those of a gzip (.gz) or xz (.xz) file are.
    DataError if it cannot be read."""
    path = file_path(path)
    try:
        with path.open("rb") as packed:
            head = packed.read(count)
            if not head.startswith(_PACKED.get(path.suffix, ())):
                return head, False
            packed.seek(0)
            with _unpacked(path.suffix, packed) as file:
                return file.read(count), True
    except _UNREADABLE as error:
        raise _refusal(path, error) from error


def read_text(path: str | Path, errors: str = "strict") -> str:
    """The text of a plain, gzip (.gz) or xz (.xz) file, without a byte order mark; DataError if it cannot be read.

    errors: "replace" also accepts invalid UTF-8, for formats where it occurs in comments only.
    """
    path = file_path(path)
    try:
        with path.open("rb") as packed, _unpacked(path.suffix, packed) as file:
            raw = file.read(TEXT_BYTES_MAX + 1)
        if len(raw) > TEXT_BYTES_MAX:
            raise DataError(f"{path} holds more than {TEXT_BYTES_MAX // 10**6} MB of text; cut it into parts")
        return raw.decode(text_encoding(raw), errors)
    except UnicodeDecodeError as error:
        raise DataError(f"{path} is not UTF-8 text: {error}; save it as UTF-8") from error
    except _UNREADABLE as error:
        raise _refusal(path, error) from error


def text_encoding(raw: bytes) -> str:
    """The encoding of a text by its first bytes: UTF-8, but for the "Unicode text" of spreadsheets."""
    return "utf-16" if raw[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"


def _refusal(path: Path, error: Exception) -> DataError:
    reason = getattr(error, "strerror", None) or error
    return DataError(f"cannot read {path}: {reason}; check the path or fetch the file again")
