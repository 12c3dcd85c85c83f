"""Files of text, plain or packed."""

from __future__ import annotations

import gzip
import lzma
import zlib
from pathlib import Path

from twc_env.errors import DataError


def read_text(path: str | Path) -> str:
    """The text of a plain, gzip (.gz) or xz (.xz) file, without a byte order mark; DataError if it cannot be read."""
    path = Path(path)
    try:
        raw = path.read_bytes()
        if path.suffix == ".gz":
            raw = gzip.decompress(raw)
        elif path.suffix == ".xz":
            raw = lzma.decompress(raw)
        return raw.decode("utf-8-sig")
    except (OSError, EOFError, zlib.error, lzma.LZMAError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise DataError(f"cannot read {path}: {reason}; check the path or fetch the file again") from error
