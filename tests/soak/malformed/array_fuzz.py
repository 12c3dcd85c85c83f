"""Malformed files of arrays: lasting maps, frame logs, models. Reading one may only raise DataError, or ConfigError
for settings in it; what is read must work."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from tests.soak.attempts import Attempt, workplace
from tests.soak.malformed.mutations import OF_JSON, mutated
from twc_env.bench.rates import wander
from twc_env.config import EnvConfig, override
from twc_env.datasets.lasting_maps import read_lasting_map, save_map
from twc_env.datasets.logs.arrays_file import write_arrays
from twc_env.datasets.logs.frame_log import write_frame_log
from twc_env.exploration.environment import ExplorationEnv
from twc_env.records.random_streams import random_stream
from twc_env.replaying.inputs import Asked, read_input
from twc_env.replaying.run import run
from twc_env.slam.engine import CooperativeSlam

SMALL = {"robots": 2, "lidar.beam_count": 36, "max_cycles": 60}
_ODD_TYPES = ("f8", "f4", "i8", "u1", "?", "i1", "c16", "U3")
_TYPES_OF_MODELS = 6
"""The first of them are possible in models."""


def malformed_arrays(count: int, seed: int = 0) -> Iterator[Attempt]:
    """Read `count` malformed files: damaged ones, and whole ones (with a right checksum) that hold odd arrays."""
    random = random_stream(seed, "array-fuzz")
    config = override(EnvConfig(), SMALL)
    with workplace() as folder:
        readers = _samples(folder, config)
        kinds = list(readers)
        for read in readers.values():  # kernels compile before the clock runs
            read()
        for number in range(count):
            path = folder / kinds[number % len(kinds)]
            sound = path.read_bytes()
            if random.random() < 0.3:
                raw, what = mutated(sound, random)
                path.with_name(f"odd-{path.name}").write_bytes(raw)
            else:
                what = _rewritten(path, random)
            yield f"#{number} {path.name}: {what}", partial(readers[path.name], "odd-")


def _samples(folder: Path, config: EnvConfig) -> dict[str, Callable]:
    env = ExplorationEnv(config=config)
    env.reset(seed=0)
    steps = []
    for actions in wander(env, 0):
        steps.append(tuple(env.frames))
        env.step(actions)
    save_map(folder / "prior.npz", env.engine)
    write_frame_log(folder / "frames.npz", config, steps[:20])
    kinds = {"prior.npz": partial(_begin_with, folder, config), "frames.npz": partial(_replay, folder)}
    if find_spec("safetensors"):
        from twc_env.training.checkpoint import load, save

        save(
            folder / "model.safetensors", {"a": np.ones((2, 3), np.float32), "b": np.zeros(4)}, {"seed": 3, "open": []}
        )
        kinds["model.safetensors"] = lambda odd="": load(folder / f"{odd}model.safetensors")
    return kinds


def _begin_with(folder: Path, config: EnvConfig, odd: str = "") -> None:
    """Read a map that lasts and give it to an engine."""
    CooperativeSlam(config, 2, prior=read_lasting_map(folder / f"{odd}prior.npz"))


def _replay(folder: Path, odd: str = "") -> None:
    source = read_input([folder / f"{odd}frames.npz"], Asked())
    run(source, source.config)


def _rewritten(path: Path, random: np.random.Generator) -> str:
    """A file with a right checksum and an odd array in it; returns which."""
    if path.suffix == ".safetensors":
        from twc_env.training.checkpoint import load, save

        arrays, values = load(path)
        told = _odd_array(arrays, random, _TYPES_OF_MODELS)
        save(path.with_name(f"odd-{path.name}"), arrays, values)
        return told
    with np.load(path) as data:
        arrays = {name: data[name] for name in data.files}
    told = _odd_array(arrays, random)
    write_arrays(path.with_name(f"odd-{path.name}"), **arrays)
    return told


def _odd_array(arrays: dict[str, Any], random: np.random.Generator, types: int = len(_ODD_TYPES)) -> str:
    """Change one array in place; returns how."""
    name = sorted(arrays)[int(random.integers(len(arrays)))]
    array: Array = arrays[name]
    if array.dtype.kind == "U" and array.ndim == 0 and random.random() < 0.8:
        raw, what = mutated(str(array).encode(), random, OF_JSON)
        arrays[name] = np.array(raw.decode("utf-8", "replace"))
        return f"{name}: {what}"
    kind = int(random.integers(6))
    if kind == 0:
        del arrays[name]
        return f"no {name}"
    if kind == 1:
        arrays[name] = array[..., None] if random.random() < 0.5 else array.ravel()[: max(array.size - 1, 0)]
    elif kind == 2:
        dtype = _ODD_TYPES[int(random.integers(types))]
        try:
            with np.errstate(all="ignore"):
                arrays[name] = array.astype(dtype)
        except ValueError:
            arrays[name] = np.zeros(array.shape, dtype)
    elif array.size and array.dtype.kind in "iufb":
        odd = {
            "i": (-1, 2**31 - 1, 10**6),
            "u": (0, 255),
            "f": (np.nan, np.inf, -1e300, 1e300, 1e9),
            "b": (True, False),
        }
        choices = odd[array.dtype.kind]
        changed = array.copy().reshape(-1)
        places = slice(None) if kind == 3 else random.integers(0, changed.size, 3)
        with np.errstate(all="ignore"):
            changed[places] = np.array(choices[int(random.integers(len(choices)))]).astype(array.dtype)
        arrays[name] = changed.reshape(array.shape)
    else:
        arrays[name] = np.array([])
    return f"{name} as {arrays[name].dtype} {arrays[name].shape}: {str(arrays[name].ravel()[:3])[:60]}"
