"""The config of an environment, from a task, overrides and the constructor's shortcuts."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from functools import lru_cache
from os import PathLike
from typing import Any

from twc_env.config import EnvConfig, from_dict, override
from twc_env.config.remarks import remarks_on
from twc_env.errors import ConfigError
from twc_env.tasks import TASKS, task_config

_log = logging.getLogger(__name__)


def resolve(
    settings: EnvConfig | Mapping[str, Any] | None, task: str | None, shortcuts: Mapping[str, Any]
) -> EnvConfig:
    """One config from an EnvConfig, or from overrides (nested or dotted) of a task or of the defaults; then shortcuts
    that are not None replace its values.

    Raises ConfigError for invalid settings and for settings that exclude each other; logs, once per process, which do
    nothing beside the others.
    """
    config = _base(settings, task)
    if config is None:
        resolved = EnvConfig()
    elif isinstance(config, EnvConfig):
        resolved = config
    elif isinstance(config, Mapping):
        if wrong := [key for key in config if not isinstance(key, str)]:
            raise ConfigError(f"settings are named by text, such as 'lidar.beam_count'; got {wrong[0]!r}")
        nested = {key: value for key, value in config.items() if "." not in key}
        dotted = {key: value for key, value in config.items() if "." in key}
        again = {key: value for key, value in nested.items() if f"{key}.preset" in dotted}  # goes before the preset
        resolved = override(from_dict(nested), again | dotted)
    else:
        hint = ": twc_env.config.load reads a file" if isinstance(config, (str, PathLike)) else ""
        raise ConfigError(f"config must be an EnvConfig or a dict of settings; got {config!r}{hint}")
    resolved = override(resolved, {key: value for key, value in shortcuts.items() if value is not None})
    if resolved.slam.oracle == "poses":
        resolved = override(resolved, {"odometry.drift": 0.0})
    seen, chooses = resolved.observation, resolved.action.kind == "frontier"
    if seen.gains and not (seen.frontiers or chooses):
        raise ConfigError("observation.gains has a number for each of observation.frontiers: set that to true, too")
    if resolved.slam.mode == "off" and resolved.action.kind != "velocity":
        raise ConfigError(
            f"action.kind = {resolved.action.kind!r} is planned on the map, and slam.mode = 'off' has none: "
            "take action.kind = 'velocity'"
        )
    for remark in remarks_on(resolved):
        _warn(remark)
    return resolved


@lru_cache
def _warn(remark: str) -> None:
    _log.warning("%s", remark)


def _base(config: EnvConfig | Mapping[str, Any] | None, task: str | None) -> EnvConfig | Mapping[str, Any] | None:
    """The settings of a standard task with the overrides in `config`; an EnvConfig must contain the task's settings."""
    if task is None:
        return config
    if isinstance(config, EnvConfig):
        if task_config(task) != config and override(config, TASKS[task]) != config:
            raise ConfigError(f"config has other settings than {task}: give what differs from the task as a dict")
        return config
    return override(task_config(task), {} if config is None else config)
