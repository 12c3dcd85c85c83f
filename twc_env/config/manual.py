"""Settings as TOML with comments: description, allowed values and value of each."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import json
import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
from operator import attrgetter
from typing import Any

from twc_env.config.checks import choices_of, sections_of
from twc_env.config.environment import EnvConfig
from twc_env.config.lidar_presets import LIDAR_PRESETS
from twc_env.config.radio_presets import RADIO_PRESETS
from twc_env.config.robot_presets import ROBOT_PRESETS, TEAM_PRESETS
from twc_env.config.values import world_of
from twc_env.config.world_presets import WORLD_PLACES, WORLD_PRESETS
from twc_env.errors import ConfigError, did_you_mean

_WIDTH = 118
_IN_SECTIONS: dict[str, dict[str, dict]] = {"lidar": LIDAR_PRESETS, "radio": RADIO_PRESETS}
"""Sections with presets, of which the first is the default."""
_HOW = '"#name = value" is a setting that has its default: take the # away to change it.'


def as_toml(config: EnvConfig, sections: Sequence[str] = ()) -> str:
    """The settings as TOML for `load`: those that have their default are commented out, so that presets in the file
    may set them; the others are marked.

    sections: dotted names of the sections to show, such as "slam.merging" (default: all), or of PRESETS, which are
    explained in comments. Raises ConfigError for an unknown section.
    """
    names = [name for name, _ in sections_of(EnvConfig)]  # "" for EnvConfig itself
    for name in sections:
        if name not in names and name not in PRESETS:
            hint = did_you_mean(name, [*names, *PRESETS])
            hint = hint or f"; sections are {', '.join(names[1:])}, and presets of {', '.join(PRESETS)}"
            raise ConfigError(f"there is no section {name!r} among the settings{hint}")
    chosen = [name for name in names if not sections or any(f"{name}.".startswith(f"{part}.") for part in sections)]
    texts = [_commented([_HOW])]
    texts += [] if sections else [_commented([*_worlds(config), "`twc-env settings world` tells what each sets."])]
    texts += [_commented(PRESETS[name](config)) for name in sections if name in PRESETS]
    texts += [_text(name, _section(config, name), _section(EnvConfig(), name)) for name in chosen]
    return "\n\n".join(texts) + "\n"


def _commented(lines: Sequence[str]) -> str:
    return "\n".join(
        "\n".join(textwrap.wrap(line, _WIDTH, initial_indent="# ", subsequent_indent="#     ")) for line in lines
    )


def _worlds(config: EnvConfig, told: Callable[[str], list[str]] = lambda name: []) -> list[str]:
    """Lines on the worlds, each followed by what is `told` of it."""
    lines = [
        'A world composes effects of reality: world = "NAME" as the first line of a file, --set world=NAME in a '
        "command. It is none of the settings but sets those that it names and that are not set beside it. Its numbers "
        "of people and of furniture are for about 800 m2.",
        f"Most settings here are of {world_of(config)!r}.",
    ]
    for name, place in WORLD_PLACES.items():
        lines += [f"{name}: {place}", *told(name)]
    return lines


def _settings_of(preset: Mapping[str, Any]) -> list[str]:
    return [f"    {key} = {json.dumps(value)}" for key, value in preset.items()]


def _world(config: EnvConfig) -> list[str]:
    return _worlds(config, lambda name: _settings_of(WORLD_PRESETS[name]))


def _robots(_: EnvConfig) -> list[str]:
    lines = ["Presets of single robots, for the setting robot, as in --set 'robot=handheld, wheeled'; what each sets:"]
    for name, preset in ROBOT_PRESETS.items():
        lines += [name, *_settings_of(preset)]
    return lines


def _teams(_: EnvConfig) -> list[str]:
    lines = [f"--set team=NAME, or robots by name: {', '.join(ROBOT_PRESETS)} (`twc-env settings robot`)"]
    return lines + [f"{name}: {', '.join(robots)}" for name, robots in TEAM_PRESETS.items()]


PRESETS: dict[str, Callable[[EnvConfig], list[str]]] = {"world": _world, "robot": _robots, "team": _teams}
"""Short forms of several settings, and the lines that explain each."""


def _section(config: EnvConfig, name: str) -> Any:
    return attrgetter(name)(config) if name else config


def _text(name: str, values: Any, defaults: Any) -> str:
    summary = " ".join((type(values).__doc__ or "").split())
    lines = [f"# {line}" for line in textwrap.wrap(summary, _WIDTH)]
    lines += [f"[{name}]"] if name else []
    if presets := _IN_SECTIONS.get(name):
        lines.append(f"{f'#preset = {json.dumps(next(iter(presets)))}':<36}  # one of {', '.join(presets)}")
    docs = _field_docs(type(values))
    for field in dataclasses.fields(values):
        value, default = getattr(values, field.name), getattr(defaults, field.name)
        if dataclasses.is_dataclass(value):
            continue
        lines += [f"# {line}" for line in textwrap.wrap(docs.get(field.name, ""), _WIDTH)]
        sign, default_text = ("#", "") if value == default else ("", f"; default {_plain(default)}")
        lines.append(f"{sign}{field.name} = {_plain(value)}".ljust(36) + f"  # {_allowed(field, value)}{default_text}")
    return "\n".join(lines)


def _plain(value: Any) -> str:
    """A value in TOML; the tables of robots on one line."""
    if not isinstance(value, tuple):
        return json.dumps(value)
    tables = [", ".join(f"{json.dumps(key)} = {json.dumps(own)}" for key, own in robot) for robot in value]
    return f"[{', '.join(f'{{ {table} }}' for table in tables)}]"


def _allowed(field: dataclasses.Field, value: Any) -> str:
    if "choices" in field.metadata:
        return "one of " + choices_of(field)
    if isinstance(value, tuple):
        return "one preset or table for each robot"
    if "minimum" not in field.metadata:
        return "true or false" if isinstance(value, bool) else "text"
    low, high = field.metadata["minimum"], field.metadata["maximum"]
    kind = "whole number" if isinstance(value, int) else "number"
    return kind if math.isinf(low) and math.isinf(high) else f"{kind} from {_short(low)} to {_short(high)}"


def _short(limit: float) -> str:
    return f"{limit:,.0f}" if limit == round(limit) else f"{limit:.6g}"


def _field_docs(section: type) -> dict[str, str]:
    """Docstring below each field of a section."""
    body = ast.parse(textwrap.dedent(inspect.getsource(section))).body[0]
    assert isinstance(body, ast.ClassDef)
    found = {}
    for field, below in zip(body.body, body.body[1:], strict=False):
        is_text = isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant)
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and is_text:
            found[field.target.id] = " ".join(str(below.value.value).split())  # type: ignore[attr-defined]
    return found
