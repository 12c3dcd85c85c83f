"""Where compiled kernels are kept on disk: one folder per module and state of what its kernels are made of.

Numba notices a change of the file of a kernel, but not of the files that it imports. Therefore the name of the folder
of a module holds a digest of its source, of the constants it has and of all modules whose kernels it imports. A change
elsewhere compiles nothing anew.

Damaged files would crash the process that runs them: each folder has the checksums of its files, see `check_folders`.
"""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import json
import logging
import os
import shutil
import sys
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numba
import numpy as np
import platformdirs

UNUSED_DAYS = 30.0
"""Folders of other sources that no process has used for so long are deleted."""
_NAME = "twc_env-"
_SUMS = "sums.json"
_DIGESTS: dict[str, tuple[int, str]] = {}
"""Per module with kernels: the id of its namespace and its digest."""
_FOLDERS: dict[str, Path] = {}
"""Per module with kernels its folder."""
_UNCHECKED: list[Path] = []
"""Folders of which no checksum has been compared in this process."""
_LOG = logging.getLogger("twc_env")


@cache
def cache_folder() -> Path:
    """The folder of this process, which exists.

    It lies in `NUMBA_CACHE_DIR`, or else in the user's cache folder. If it can only be read (an image whose kernels
    somebody else has compiled), the process works on a copy; if it cannot be made at all, in an empty folder. Both are
    temporary and deleted at the end of the process.
    """
    for base in (numba.config.CACHE_DIR, _user_folder()):
        if not base:
            continue
        folder = Path(base, _NAME + version_digest())
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                pass
            os.utime(folder)
        except OSError:
            if folder.is_dir() and any(folder.iterdir()):
                return _temporary_folder(folder)
            continue
        _delete_unused(folder)
        return folder
    return _temporary_folder()


def is_kept() -> bool:
    """Whether what is compiled now is there for later processes."""
    return cache_folder().name.startswith(_NAME)


def is_empty() -> bool:
    """Whether nothing that was compiled is kept yet."""
    return next(cache_folder().rglob("*.nbi"), None) is None


@contextlib.contextmanager
def caching_there(function: Callable[..., Any]) -> Iterator[None]:
    """Numba keeps this function, if decorated in this block, in the folder of its module; others are not affected."""
    folder = cache_folder() / f"{function.__module__}-{module_digest(function)}"
    if _FOLDERS.get(function.__module__) != folder:
        _FOLDERS[function.__module__] = folder
        _UNCHECKED.append(folder)
        with contextlib.suppress(OSError):  # numba says itself where it cannot write
            if not folder.is_dir():
                folder.mkdir(exist_ok=True)
                _delete_unused(folder, f"{function.__module__}-*")
            elif time.time() - folder.stat().st_mtime > 86400.0:
                os.utime(folder)
    before, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(folder)
    try:
        yield
    finally:
        numba.config.CACHE_DIR = before


def check_folders() -> None:
    """Empty folders whose files differ from their checksums, before anything is read from them. Whoever calls this
    holds the lock of those who compile."""
    while _UNCHECKED:
        folder = _UNCHECKED.pop()
        found = _checksums(folder)
        if not found:
            continue
        try:
            expected = json.loads((folder / _SUMS).read_text())
        except (OSError, ValueError):  # also after a kill between compiling and writing the sums
            expected = None
        if found != expected:
            if isinstance(expected, dict):
                _LOG.warning("damaged files in %s: these kernels are compiled anew", folder)
            for name in found:
                (folder / name).unlink(missing_ok=True)


def write_checksums(module: str) -> None:
    """Keep the checksums of a module's folder; whoever calls this holds the lock of those who compile."""
    folder = _FOLDERS.get(module)
    if folder is not None:
        with contextlib.suppress(OSError):
            (folder / _SUMS).write_text(json.dumps(_checksums(folder)))


def _checksums(folder: Path) -> dict[str, int]:
    """Checksums of a folder's files by their names relative to it."""
    found = {}
    for place, _, names in os.walk(folder):
        for name in names:
            path = Path(place, name)
            if name != _SUMS and path.suffix in (".nbi", ".nbc"):
                found[path.relative_to(folder).as_posix()] = zlib.crc32(path.read_bytes())
    return found


def version_digest() -> str:
    """Digest of the versions of Python, NumPy, numba and llvmlite, and of this package's way to compile."""
    versions = sys.version_info[:3], np.__version__, numba.__version__, version("llvmlite"), numba.config.BOUNDSCHECK
    digest = hashlib.sha256(repr(versions).encode())
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def module_digest(function: Callable[..., Any]) -> str:
    """Digest of everything that the kernels of a function's module are compiled from: its source, the values of its
    constants, and the digests of the modules whose kernels it imports.

    It is taken at the module's first kernel: what kernels read stands above them.
    """
    values, name = function.__globals__, function.__module__
    known = _DIGESTS.get(name)
    if known is not None and known[0] == id(values):
        return known[1]
    digest = hashlib.sha256(name.encode())
    with contextlib.suppress(OSError):
        digest.update(Path(function.__code__.co_filename).read_bytes())
    for key in sorted(values):
        if not key.startswith("__"):
            content = _content(values[key])
            if content is not None:
                digest.update(f"{key}={content};".encode())
    _DIGESTS[name] = id(values), digest.hexdigest()[:16]
    return _DIGESTS[name][1]


def _content(value: Any) -> str | None:
    """What a kernel takes from a global name; None for what it cannot use."""
    if isinstance(value, bool | int | float | complex | str | bytes | np.generic) or value is None:
        return repr(value)
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}{hashlib.sha256(np.ascontiguousarray(value).data).hexdigest()}"
    if isinstance(value, tuple | list | frozenset):
        return f"{type(value).__name__}({','.join(str(_content(each)) for each in value)})"
    if isinstance(value, type):
        return f"{value.__qualname__}{getattr(value, '_fields', '')}"
    python = getattr(value, "py_func", None)  # a compiled function
    return None if python is None else module_digest(python)


def _user_folder() -> Path | None:
    try:
        folder = platformdirs.user_cache_path("twc_env", appauthor=False)
    except (RuntimeError, KeyError):  # there is no home, and no entry of this user from which it would be known
        return None
    return folder / "kernels" if folder.is_absolute() else None  # older versions of platformdirs give a path with ~


def _temporary_folder(filled: Path | None = None) -> Path:
    folder = Path(tempfile.mkdtemp(prefix="kernels-"))
    owner = os.getpid()
    atexit.register(lambda: shutil.rmtree(folder, ignore_errors=True) if os.getpid() == owner else None)
    if filled is not None:
        shutil.copytree(filled, folder, dirs_exist_ok=True)
        for place, _, _ in os.walk(folder):
            os.chmod(place, 0o700)
    return folder


def _delete_unused(folder: Path, pattern: str = f"{_NAME}*") -> None:
    """Delete folders beside this one that have not been used for a long time."""
    for other in folder.parent.glob(pattern):
        with contextlib.suppress(OSError):
            if other != folder and time.time() - other.stat().st_mtime > UNUSED_DAYS * 86400:
                shutil.rmtree(other, ignore_errors=True)
