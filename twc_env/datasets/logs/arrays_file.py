"""Our own .npz files, with one-line errors for files that are missing, truncated, of another kind or incomplete."""

from __future__ import annotations

import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import DataError
from twc_env.records.input_file import input_path
from twc_env.records.seal import is_unbroken, seal
from twc_env.records.whole_file import whole_file

ARRAYS_BYTES_MAX = 900_000_000
"""Maximum size of the arrays of a file, unpacked."""
_OTHERS = {
    "twc_env/frames": "it is a frame log; `twc-env replay FILE` runs the engine on it",
    "twc_env/truth": "it is the truth of a frame log; give it by --truth",
    "twc_env/lasting-map": "it is a saved map; give it by --prior, beside a log",
    "twc_env/trace": "it is the trace of an episode; `twc-env replay RUN --html` shows its run folder",
}
"""What the formats are, and what would work."""
_DIGITS_MAX = 9


def write_arrays(path: str | Path, **arrays: Any) -> None:
    """Write a compressed file with exactly this name, whole or not at all, and with a checksum; numpy alone would
    append .npz."""
    with whole_file(path) as beside:
        with beside.open("wb") as file:
            np.savez_compressed(file, **arrays)
        if beside.is_file():  # and not a device
            seal(beside)


def read_arrays(path: str | Path, kind: str, form: str, keys: Iterable[str], remedy: str) -> dict[str, Array]:
    """All arrays of a file that names its `form` and holds at least these keys.

    `kind` names the expected file and `remedy` the advice in error messages. Raises DataError.
    """
    path = input_path(path)
    try:
        if path.is_file() and not zipfile.is_zipfile(path):
            raise DataError(f"{path} is not a {kind} or is truncated; {remedy}")
        if path.is_file() and not is_unbroken(path):
            raise DataError(f"{path} is not as it was written: its checksum differs; {remedy}")
        _check_size(path)
        with path.open("rb") as file, np.load(file) as data:
            named = str(data["format"]) if "format" in data.files else None
            arrays = {key: data[key] for key in data.files} if named == form else {}  # others may be of any size
    except OSError as error:
        raise DataError(f"cannot read the {kind} {path}: {error.strerror or error}; {remedy}") from error
    except DataError:
        raise
    except Exception as error:  # a broken archive surfaces as almost any exception
        raise DataError(f"{path} is not a {kind} or is truncated: {error}; {remedy}") from error
    if named != form:
        raise DataError(f"{path} has format {named!r:.60}; expected {form!r}: {_advice(named or '', form) or remedy}")
    if missing := sorted(set(keys) - set(arrays)):
        raise DataError(f"{path} lacks {', '.join(missing)}; {remedy}")
    return arrays


def _advice(named: str, form: str) -> str | None:
    """What to do with a file of another format than expected; None for those that are not ours, or are old."""
    (stem, _, version), (own, _, known) = named.rpartition("-"), form.rpartition("-")
    if stem == own:
        is_newer = version.isdecimal() and len(version) <= _DIGITS_MAX and int(version) > int(known)
        return "a newer version wrote it; update twc_env" if is_newer else None
    return _OTHERS.get(stem)


WHOLE, REAL, TRUTH_VALUE, TEXT = (
    ("iu", "whole numbers"), ("iuf", "real numbers"), ("b", "true and false"), ("U", "text")
)  # fmt: skip
"""Kinds of numpy's data types that a column may have, and what they are called."""


def fault_of_types(arrays: Mapping[str, Array], columns: Mapping[tuple[str, str], Iterable[str]]) -> str | None:
    """The first of these columns, by what they may hold, that is of another type; None if there is none."""
    for (kinds, what), names in columns.items():
        for name in names:
            if name in arrays and arrays[name].dtype.kind not in kinds and arrays[name].size:
                return f"{name} of type {arrays[name].dtype}, {what} are possible"
    return None


def _check_size(path: Path) -> None:
    """Raise DataError for an archive that would not fit in memory, before it is read."""
    with zipfile.ZipFile(path) as archive:
        size = sum(part.file_size for part in archive.infolist())
    if size > ARRAYS_BYTES_MAX:
        raise DataError(
            f"{path} holds {size / 1e6:.0f} MB of arrays, {ARRAYS_BYTES_MAX / 1e6:.0f} MB are possible; "
            "record fewer steps"
        )
