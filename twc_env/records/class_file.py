"""User-defined classes, named FILE.py:CLASS: agents, place recognisers and back ends."""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import os
import sys
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from twc_env.errors import ConfigError

_FOLDERS: set[Path] = set()
"""Folders of the files read so far."""
_ASIDE: dict[Path, dict[str, ModuleType]] = {}
"""Folder -> its modules by their names, while those of another folder have these names."""


def is_in_file(name: str) -> bool:
    """Whether a name has the form FILE.py:CLASS."""
    return ".py:" in name


def class_in(name: str, needed: Sequence[str], remedy: str) -> Any:
    """The class that FILE.py:CLASS names. Exceptions of the file itself are passed on.

    `needed` are the methods and attributes it must have, `remedy` the advice if one is missing. Raises ConfigError for
    a missing file, class, method or attribute.
    """
    path, own = _file_of(name)
    _enter(path.parent)
    found = getattr(_module(path), own, None)
    if not isinstance(found, type):
        values = [value for value in vars(_module(path)).values() if isinstance(value, type)]
        fit = [v.__name__ for v in values if v.__module__ == _module(path).__name__ and not _missing(v, needed)]
        known = f"; it has {', '.join(fit)}" if fit else f": {remedy}"
        raise ConfigError(f"there is no class {own!r} in {path}{known}")
    if missing := _missing(found, needed):
        raise ConfigError(f"{name} has no {' and no '.join(missing)}: {remedy}")
    return found


def check_call(told: str, how: str, function: Any, *arguments: Any) -> None:
    """Raise ConfigError, in the words `told` cannot be called `how`, if a function or class does not take arguments of
    this number."""
    try:
        inspect.signature(function).bind(*arguments)
    except TypeError as error:
        raise ConfigError(f"{told} cannot be called {how}: {error}") from error
    except ValueError:  # it tells no signature
        pass


def digest_of(name: str) -> str:
    """Digest (eight hex digits) of the file and of all Python files that it may import: those in its folder, and in the
    packages of that folder."""
    folder = _file_of(name)[0].parent
    content = hashlib.sha256()
    for path in sorted(_python_files(folder)):
        content.update(f"{path.relative_to(folder).as_posix()}\n".encode() + path.read_bytes())
    return content.hexdigest()[:8]


def is_user_file(path: Path) -> bool:
    """Whether a file lies in the folder of a class loaded so far."""
    return path.resolve().parent in _FOLDERS


def _file_of(name: str) -> tuple[Path, str]:
    file, _, own = name.rpartition(":")
    path = Path(file).resolve()
    if not path.is_file():
        raise ConfigError(f"there is no file {file} to load {own!r} from")
    return path, own


@cache
def _module(path: Path) -> Any:
    """The file as a module, loaded once; it can import the modules of its folder, as a script can."""
    place = hashlib.sha256(str(path).encode()).hexdigest()[:8]
    raw = path.read_bytes()
    if b"\0" in raw:
        raise ConfigError(f"{path} is no Python file, since it holds null characters; name another")
    try:
        importlib.util.decode_source(raw)
    except (SyntaxError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path} is no text: {error}; save it as UTF-8") from error
    spec = importlib.util.spec_from_file_location(f"class_file_{path.stem}_{place}", path)
    assert spec is not None and spec.loader is not None
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _python_files(folder: Path) -> Iterator[Path]:
    """The Python files of a folder and of its packages: folders that hold Python files and have a module's name."""
    for here, below, _ in os.walk(folder):
        yield from Path(here).glob("*.py")
        below[:] = [name for name in below if name.isidentifier() and any(Path(here, name).glob("*.py"))]


def _enter(folder: Path) -> None:
    """Let imports from now on find the modules and packages of this folder; another folder's of the same names are set
    aside until its files are used again."""
    own = {entry.stem for entry in folder.iterdir() if entry.suffix == ".py" or entry.is_dir()}
    origins = {name: _origin(name) for name in own - {__name__.partition(".")[0], "__main__"}}
    others = {name: origin for name, origin in origins.items() if origin in _FOLDERS - {folder}}
    for name in [name for name in sys.modules if name.partition(".")[0] in others]:
        _ASIDE.setdefault(others[name.partition(".")[0]], {})[name] = sys.modules.pop(name)
    sys.modules.update(_ASIDE.pop(folder, {}))
    _FOLDERS.add(folder)
    sys.path[:] = [str(folder), *(place for place in sys.path if place != str(folder))]


def _origin(name: str) -> Path | None:
    """The folder from which a module or package was imported; None if it is not loaded or built in."""
    module = sys.modules.get(name)
    places = list(getattr(module, "__path__", [])) or [getattr(module, "__file__", None)]
    return None if places[0] is None else Path(places[0]).parent


def _missing(value: type, needed: Sequence[str]) -> list[str]:
    abstract = getattr(value, "__abstractmethods__", ())
    return [part for part in needed if getattr(value, part, None) is None or part in abstract]
