"""A checksum at the end of zip archives (.npz), so that no changed byte of one is read as if it were right.

The archive's comment, which other programs ignore, is the SHA-256 of all bytes before it.
"""

from __future__ import annotations

import hashlib
import zipfile
from pathlib import Path

_MARK = b"sha256:"
_LENGTH = len(_MARK) + 64
_END, _PLAIN_END_LENGTH = b"PK\x05\x06", 22
"""The last record of an archive, and its length without a comment."""


def seal(path: Path) -> None:
    """Add the checksum to a finished archive."""
    with zipfile.ZipFile(path, "a") as archive:
        archive.comment = _MARK + b"0" * 64
    content = path.read_bytes()[:-_LENGTH]
    with path.open("r+b") as file:
        file.seek(len(content))
        file.write(_MARK + hashlib.sha256(content).hexdigest().encode())


def is_unbroken(path: Path) -> bool:
    """Whether the checksum of an archive is right. True for one that never had any, as of other programs."""
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(max(0, size - _LENGTH))
        end = file.read()
        file.seek(0)
        if end[:-64] == _MARK:
            content = hashlib.sha256()
            left = size - _LENGTH
            while chunk := file.read(min(left, 1 << 20)):
                content.update(chunk)
                left -= len(chunk)
            return content.hexdigest().encode() == end[-64:]
    return end[-_PLAIN_END_LENGTH:].startswith(_END) and end.endswith(b"\0\0")
