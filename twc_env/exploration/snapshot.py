"""The complete state of an episode, to be restored later: for tree search, branching rollouts and debugging."""

from __future__ import annotations

import io
import pickle
import zlib
from dataclasses import dataclass
from typing import Any

from twc_env._version import __version__
from twc_env.config import EnvConfig, digest
from twc_env.errors import ConfigError, DataError
from twc_env.exploration.episode import Episode
from twc_env.records.whole_copy import SharingPickler
from twc_env.world.building.floorplan import Floorplan

_PLAN = "floorplan"
_DAMAGED = "the snapshot is damaged, its checksum differs: take it anew"


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """A saved state: the pickled episode without its building, and the building. Can be pickled for other processes.

    Only what the checksum confirms is ever unpickled. It guards against damage, not against somebody who wants to
    deceive: like every pickle, a snapshot of a stranger runs code of his.
    """

    config_digest: str
    version: str
    floorplan: Floorplan
    content: bytes
    checksum: int
    """Of all others, see `_checksum`."""

    def __reduce__(self) -> tuple:
        parts = pickle.dumps(tuple(getattr(self, name) for name in self.__slots__), pickle.HIGHEST_PROTOCOL)
        return _unpacked, (parts, zlib.crc32(parts))


def _unpacked(parts: bytes, checksum: int) -> Snapshot:
    """A pickled snapshot. Raises DataError if a byte of it has changed."""
    if not isinstance(parts, bytes) or zlib.crc32(parts) != checksum:
        raise DataError(_DAMAGED)
    return Snapshot(*pickle.loads(parts))


def _checksum(config_digest: str, version: str, floorplan: Floorplan, content: bytes) -> int:
    """CRC-32, which sees every change of up to 32 bits in a row."""
    named = "\n".join((config_digest, version, floorplan.digest)).encode()
    return zlib.crc32(content, zlib.crc32(named))


class _Pickler(SharingPickler):
    """Pickles an episode without its building, which never changes."""

    def __init__(self, file: io.BytesIO, floorplan: Floorplan):
        super().__init__(file, protocol=pickle.HIGHEST_PROTOCOL)
        self._floorplan = floorplan

    def persistent_id(self, value: Any) -> str | None:
        return _PLAN if value is self._floorplan else None


class _Unpickler(pickle.Unpickler):
    def __init__(self, file: io.BytesIO, floorplan: Floorplan):
        super().__init__(file)
        self._floorplan = floorplan

    def persistent_load(self, name: str) -> Floorplan:
        return self._floorplan


def take_snapshot(config: EnvConfig, episode: Episode) -> Snapshot:
    """See `ExplorationEnv.snapshot`. config: the environment's, which may name another building than the episode's."""
    buffer = io.BytesIO()
    _Pickler(buffer, episode.floorplan).dump(episode)
    parts = digest(config), __version__, episode.floorplan, buffer.getvalue()
    return Snapshot(*parts, _checksum(*parts))


def restore_snapshot(config: EnvConfig, snapshot: Snapshot) -> Episode:
    """The episode of a snapshot, see `ExplorationEnv.restore`.

    Raises ConfigError for anything else than a snapshot and for one of other settings or version, DataError for a
    damaged one.
    """
    if not isinstance(snapshot, Snapshot):
        raise ConfigError(f"restore() takes what snapshot() gave; got {type(snapshot).__name__} {snapshot!r:.60}")
    _check("configuration", snapshot.config_digest, digest(config))
    _check("version", snapshot.version, __version__)
    if _checksum(snapshot.config_digest, snapshot.version, snapshot.floorplan, snapshot.content) != snapshot.checksum:
        raise DataError(_DAMAGED)
    try:
        return _Unpickler(io.BytesIO(snapshot.content), snapshot.floorplan).load()
    except (EOFError, pickle.UnpicklingError, AttributeError, ImportError) as error:
        raise DataError(f"the snapshot is cut off or of other code ({error}): take it anew") from error


def _check(what: str, of_snapshot: str, own: str) -> None:
    if of_snapshot != own:
        raise ConfigError(
            f"the snapshot was taken with {what} {of_snapshot}, this environment has {own}: restore it with the same"
        )
