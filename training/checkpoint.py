"""Checkpoints: arrays and plain values in one safetensors file, which cannot run code, written whole or not at all.

Nothing is ever unpickled. A file is accepted only if it is exactly what `save` writes, to the last byte.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.numpy
from numpy.typing import NDArray as Array

from twc_env.errors import DataError
from twc_env.records.json_values import table_of
from twc_env.records.whole_file import whole_file

FORMAT = "twc_env/checkpoint-1"
FILE_NAME = "model.safetensors"
"""Name of the checkpoint in the folder of a run."""
BYTES_MAX = 300_000_000
_KEY = "twc_env"
_REMEDY = "train anew, or name another"


def save(path: Path, arrays: Mapping[str, Array], values: Mapping[str, Any]) -> None:
    """Save whole or not at all: a crash, or a power failure, leaves the old file intact. values: as JSON has them."""
    content = _packed({name: np.array(array, order="C") for name, array in arrays.items()}, json.dumps(values))
    with whole_file(path) as beside, beside.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def load(path: Path) -> tuple[dict[str, Array], dict[str, Any]]:
    """What `save` wrote. Raises DataError for a file that is missing, damaged or of another kind."""
    if not path.is_file():
        raise DataError(f"there is no model {path}; train one, or name the folder of a run")
    try:
        if path.stat().st_size > BYTES_MAX:
            raise DataError(f"it is larger than the {BYTES_MAX / 1e6:.0f} MB that are possible")
        content = path.read_bytes()
        if content[:2] in (b"PK", b"\x80\x02", b"\x80\x04", b"\x80\x05"):
            raise DataError("it is an archive or pickle of another program, which could run code when it is read")
        length = int.from_bytes(content[:8], "little")
        header = json.loads(content[8 : 8 + length], object_pairs_hook=table_of)
        told = json.loads(header["__metadata__"][_KEY], object_pairs_hook=table_of)
        if told.get("format") != FORMAT:
            raise DataError(f"its format is {told.get('format')!r:.40}, this version reads {FORMAT}")
        arrays = {name: array.copy() for name, array in safetensors.numpy.load(content).items()}
        if _packed(arrays, told["values"]) != content:
            raise DataError("it is not as it was written, since its checksum differs")
        return arrays, json.loads(told["values"])
    except Exception as error:  # a damaged file raises almost any exception
        damage = f"it is no model, or damaged ({type(error).__name__}: {error}"[:200] + ")"
        what = str(error) if isinstance(error, DataError) else damage
        raise DataError(f"cannot read the model {path}: {what}; {_REMEDY}") from error


def _packed(arrays: Mapping[str, Array], values: str) -> bytes:
    """The bytes of a file; the same for the same content."""
    digest = hashlib.sha256(values.encode())
    for name in sorted(arrays):
        digest.update(f"{name} {arrays[name].dtype.str} {arrays[name].shape}".encode())
        digest.update(arrays[name].tobytes())
    told = {"format": FORMAT, "values": values, "sha256": digest.hexdigest()}
    packed: bytes = safetensors.numpy.save(dict(arrays), {_KEY: json.dumps(told)})
    return packed


def below(arrays: Mapping[str, Array], prefix: str) -> dict[str, Array]:
    """The arrays whose names begin with `prefix`, without it."""
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}


def prefixed(prefix: str, arrays: Mapping[str, Array]) -> dict[str, Array]:
    """The arrays under names with `prefix`, which `below` takes off again."""
    return {prefix + name: array for name, array in arrays.items()}
