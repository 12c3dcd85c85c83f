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


def _unpacked(suffix: str, packed: BinaryIO) -> BinaryIO | gzip.GzipFile | lzma.LZMAFile:
    if suffix == ".gz":
        return gzip.GzipFile(fileobj=packed)
    return lzma.LZMAFile(packed) if suffix == ".xz" else packed


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
        is_wide = raw[:2] in (b"\xff\xfe", b"\xfe\xff")  # "Unicode text" of spreadsheets
        return raw.decode("utf-16" if is_wide else "utf-8-sig", errors)
    except UnicodeDecodeError as error:
        raise DataError(f"{path} is not UTF-8 text: {error}; save it as UTF-8") from error
    except (OSError, EOFError, zlib.error, lzma.LZMAError) as error:
        reason = getattr(error, "strerror", None) or error
        raise DataError(f"cannot read {path}: {reason}; check the path or fetch the file again") from error
