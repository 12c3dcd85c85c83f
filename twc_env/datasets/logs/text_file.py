"""Text files, plain or compressed."""

from __future__ import annotations

import gzip
import io
import lzma
import zlib
from pathlib import Path

from twc_env.errors import DataError

TEXT_BYTES_MAX = 1_000_000_000
"""Maximum size of a text, unpacked: a packed file of a few megabytes can hold any number of equal bytes."""


def read_text(path: str | Path, errors: str = "strict") -> str:
    """The text of a plain, gzip (.gz) or xz (.xz) file, without a byte order mark; DataError if it cannot be read.

    errors: "replace" also accepts invalid UTF-8, for formats where it occurs in comments only.
    """
    path = Path(path)
    try:
        packed = path.read_bytes()
        raw = packed
        if path.suffix == ".gz":
            with gzip.GzipFile(fileobj=io.BytesIO(packed)) as file:
                raw = file.read(TEXT_BYTES_MAX + 1)
        elif path.suffix == ".xz":
            with lzma.LZMAFile(io.BytesIO(packed)) as unpacked:
                raw = unpacked.read(TEXT_BYTES_MAX + 1)
        if len(raw) > TEXT_BYTES_MAX:
            raise DataError(f"{path} holds more than {TEXT_BYTES_MAX // 10**6} MB of text; cut it into parts")
        return raw.decode("utf-8-sig", errors)
    except UnicodeDecodeError as error:
        raise DataError(f"{path} is not UTF-8 text: {error}; save it as UTF-8") from error
    except (OSError, EOFError, zlib.error, lzma.LZMAError) as error:
        reason = getattr(error, "strerror", None) or error
        raise DataError(f"cannot read {path}: {reason}; check the path or fetch the file again") from error
