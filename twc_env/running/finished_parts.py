"""Results of the parts of a long computation, kept on disk, so that an interrupted computation can continue.

A result is reused only if it was computed with the same settings by the same code.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from twc_env._version import __version__
from twc_env.errors import UNFIT, DataError
from twc_env.records.json_values import check_folder, plain
from twc_env.records.whole_file import write_text

SUFFIXES = (".py", ".json")
"""Files that determine results: code, measured tables and bundled maps."""


_MISSING = object()


@cache
def code_digest(*packages: str) -> str:
    """Digest (eight hex digits) of all code and bundled data of twc_env and of the given packages."""
    from twc_env.maps import bundled_folder  # slow to import

    folders = [Path(place) for name in ("twc_env", *packages) for place in _places(name)]
    content = hashlib.sha256()
    for folder in [*folders, bundled_folder()]:
        for path in sorted(path for path in folder.rglob("*") if path.suffix in SUFFIXES and path.is_file()):
            content.update(f"{path.relative_to(folder).as_posix()}\n".encode() + path.read_bytes())
    return content.hexdigest()[:8]


def _places(package: str) -> Iterable[str]:
    spec = find_spec(package)
    if spec is None or spec.submodule_search_locations is None:
        raise DataError(f"there is no package {package!r}, so nothing says which code computed a part")
    return spec.submodule_search_locations


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


class FinishedParts:
    """A folder of finished parts of one computation, with one set of settings and one version of the code: a JSON
    file each, with its checksum.

    Raises DataError, before anything is computed, if the folder cannot be written to.
    """

    def __init__(self, folder: Path, name: str, settings: Any, packages: tuple[str, ...] = ()):
        text = json.dumps(plain(settings), sort_keys=True, default=str)
        stem = f"{name}-{__version__}-{hashlib.sha256(text.encode()).hexdigest()[:12]}"
        self.folder = folder / f"{stem}-{code_digest(*packages)}"
        check_folder(folder)
        self.of_other_code = sum(
            1 for other in folder.glob(f"{stem}-*") if other != self.folder for _ in other.glob("*.json")
        )
        """Number of parts with the same settings that other code computed; they are not reused."""

    @property
    def remark(self) -> str | None:
        """A sentence about parts that are not reused; None if there are none."""
        if not self.of_other_code:
            return None
        return f"{self.of_other_code} finished parts were computed by other code and are not taken; they are run again"

    def once(self, key: str, work: Callable[[], Any]) -> Any:
        """The result of `work()` as JSON returns it; read from disk if an earlier run finished this part."""
        found = self.find(key, _MISSING)
        return self.keep(key, work()) if found is _MISSING else found

    def find(self, key: str, default: Any = None) -> Any:
        """The result of a part that is finished; the default if it is missing, incomplete or not as it was written."""
        try:
            kept = json.loads(self._path(key).read_text(encoding="utf-8"))
            return kept["result"] if kept["sha256"] == _sha256(json.dumps(kept["result"])) else default
        except (OSError, LookupError, *UNFIT):
            return default

    def keep(self, key: str, result: Any) -> Any:
        """Write the result of a part; returns it as JSON does. Raises DataError if it cannot be written."""
        text = json.dumps(plain(result))
        write_text(self._path(key), f'{{"sha256": "{_sha256(text)}", "result": {text}}}')
        return json.loads(text)

    def _path(self, key: str) -> Path:
        return self.folder / (hashlib.sha256(key.encode()).hexdigest()[:16] + ".json")
