"""Our own .npz files, with one-line errors for files that are missing, truncated, of another kind or incomplete."""

from __future__ import annotations

import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import DataError


def write_arrays(path: str | Path, **arrays: Any) -> None:
    """Write a compressed file with exactly this name; numpy alone would append .npz."""
    with Path(path).open("wb") as file:
        np.savez_compressed(file, **arrays)


def read_arrays(path: str | Path, kind: str, form: str, keys: Iterable[str], remedy: str) -> dict[str, Array]:
    """All arrays of a file that names its `form` and holds at least these keys.

    `kind` names the expected file and `remedy` the advice in error messages. Raises DataError.
    """
    path = Path(path)
    try:
        if path.is_file() and not zipfile.is_zipfile(path):
            raise DataError(f"{path} is not a {kind} or is truncated; {remedy}")
        with path.open("rb") as file, np.load(file) as data:
            arrays = {key: data[key] for key in data.files}
    except OSError as error:
        raise DataError(f"cannot read the {kind} {path}: {error.strerror or error}; {remedy}") from error
    except DataError:
        raise
    except Exception as error:  # a broken archive surfaces as almost any exception
        raise DataError(f"{path} is not a {kind} or is truncated: {error}; {remedy}") from error
    if str(arrays.get("format")) != form:
        raise DataError(f"{path} has format {str(arrays.get('format'))!r}; expected {form!r}: {remedy}")
    if missing := sorted(set(keys) - set(arrays)):
        raise DataError(f"{path} lacks {', '.join(missing)}; {remedy}")
    return arrays
