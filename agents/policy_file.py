"""A team policy of one's own, in a file: FILE.py:CLASS wherever an agent is named.

The class takes an `EnvConfig` and has the methods of `agents.Policy`; who derives from that needs `act` only.
"""

from __future__ import annotations

import hashlib
import importlib.util
import sys
from functools import cache
from pathlib import Path
from typing import Any

from twc_env.errors import ConfigError

METHODS = ("reset", "act", "finished")


def is_in_file(agent: str) -> bool:
    """Whether an agent's name is that of a file and a class in it."""
    return ".py:" in agent


def policy_class(agent: str) -> Any:
    """The class that FILE.py:CLASS names. What the file itself raises goes through.

    Raises ConfigError where there is no such file, or no such class in it, or a method is missing.
    """
    path, name = _file_of(agent)
    found = getattr(_module(path), name, None)
    if not isinstance(found, type):
        classes = [key for key, value in vars(_module(path)).items() if _is_policy(value) and key != "Policy"]
        known = f"; it has {', '.join(classes)}" if classes else ""
        raise ConfigError(f"there is no class {name!r} in {path}{known}")
    missing = [method for method in METHODS if not callable(getattr(found, method, None))]
    if missing:
        raise ConfigError(
            f"{agent} has no {' and no '.join(missing)}(): derive it from agents.Policy, or add what lacks"
        )
    return found


def digest_of(agent: str) -> str:
    """Eight hex digits that change with the file and with any Python file beside it, which it may import."""
    content = hashlib.sha256()
    for path in sorted(_file_of(agent)[0].parent.glob("*.py")):
        content.update(f"{path.name}\n".encode() + path.read_bytes())
    return content.hexdigest()[:8]


def _file_of(agent: str) -> tuple[Path, str]:
    file, _, name = agent.rpartition(":")
    path = Path(file).resolve()
    if not path.is_file():
        raise ConfigError(f"there is no file {file} to take agent {name!r} from")
    return path, name


@cache
def _module(path: Path) -> Any:
    """The file as a module, read once; it may import what lies beside it, as a script may."""
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))
    spec = importlib.util.spec_from_file_location(f"agent_in_{path.stem}", path)
    assert spec is not None and spec.loader is not None
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _is_policy(value: Any) -> bool:
    return isinstance(value, type) and all(callable(getattr(value, method, None)) for method in METHODS)
