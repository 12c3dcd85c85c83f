"""The public data sets that tables of `reproduce` need: addresses, licences, checksums and places."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from pathlib import Path

from twc_env.errors import ConfigError, DataError, one_of

VARIABLE = "TWC_DATA"
"""Environment variable that names the folder of the data."""


@dataclass(frozen=True, slots=True)
class DataFile:
    """One file of a set."""

    place: str
    """Path below the folder of the data; packed if it ends in .gz."""
    url: str | None
    """Where it is fetched from; None: by hand, since its address is not known or it was exported from another file."""
    bytes: int
    """Size, unpacked."""
    sha256: str
    """Checksum of the content, unpacked."""


@dataclass(frozen=True, slots=True)
class DataSet:
    """A public data set."""

    name: str
    about: str
    licence: str
    source: str
    tables: tuple[str, ...]
    """Tables of `twc-env reproduce` that need it."""
    files: tuple[DataFile, ...]

    @property
    def bytes(self) -> int:
        """Size of all files, unpacked."""
        return sum(each.bytes for each in self.files)


@lru_cache(maxsize=1)
def catalogue() -> dict[str, DataSet]:
    """All sets by name."""
    text = files(__package__).joinpath("catalogue.json").read_text(encoding="utf-8")
    sets = {}
    for row in json.loads(text)["sets"]:
        parts = tuple(DataFile(**each) for each in row["files"])
        sets[row["name"]] = DataSet(**{**row, "tables": tuple(row["tables"]), "files": parts})
    return sets


def data_set(name: str) -> DataSet:
    """A set by its name. Raises ConfigError for an unknown one."""
    known = catalogue()
    if name not in known:
        raise ConfigError(f"there is no data set {name!r}{one_of(name, known)}")
    return known[name]


def folder_of_data(told: Path | None) -> Path:
    """The folder told, else that of the environment variable. Raises DataError without either."""
    if told is not None:
        return told
    if not os.environ.get(VARIABLE):
        raise DataError(f"where to? set {VARIABLE} to the folder of the data, or give --out FOLDER")
    return Path(os.environ[VARIABLE])
