"""Downloads that go on where they were interrupted, and are checked before they count."""

from __future__ import annotations

import gzip
import hashlib
import urllib.error
import urllib.request
import zlib
from collections.abc import Callable
from http.client import HTTPException
from pathlib import Path

from twc_env._version import __version__
from twc_env.datasets.public.catalogue import DataFile
from twc_env.errors import DataError
from twc_env.records.whole_file import whole_file

CHUNK = 1 << 16
TIMEOUT_S = 30.0
TRIES = 3
"""Times that an interrupted transfer is taken up again before the command gives up."""
_PACKED_SHARE = 3
"""A download may have at most so many times the size of the content, plus a little: more is another file."""

Progress = Callable[[int, int], None]
"""Called with the bytes received, and the bytes in all (0: unknown)."""


def fetch(file: DataFile, folder: Path, progress: Progress = lambda done, total: None) -> bool:
    """Bring a file to its place below the folder; returns False if it was there already.

    The part that was received is kept beside it (.part) until it is whole. Raises DataError if it cannot be fetched, or
    its checksum differs.
    """
    place = folder / file.place
    if place.exists() and _sha256(_content(place.read_bytes(), place.suffix == ".gz", place)) == file.sha256:
        return False
    if file.url is None:
        raise DataError(f"the address of {file.place} is not known: get it from the source by hand, as {place}")
    if not file.url.startswith(("http://", "https://")):
        raise DataError(f"{file.url} is no web address")
    part = place.with_name(f"{place.name}.part")
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        _receive(file, part, progress)
        raw = part.read_bytes()
    except (OSError, HTTPException) as error:
        reason = getattr(error, "reason", None) or getattr(error, "strerror", None) or error
        kept = f"; {part.stat().st_size} bytes are kept, fetch again to go on" if part.exists() else ""
        raise DataError(f"cannot fetch {file.url}: {reason}{kept}") from error
    is_packed = file.url.endswith(".gz")
    try:
        content = _content(raw, is_packed, part)
    except DataError:
        part.unlink()
        raise
    if (found := _sha256(content)) != file.sha256:
        part.unlink()
        raise DataError(
            f"{file.url} has SHA-256 {found[:16]}..., expected {file.sha256[:16]}...: not kept; fetch again"
        )
    with whole_file(place) as beside:
        beside.write_bytes(_stored(raw, content, is_packed, place.suffix == ".gz"))
    part.unlink()
    return True


def _receive(file: DataFile, part: Path, progress: Progress) -> None:
    """Fetch what is missing of the partial file."""
    limit = _PACKED_SHARE * file.bytes + CHUNK
    for attempt in range(TRIES):
        have = part.stat().st_size if part.exists() else 0
        request = urllib.request.Request(str(file.url), headers={"User-Agent": f"twc_env/{__version__}"})
        if have:
            request.add_header("Range", f"bytes={have}-")
        try:
            with urllib.request.urlopen(request, timeout=TIMEOUT_S) as answer:
                is_rest = answer.status == 206
                told = answer.headers.get("Content-Length", "")
                total = (have if is_rest else 0) + int(told) if told.isdigit() else 0
                have = have if is_rest else 0
                with part.open("ab" if is_rest else "wb") as out:
                    while chunk := answer.read(CHUNK):
                        out.write(chunk)
                        have += len(chunk)
                        progress(have, total)
                        if have > limit:
                            out.truncate(0)
                            raise DataError(f"{file.url} has more than {limit} bytes: it is another file; not kept")
            if have >= total:
                return
        except urllib.error.HTTPError as error:
            if error.code == 416 and have:  # nothing is missing
                return
            raise
        except (urllib.error.URLError, TimeoutError, ConnectionError, HTTPException):
            if attempt == TRIES - 1:
                raise
    raise DataError(f"{file.url} broke off {TRIES} times; {have} bytes are kept, fetch again to go on")


def _content(raw: bytes, is_packed: bool, path: Path) -> bytes:
    try:
        return gzip.decompress(raw) if is_packed else raw
    except (OSError, EOFError, zlib.error) as error:
        raise DataError(f"{path} is no gzip file: {error}; fetch it again") from error


def _stored(raw: bytes, content: bytes, is_packed: bool, is_kept_packed: bool) -> bytes:
    if is_packed == is_kept_packed:
        return raw
    return gzip.compress(content, mtime=0) if is_kept_packed else content


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
