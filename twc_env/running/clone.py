"""In a clone, `twc_env.agents` and `twc_env.training` lie beside the package; in the wheel they are inside it."""

from __future__ import annotations

import sys
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_file_location
from pathlib import Path
from typing import Any

_CLONE = Path(__file__).parents[2]
_FOLDERS = {f"twc_env.{name}": _CLONE / name for name in ("agents", "training")}


class _FoldersOfClone(MetaPathFinder):
    """Asked last, so only if the package has no such folder of its own."""

    def find_spec(self, fullname: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        """The package in the clone; None for all other names."""
        folder = _FOLDERS.get(fullname)
        if folder is None:
            return None
        return spec_from_file_location(fullname, folder / "__init__.py", submodule_search_locations=[str(folder)])


def find_folders_of_clone() -> None:
    """From now on the two packages can be imported in a clone; does nothing in an installed package."""
    if (_CLONE / "pyproject.toml").exists() and all(folder.is_dir() for folder in _FOLDERS.values()):
        sys.meta_path.append(_FoldersOfClone())
