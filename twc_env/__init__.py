"""twc_env: multi-robot exploration with cooperative SLAM inside every step.

    import twc_env
    env = twc_env.parallel_env(map="twin-01", robots=3)

The standard tasks (`twc/Explore-v0` and others, see `twc_env.tasks`) are registered with PettingZoo (parallel and AEC)
and, for one robot, with Gymnasium. Heavy dependencies are imported only when an environment is created.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from importlib import import_module
from os import PathLike
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from twc_env.running import command_start

if command_start.is_loading():  # before anything that takes long to read
    command_start.end_when_interrupted()

import gymnasium
import pettingzoo

from twc_env._version import __version__
from twc_env.running.clone import find_folders_of_clone
from twc_env.running.moved_modules import name_moved_modules
from twc_env.tasks import TASKS, task_config

if TYPE_CHECKING:
    from twc_env.config import EnvConfig
    from twc_env.errors import ActionError, ConfigError, DataError, MapError, TwcError
    from twc_env.exploration.assessment.evaluation import EpisodeResult
    from twc_env.exploration.environment import ExplorationEnv
    from twc_env.exploration.trace import EpisodeTrace
    from twc_env.maps import load_map, map_names
    from twc_env.slam.engine import CooperativeSlam
    from twc_env.world.building.floorplan import Floorplan

Arguments = ParamSpec("Arguments")
Returned = TypeVar("Returned")

__all__ = [
    "TASKS",
    "ActionError",
    "ConfigError",
    "CooperativeSlam",
    "DataError",
    "EnvConfig",
    "EpisodeResult",
    "EpisodeTrace",
    "ExplorationEnv",
    "MapError",
    "TwcError",
    "__version__",
    "env",
    "load_map",
    "map_names",
    "parallel_env",
    "raw_env",
    "task_config",
]

_HOME = {
    "ActionError": "errors",
    "ConfigError": "errors",
    "CooperativeSlam": "slam.engine",
    "DataError": "errors",
    "EnvConfig": "config",
    "EpisodeResult": "exploration.assessment.evaluation",
    "EpisodeTrace": "exploration.trace",
    "ExplorationEnv": "exploration.environment",
    "MapError": "errors",
    "TwcError": "errors",
    "load_map": "maps",
    "map_names": "maps",
}

_SUBMODULES = ("agents", "config", "datasets", "metrics", "planning", "vector")
"""Imported when they are first asked for, as `twc_env.metrics`."""


def __dir__() -> list[str]:
    return [*__all__, *_SUBMODULES]


def __getattr__(name: str) -> Any:
    if name in _SUBMODULES:
        return import_module(f"twc_env.{name}")
    if name in _HOME:
        return getattr(import_module(f"twc_env.{_HOME[name]}"), name)
    raise AttributeError(f"module 'twc_env' has no attribute {name!r}")


def parallel_env(
    map: str | PathLike[str] | None = None,
    robots: int | None = None,
    max_cycles: int | None = None,
    config: EnvConfig | Mapping[str, Any] | None = None,
    render_mode: str | None = None,
    floorplan: Floorplan | None = None,
    task: str | None = None,
    render_signal: bool = False,
    **unknown: Any,
) -> ExplorationEnv:
    """The environment under PettingZoo's parallel API; `help(twc_env.ExplorationEnv)` describes it.

    Args:
        map: name of a bundled or generated map, a set of buildings, or a file. Default: that of the settings.
        robots: number of robots.
        max_cycles: time steps after which an episode is truncated.
        config: an EnvConfig, or a dict of settings, such as {"action.kind": "frontier"}. `twc-env settings` lists all.
        render_mode: "human" opens a window, "rgb_array" makes `render()` return an image.
        floorplan: a floor plan made in memory, in place of `map`.
        task: a standard task, such as "twc/ExploreOffice-v1", to which the other arguments apply.
        render_signal: whether pictures overlay WiFi signal strength.
        unknown: refused, with the argument that was probably meant.

    Raises:
        ConfigError: a setting is unknown or out of its range.
        MapError: the map cannot be loaded.
    """
    from twc_env.exploration.environment import ExplorationEnv

    return ExplorationEnv(
        map, robots, max_cycles, config, render_mode, floorplan, task, render_signal=render_signal, **unknown
    )


def _with_arguments_of(
    function: Callable[Arguments, Any],
) -> Callable[[Callable[..., Returned]], Callable[Arguments, Returned]]:
    """A decorator: type checkers, editors and `help` see the arguments of another function."""

    def show(own: Callable[..., Returned]) -> Callable[Arguments, Returned]:
        shown = inspect.signature(function).replace(return_annotation=own.__annotations__["return"])
        own.__signature__ = shown  # type: ignore[attr-defined]
        return own

    return show


@_with_arguments_of(parallel_env)
def raw_env(*args: Any, **kwargs: Any) -> pettingzoo.AECEnv:
    """The environment under PettingZoo's AEC API, without checking the call order; arguments as of `parallel_env`."""
    from twc_env.exploration.turns import TurnsEnv

    return TurnsEnv(parallel_env(*args, **kwargs))


@_with_arguments_of(parallel_env)
def env(*args: Any, **kwargs: Any) -> pettingzoo.AECEnv:
    """The environment under PettingZoo's AEC API; arguments as of `parallel_env`."""
    from pettingzoo.utils import OrderEnforcingWrapper

    return OrderEnforcingWrapper(raw_env(*args, **kwargs))


def _register() -> None:
    for task in TASKS:
        if task in gymnasium.registry:
            continue
        pettingzoo.register("parallel", task, entry_point="twc_env:parallel_env", kwargs={"task": task})
        pettingzoo.register("aec", task, entry_point="twc_env:env", kwargs={"task": task})
        gymnasium.register(task, entry_point="twc_env.exploration.single_agent:SingleRobotEnv", kwargs={"task": task})


find_folders_of_clone()
name_moved_modules()
_register()
