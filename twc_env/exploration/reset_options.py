"""Options of `reset`, which apply to one episode: start poses and building."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Mapping
from types import NoneType
from typing import Any

from twc_env.config import EnvConfig
from twc_env.errors import ConfigError
from twc_env.world.building.splits import drawn_from, family_of, one_of

NAMES = ("starts", "map", "split", "prior")
SETTINGS = frozenset(field.name for field in dataclasses.fields(EnvConfig)) | {"config", "task", "team", "world"}
"""Names that stand for settings of the environment."""


def read_options(options: Mapping[str, Any] | None, seed: int, config: EnvConfig) -> tuple[Any, str | None]:
    """Start poses for `World.reset`, and the name of the building; None: the environment's own.

    With a split or a set of buildings, the seed draws one. Options of other environments are ignored. Raises
    ConfigError if options are not a dict, for a misspelt name, a setting, and for a map together with a split; MapError
    for an unknown split.
    """
    if not isinstance(options, (Mapping, NoneType)):
        raise ConfigError(f"reset options must be a dict, such as {{'map': 'twin-02'}}; got {options!r}")
    options = dict(options or {})
    for unknown in options.keys() - NAMES:
        if near := difflib.get_close_matches(str(unknown).lower(), NAMES, n=1, cutoff=0.8):
            raise ConfigError(f"reset options have no {unknown!r}; did you mean {near[0]!r}?")
        if str(unknown).partition(".")[0] in SETTINGS:
            raise ConfigError(
                f"reset options have no {unknown!r}: settings hold for all episodes; make another environment with it"
            )
    if "map" in options and "split" in options:
        raise ConfigError("reset options name either a map or a split, not both")
    starts = options.get("starts", config.episode.starts)
    if "split" in options:
        return starts, drawn_from(options["split"], family_of(config.map), seed)
    building = options.get("map")
    return starts, building if building is None else one_of(str(building), seed)
