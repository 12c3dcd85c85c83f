"""The folder that a command writes to."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from twc_env.errors import DataError
from twc_env.processes.file_lock import FileLock
from twc_env.running.options import PICTURE_FORMATS


def make_folder(folder: Path) -> None:
    """Create the folder that `--out` names. Raises DataError if that fails."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"cannot make the folder {folder}: {error.strerror}; choose another with --out") from error


def remove_stale(folder: Path, stems: Iterable[str], written: Collection[Path]) -> None:
    """Remove the pictures of these names that an earlier command has left, but this one has not written."""
    for stem in stems:
        for kind in PICTURE_FORMATS:
            if (path := folder / f"{stem}.{kind}") not in written:
                path.unlink(missing_ok=True)


@contextmanager
def alone_in(folder: Path, patience_s: float = 60.0) -> Iterator[None]:
    """Lock a folder, which is created, so that two commands do not mix their files in it.

    Raises DataError if another command holds it for longer than `patience_s`, or if the folder cannot be created.
    """
    make_folder(folder)
    with FileLock(folder / ".lock").held(patience_s) as is_ours:
        if is_ours is False:
            raise DataError(f"another command writes to {folder}: wait for its end, or choose another with --out")
        yield
