"""A moment of an episode, whole and exact, to come back to: tree search, branching rollouts, debugging."""

from __future__ import annotations

import io
import pickle
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from twc_env._version import __version__
from twc_env.config import digest
from twc_env.errors import ConfigError
from twc_env.world.floorplan import Floorplan

if TYPE_CHECKING:
    from twc_env.exploration.environment import ExplorationEnv
    from twc_env.slam.modes import Engine

Array = NDArray

_STATE = (
    "_episode_config", "_plan", "_world", "_engine", "_link", "_builder", "_pilot", "_scout", "_record", "_standing",
    "_bytes_judged", "_steps", "_seed", "_frames", "_beliefs", "agents",
)  # fmt: skip
"""What of an environment changes during an episode."""
_PLAN = "floorplan"


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """Can be pickled and restored in another process; the building is held once, by reference."""

    config_digest: str
    version: str
    floorplan: Floorplan
    content: bytes


class _Pickler(pickle.Pickler):
    """Leaves the building out, which never changes, and keeps arrays that share memory sharing it."""

    def __init__(self, file: io.BytesIO, floorplan: Floorplan):
        super().__init__(file, protocol=pickle.HIGHEST_PROTOCOL)
        self._floorplan = floorplan

    def persistent_id(self, value: Any) -> str | None:
        return _PLAN if value is self._floorplan else None

    def reducer_override(self, value: Any) -> Any:
        if type(value) is not np.ndarray or not isinstance(value.base, np.ndarray):
            return NotImplemented
        whole = value.base
        while isinstance(whole.base, np.ndarray):
            whole = whole.base
        if whole.base is not None or not (whole.flags.c_contiguous or whole.flags.f_contiguous):
            return NotImplemented
        offset = value.__array_interface__["data"][0] - whole.__array_interface__["data"][0]
        return _part_of, (whole, value.dtype, value.shape, value.strides, offset, value.flags.writeable)


def _part_of(whole: Array, dtype: np.dtype, shape: tuple, strides: tuple, offset: int, is_writeable: bool) -> Array:
    """The view of an array that another array was."""
    part: Array = np.ndarray(shape, dtype, whole.reshape(-1, order="A").view(np.uint8), offset, strides)
    part.flags.writeable = is_writeable and whole.flags.writeable
    return part


class _Unpickler(pickle.Unpickler):
    def __init__(self, file: io.BytesIO, floorplan: Floorplan):
        super().__init__(file)
        self._floorplan = floorplan

    def persistent_load(self, name: str) -> Floorplan:
        return self._floorplan


def take_snapshot(env: ExplorationEnv, engine: Engine) -> Snapshot:
    """See `ExplorationEnv.snapshot`; `engine` proves that an episode has begun."""
    buffer = io.BytesIO()
    state = {name: getattr(env, name) for name in _STATE} | {"_engine": engine}
    _Pickler(buffer, env.floorplan).dump(state)
    return Snapshot(digest(env.config), __version__, env.floorplan, buffer.getvalue())


def restore_snapshot(env: ExplorationEnv, snapshot: Snapshot) -> None:
    """See `ExplorationEnv.restore`."""
    _check("configuration", snapshot.config_digest, digest(env.config))
    _check("version", snapshot.version, __version__)
    state = _Unpickler(io.BytesIO(snapshot.content), snapshot.floorplan).load()
    env.floorplan, env._cells = snapshot.floorplan, snapshot.floorplan.cells()
    for name, value in state.items():
        setattr(env, name, value)


def _check(what: str, of_snapshot: str, own: str) -> None:
    if of_snapshot != own:
        raise ConfigError(
            f"the snapshot was taken with {what} {of_snapshot}, this environment has {own}: restore it with the same"
        )
