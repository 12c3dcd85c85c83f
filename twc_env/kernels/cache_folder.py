"""Where compiled kernels are kept on disk: one folder per state of the sources, so that none is ever out of date.

Numba notices a change of the file of a kernel, but not of the files that it imports. Therefore the folder's name is a
digest of all sources of this package and of the versions that compiled code depends on.
"""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from functools import cache
from importlib.metadata import version
from pathlib import Path

import numba
import numpy as np
import platformdirs

UNUSED_DAYS = 30.0
"""Folders of other sources that no process has used for so long are deleted."""
_NAME = "twc_env-"


@cache
def cache_folder() -> Path:
    """The folder of this process, which exists.

    It lies in `NUMBA_CACHE_DIR`, or else in the user's cache folder. If it can only be read (an image whose kernels
    somebody else has compiled), the process works on a copy; if it cannot be made at all, in an empty folder. Both are
    temporary and deleted at the end of the process.
    """
    digest = source_digest()
    for base in filter(None, (numba.config.CACHE_DIR, _user_folder())):
        folder = Path(base, _NAME + digest)
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


@contextlib.contextmanager
def caching_there() -> Iterator[None]:
    """Numba keeps the functions that are decorated in this block in `cache_folder`; others are not affected."""
    before, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(cache_folder())
    try:
        yield
    finally:
        numba.config.CACHE_DIR = before


def source_digest() -> str:
    """Digest of all sources of this package and of the versions of Python, NumPy, numba and llvmlite."""
    versions = sys.version_info[:3], np.__version__, numba.__version__, version("llvmlite"), numba.config.BOUNDSCHECK
    digest, root = hashlib.sha256(repr(versions).encode()), Path(__file__).parents[1]
    for path in sorted(root.rglob("*.py")):
        content = path.read_bytes()
        digest.update(f"{path.relative_to(root).as_posix()} {len(content)} ".encode() + content)
    return digest.hexdigest()[:16]


def _user_folder() -> Path | None:
    folder = platformdirs.user_cache_path("twc_env", appauthor=False)
    return folder / "kernels" if folder.is_absolute() else None  # without a home it begins with ~


def _temporary_folder(filled: Path | None = None) -> Path:
    folder = Path(tempfile.mkdtemp(prefix="kernels-"))
    owner = os.getpid()
    atexit.register(lambda: shutil.rmtree(folder, ignore_errors=True) if os.getpid() == owner else None)
    if filled is not None:
        shutil.copytree(filled, folder, dirs_exist_ok=True)
        for place, _, _ in os.walk(folder):
            os.chmod(place, 0o700)
    return folder


def _delete_unused(folder: Path) -> None:
    """Delete folders beside this one that have not been used for a long time."""
    for other in folder.parent.glob(f"{_NAME}*"):
        with contextlib.suppress(OSError):
            if other != folder and time.time() - other.stat().st_mtime > UNUSED_DAYS * 86400:
                shutil.rmtree(other, ignore_errors=True)
