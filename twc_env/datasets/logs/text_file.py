"""Text files, plain or compressed."""

from __future__ import annotations

import gzip
import io
import lzma
import os
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from twc_env.errors import DataError
from twc_env.records.input_file import input_path, unpacked_bytes_max

TEXT_BYTES_MAX = 250_000_000
"""Maximum size of a text, unpacked; packed ones have less (`records.input_file`)."""
_READ_BYTES_MIN = 1_000_000
"""Files of the system tell no size."""
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
    path = input_path(path)
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
    raw = _read(path)
    try:
        return raw.decode(text_encoding(raw), errors)
    except UnicodeDecodeError as error:
        raise _no_text(path, error) from error


class TextLines:
    """The lines of such a file, without their ends, decoded one at a time: as a list they would take ten times the
    room. Raises the same errors, those of the encoding where it is wrong."""

    def __init__(self, path: str | Path, errors: str = "strict"):
        self._path, self._errors = path, errors
        self._raw = _read(path)

    def __iter__(self) -> Iterator[str]:
        try:
            for line in io.TextIOWrapper(io.BytesIO(self._raw), text_encoding(self._raw), self._errors):
                yield line.rstrip("\n")
        except UnicodeDecodeError as error:
            raise _no_text(self._path, error) from error


def _read(path: str | Path) -> bytes:
    """All bytes, unpacked."""
    path = input_path(path)
    try:
        with path.open("rb") as packed, _unpacked(path.suffix, packed) as file:
            most = TEXT_BYTES_MAX if file is packed else unpacked_bytes_max(packed, TEXT_BYTES_MAX)
            # A read takes as much room as it asks for.
            size = os.fstat(packed.fileno()).st_size
            raw: bytes = file.read(min(most, max(size, _READ_BYTES_MIN)) + 1 if file is packed else most + 1)
    except _UNREADABLE as error:
        raise _refusal(path, error) from error
    if len(raw) <= most:
        return raw
    if most < TEXT_BYTES_MAX:
        raise DataError(
            f"{path} holds more than {most // 10**6} MB of text in {path.stat().st_size // 1000} kB, as no log does; "
            "unpack it if you know what it is"
        )
    raise DataError(f"{path} holds more than {most // 10**6} MB of text; cut it into parts")


def text_encoding(raw: bytes) -> str:
    """The encoding of a text by its first bytes: UTF-8, but for the "Unicode text" of spreadsheets."""
    return "utf-16" if raw[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"


def _no_text(path: str | Path, error: UnicodeDecodeError) -> DataError:
    return DataError(f"{path} is not UTF-8 text: {error}; save it as UTF-8")


def _refusal(path: Path, error: Exception) -> DataError:
    reason = getattr(error, "strerror", None) or error
    return DataError(f"cannot read {path}: {reason}; check the path or fetch the file again")
