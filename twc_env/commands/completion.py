"""What the shell completes behind an option: names of teams, maps, tasks and settings beside files."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from typing import Any

from argcomplete.completers import BaseCompleter, FilesCompleter


class Completer(BaseCompleter):
    """For argcomplete, of all options that have none of their own."""

    def __call__(self, prefix: str, action: argparse.Action, **_: Any) -> Any:
        """Values of an option that begin with `prefix`."""
        names = [name for name in _names(action.dest) if name.startswith(prefix)]
        return names + [str(path) for path in FilesCompleter()(prefix)]


def _names(option: str) -> Iterable[str]:
    if option in ("agent", "agents"):
        from twc_env.agents.roster import TEAMS

        return (*TEAMS, "learned")
    if option in ("map", "maps"):
        from twc_env.maps import map_names

        return map_names()
    if option in ("task", "tasks", "config"):
        from twc_env.tasks import TASKS

        return TASKS if option == "config" else (name.partition("/")[2] for name in TASKS)
    if option == "set":
        from twc_env.config import EnvConfig, to_dict
        from twc_env.config.values import dotted_keys

        return (f"{key}=" for key in dotted_keys(to_dict(EnvConfig())))
    return ()
