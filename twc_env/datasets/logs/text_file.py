"""Text files, plain or compressed."""

from __future__ import annotations

import gzip
import lzma
import zlib
from pathlib import Path

from twc_env.errors import DataError


def read_text(path: str | Path, errors: str = "strict") -> str:
    """The text of a plain, gzip (.gz) or xz (.xz) file, without a byte order mark; DataError if it cannot be read.

    errors: "replace" also accepts invalid UTF-8, for formats where it occurs in comments only.
    """
    path = Path(path)
    try:
        raw = path.read_bytes()
        if path.suffix == ".gz":
            raw = gzip.decompress(raw)
        elif path.suffix == ".xz":
            raw = lzma.decompress(raw)
        return raw.decode("utf-8-sig", errors)
    except UnicodeDecodeError as error:
        raise DataError(f"{path} is not UTF-8 text: {error}; save it as UTF-8") from error
    except (OSError, EOFError, zlib.error, lzma.LZMAError) as error:
        reason = getattr(error, "strerror", None) or error
        raise DataError(f"cannot read {path}: {reason}; check the path or fetch the file again") from error
