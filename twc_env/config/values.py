"""Conversion of configs from and to plain values, files and dotted keys; unknown keys and wrong types are rejected."""

from __future__ import annotations

import codecs
import dataclasses
import hashlib
import json
import re
import tomllib
import typing
from collections.abc import Mapping
from functools import cache, lru_cache, reduce
from pathlib import Path
from typing import Any

from twc_env.config.checks import KINDS, is_too_great, plain_value
from twc_env.config.environment import EnvConfig
from twc_env.config.lidar_presets import LIDAR_PRESETS
from twc_env.config.radio_presets import RADIO_PRESETS
from twc_env.config.robots import overrides_of, team_of
from twc_env.config.world import LidarConfig, RadioConfig
from twc_env.config.world_presets import WORLD_PRESETS
from twc_env.errors import ConfigError, did_you_mean, one_of
from twc_env.records.class_file import is_in_file
from twc_env.records.input_file import input_path
from twc_env.records.json_values import table_of


@cache
def _types_of(cls: type) -> dict[str, Any]:
    return typing.get_type_hints(cls)


def radio_preset(name: str) -> RadioConfig:
    """Radio settings for one type of place. Raises ConfigError for an unknown name."""
    return _preset(RadioConfig, name)


def lidar_preset(name: str) -> LidarConfig:
    """Settings of one model of laser scanner. Raises ConfigError for an unknown name."""
    return _preset(LidarConfig, name)


_PRESETS: dict[type, tuple[str, dict[str, dict]]] = {
    RadioConfig: ("radio", RADIO_PRESETS),
    LidarConfig: ("lidar", LIDAR_PRESETS),
}
"""Sections with presets: their names, and the differences of each preset from the defaults."""


def _preset(section: type, name: str):
    where, known = _PRESETS[section]
    if not isinstance(name, str) or name not in known:
        names = ", ".join(known)
        raise ConfigError(f"{where}.preset must be one of {names}; got {name!r}{did_you_mean(name, known)}")
    return from_dict(known[name], section, where)


def world_preset(name: str) -> EnvConfig:
    """The default settings with the effects of reality in one type of place. Raises ConfigError for an unknown name."""
    if not isinstance(name, str) or name not in WORLD_PRESETS:
        known = ", ".join(WORLD_PRESETS)
        raise ConfigError(f"world must be one of {known}; got {name!r}{did_you_mean(name, WORLD_PRESETS)}")
    return override(EnvConfig(), WORLD_PRESETS[name])


@lru_cache(maxsize=16)
def digest(config: EnvConfig) -> str:
    """Twelve hex digits (SHA-256) of all values, without those of `checks.later` that have their default."""
    told = _told(config)
    for (*sections, key), value in RETIRED.items():
        reduce(dict.__getitem__, sections, told)[key] = value
    text = json.dumps(told, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def _told(section) -> dict:
    """Nested plain values that the digest covers."""
    told = {}
    for field in dataclasses.fields(section):
        value = getattr(section, field.name)
        if dataclasses.is_dataclass(value):
            is_unused = field.metadata.get("is_later") and value == typing.cast(type, type(value))()
            if not is_unused and (own := _told(value)):  # a section of later settings only is left out as a whole
                told[field.name] = own
        elif not (field.metadata.get("is_later") and value == field.default):
            told[field.name] = value
    return told


def to_dict(config: EnvConfig) -> dict:
    """Nested plain values for JSON; inverse of `from_dict`."""
    values = dataclasses.asdict(config)
    values["robot"] = [dict(own) for own in config.robot]
    return values


def code_named_in(config: Any) -> dict[str, str]:
    """Dotted settings that name a class in a Python file, FILE.py:CLASS, and their values."""
    found: dict[str, str] = {}
    for setting in dataclasses.fields(config):
        value = getattr(config, setting.name)
        if dataclasses.is_dataclass(value):
            found |= {f"{setting.name}.{key}": name for key, name in code_named_in(value).items()}
        elif setting.metadata.get("or_class") and is_in_file(str(value)):
            found[setting.name] = value
    return found


def from_dict(values: dict, cls: type = EnvConfig, where: str = ""):
    """Build a (nested) config from plain values; missing ones keep their default.

    where: dotted name of the section, for errors. Raises ConfigError for an unknown key (with the most similar known
    one), a wrong type or a value out of range.
    """
    if not isinstance(values, dict):
        raise ConfigError(f"{where or 'a config'} must be a table of settings; got {values!r}")
    types = _types_of(cls)
    arguments: dict = {}
    if cls is EnvConfig and "robot" in values and "team" in values:
        raise ConfigError("robot and team both say which robots there are: give one of them")
    if cls is EnvConfig and ("robot" in values or "team" in values):
        values = _with_robots(values, values)
    if cls is EnvConfig and "world" in values:
        values = dict(values)
        world = str(values.pop("world"))
        preset = to_dict(world_preset(world))
        _refuse_idle(f"world = {world!r}", preset, to_dict(EnvConfig()), values)
        for section, presets in _PRESETS.values():
            if isinstance(values.get(section), dict) and "preset" in values[section]:
                preset[section] = _of_the_place(world, section, presets)
        values = _merged(preset, values)
    if cls in _PRESETS and "preset" in values:
        values = dict(values)
        name = values.pop("preset")
        preset = dataclasses.asdict(_preset(cls, name))
        _refuse_idle(f"{where or _PRESETS[cls][0]}.preset = {name!r}", preset, dataclasses.asdict(cls()), values)
        values = _merged(preset, values)
    for key, value in values.items():
        name = f"{where}.{key}" if where else str(key)
        if key not in types:
            retired = tuple(name.split("."))
            if retired in RETIRED and value == RETIRED[retired]:
                continue
            if "." in str(key):
                table = str(key).partition(".")[0]
                raise ConfigError(f"there is no setting {name} here: write a table {table!r} for what follows the dot")
            raise ConfigError(f"there is no setting {name}{_near(key, types, cls is EnvConfig)}")
        is_done = cls is EnvConfig and key == "robot"
        arguments[key] = value if is_done else _value(types[key], value, name)
    return cls(**arguments)


def _refuse_idle(preset: str, whole: Mapping, usual: Mapping, given: Mapping) -> None:
    """Raise ConfigError for a preset all of whose settings are given beside it, and not all as it has them."""
    before, beside = dotted_keys(usual), dotted_keys(given)
    own = {key: value for key, value in dotted_keys(whole).items() if value != before[key]}
    if own and all(key in beside for key in own) and any(beside[key] != value for key, value in own.items()):
        raise ConfigError(
            f"{preset} changes nothing: each setting that it has ({', '.join(list(own)[:3])}, ...) is given beside it, "
            "and goes before it; leave out those, or the preset"
        )


def _of_the_place(world: str, where: str, presets: Mapping[str, dict]) -> dict[str, object]:
    """What a world sets in a section beside all that presets of the section speak of: no data sheet of a scanner knows
    how much glass returns, or what gets lost in a building, so another scanner leaves it."""
    spoken_of = {f"{where}.{name}" for name in {"preset"}.union(*presets.values())}
    own = {key: value for key, value in WORLD_PRESETS[world].items() if key not in spoken_of}
    return {key.removeprefix(f"{where}."): own[key] for key in own if key.startswith(f"{where}.")}


def _with_robots(values: dict, given: Mapping[str, object]) -> dict:
    """The values with `robot` in full, from `team` or `robot` among those given; a list of robots without their number
    tells it."""
    values = dict(values)
    values.pop("team", None)
    values["robot"] = team_of(given["team"]) if "team" in given else overrides_of(given["robot"])
    if values["robot"] and "robots" not in given:
        values["robots"] = len(values["robot"])
    return values


def load(path: str | Path) -> EnvConfig:
    """Read a TOML or JSON file (or the config.json of a folder), UTF-8; missing values keep their default.

    Files whose names end in .json are JSON, all others TOML. Raises ConfigError if the file is unreadable or invalid.
    """
    path = input_path(path)
    if path.is_dir():
        if not (path / "config.json").is_file():
            raise ConfigError(f"{path} is a folder without config.json: name a run folder, or {_FILE}")
        path = input_path(path / "config.json")
    text = _text_of(path)
    kind = "JSON" if path.suffix.lower() == ".json" else "TOML"
    if kind == "TOML" and any(part.count(".") > _DOTS_MAX for part in re.split(r"[=,\[\]{}\n]", text)):
        raise ConfigError(f"{path} has a key with more than {_DOTS_MAX} dots; settings are {_FILE}")
    try:
        values = json.loads(text, object_pairs_hook=table_of) if kind == "JSON" else tomllib.loads(text)
    except RecursionError as error:
        raise ConfigError(f"{path} nests its values too deeply; settings are {_FILE}") from error
    except ValueError as error:
        hint = (
            ": it looks like JSON, whose name must end in .json" if kind == "TOML" and text.lstrip()[0] in "{[" else ""
        )
        raise ConfigError(f"{path} is not valid {kind}: {error}{hint or '; correct it there'}") from error
    try:
        return from_dict(values)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None


_BYTES_MAX, _DOTS_MAX = 1_000_000, 200
"""Bytes of a file of settings and dots of its keys, whose reading takes a time that grows with their square."""
_FILE = "a .toml or .json file such as `twc-env settings > mine.toml` writes"


def _text_of(path: Path) -> str:
    """Text of a config file without a byte order mark. Raises ConfigError."""
    if path.suffix.lower() in (".yaml", ".yml"):
        raise ConfigError(f"{path} is YAML by its name; settings are {_FILE}")
    try:
        with path.open("rb") as file:
            raw = file.read(_BYTES_MAX + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"cannot read the config file {path}: {reason}; name {_FILE}") from error
    if len(raw) > _BYTES_MAX:
        raise ConfigError(f"{path} holds more than {_BYTES_MAX // 1000} kB; settings are {_FILE}")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        coding = "UTF-16 text" if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else "not UTF-8 text"
        raise ConfigError(f"{path} is {coding}; save it as UTF-8") from error
    if "\x00" in text:
        raise ConfigError(f"{path} holds null characters, as UTF-16 text does; save it as UTF-8")
    if not text.strip():
        raise ConfigError(
            f"{path} is empty; without a file all settings have their defaults, with one they are {_FILE}"
        )
    return text


def override(config: EnvConfig, assignments: Mapping[str, object]) -> EnvConfig:
    """A copy with dotted keys replaced: `override(config, {"lidar.beam_count": 360})`, or nested ones, which leave the
    other settings of their section as they are.

    Strings are converted to the type of the field, as for command lines. `world` (`world_preset`) is applied first: it
    changes the settings of its effects, and those of the world that the config has (`world_of`), only; `team`
    (`robots.team_of`) is short for `robot` and their number, and of a mixed team fewer `robots` are its first ones;
    then `radio.preset` and `lidar.preset`, which leave nothing of what the world says about their section but what no
    preset speaks of (glass, and returns lost at random); then the others.
    Raises ConfigError for an unknown key or an invalid value.
    """
    if not isinstance(assignments, Mapping) or not all(isinstance(key, str) for key in assignments):
        raise ConfigError(f"settings must be a dict with names as keys, such as {{'robots': 2}}; got {assignments!r}")
    if not isinstance(config, EnvConfig):
        raise ConfigError(f"config must be an EnvConfig, which from_dict makes of a dict; got {config!r:.100}")
    values, assignments = to_dict(config), dotted_keys(assignments)
    if "world" in assignments:
        name = str(assignments.pop("world"))
        world_preset(name)  # refuses unknown names
        values = _left(values, _world_in(values))
        effects = dict(WORLD_PRESETS[name])
        for where, presets in _PRESETS.values():
            if f"{where}.preset" in assignments:
                kept = {f"{where}.{key}": value for key, value in _of_the_place(name, where, presets).items()}
                effects = {k: v for k, v in effects.items() if not k.startswith(f"{where}.")} | kept
        assignments = effects | assignments
    if "robot" in assignments and "team" in assignments:
        raise ConfigError("robot and team both say which robots there are: give one of them")
    if "robot" in assignments or "team" in assignments:
        values = _with_robots(values, assignments)
        assignments = {key: value for key, value in assignments.items() if key not in ("robot", "team")}
    elif values["robot"] and str(assignments.get("robots", "")).isdecimal():
        values["robot"] = values["robot"][: int(str(assignments["robots"]))]
    for section, (where, presets) in _PRESETS.items():
        if f"{where}.preset" in assignments:
            place = _of_the_place(_world_in(values), where, presets)
            kept = {key: value for key, value in place.items() if values[where][key] == value}
            values[where] = dataclasses.asdict(_preset(section, str(assignments.pop(f"{where}.preset")))) | kept
    for dotted, value in assignments.items():
        node, parts = values, dotted.split(".")
        for depth, part in enumerate(parts):
            if not isinstance(node, dict) or part not in node:
                name = ".".join(parts[: depth + 1])
                if not isinstance(node, dict):
                    raise ConfigError(f"there is no setting {name}: {'.'.join(parts[:depth])} is one value, no table")
                whole = [key for key in dotted_keys(values) if key.endswith(f".{dotted}")]  # without its section
                hint = f"; did you mean {' or '.join(whole[:3])}?" if whole else _near(part, node, depth == 0)
                raise ConfigError(f"there is no setting {name}{hint}")
            if depth < len(parts) - 1:
                node = node[part]
        if isinstance(value, Mapping) and isinstance(node[parts[-1]], dict):  # empty
            continue
        node[parts[-1]] = _from_text(value, node[parts[-1]], dotted)
    return from_dict(values)


def dotted_keys(settings: Mapping, prefix: str = "") -> dict[str, object]:
    """Nested settings with dotted keys; an empty table stays one, so that its name is checked."""
    flat: dict[str, object] = {}
    for key, value in settings.items():
        is_nested = isinstance(value, Mapping) and value
        flat |= dotted_keys(value, f"{prefix}{key}.") if is_nested else {f"{prefix}{key}": value}
    return flat


def world_of(config: EnvConfig) -> str:
    """The world more than half of whose settings the config has; "clean" if there is none."""
    return _world_in(to_dict(config))


def _world_in(values: Mapping[str, Any]) -> str:
    shares = {
        name: sum(_has(values, key, value) for key, value in preset.items()) / len(preset)
        for name, preset in WORLD_PRESETS.items()
        if preset
    }
    best = max(shares, key=lambda name: shares[name])
    return best if shares[best] > _MOST else "clean"


_MOST = 0.5


def _has(values: Mapping[str, Any], key: str, value: object) -> bool:
    """Whether values have a setting of a world."""
    if key.endswith(".preset"):
        (section,) = (each for each, (where, _) in _PRESETS.items() if key == f"{where}.preset")
        return values[key.removesuffix(".preset")] == dataclasses.asdict(_preset(section, str(value)))
    return reduce(dict.__getitem__, key.split("."), dict(values)) == value


def _left(values: dict, world: str) -> dict:
    """The values without what they have of a world; other settings stay."""
    usual = to_dict(EnvConfig())
    for key, value in WORLD_PRESETS[world].items():
        if _has(values, key, value):
            *sections, name = key.removesuffix(".preset").split(".")
            node, other = (reduce(dict.__getitem__, sections, each) for each in (values, usual))
            node[name] = other[name]
    return values


def _value(kind: type, value, where: str):
    if dataclasses.is_dataclass(kind):
        return value if isinstance(value, kind) else from_dict(value, kind, where)
    value = plain_value(value)
    if kind is float and type(value) is int:
        return value if is_too_great(value) else float(value)  # the section refuses it
    if type(value) is not kind:
        raise ConfigError(f"{where} must be {KINDS[kind]}; got {value!r}")
    return value


def _merged(base: dict, changes: dict) -> dict:
    """`base` updated recursively with `changes`."""
    merged = dict(base)
    for key, value in changes.items():
        nested = isinstance(value, dict) and isinstance(base.get(key), dict)
        merged[key] = _merged(base[key], value) if nested else value
    return merged


def _from_text(value, old, where: str):
    if not isinstance(value, str) or isinstance(old, str):
        return value
    if isinstance(old, bool):
        if value.lower() in ("true", "false"):
            return value.lower() == "true"
        raise ConfigError(f"{where} must be true or false; got {value!r}")
    if isinstance(old, dict):
        raise ConfigError(f"{where} is a section; set one of {', '.join(f'{where}.{key}' for key in old)}")
    try:
        return type(old)(value)
    except (TypeError, ValueError):
        raise ConfigError(f"{where} must be {KINDS[type(old)]}; got {value!r}") from None


RETIRED: dict[tuple[str, ...], object] = {("slam", "place_recognition", "meets_by_wifi"): False}
"""Settings that no longer exist, with the only value that files may still give them; digests count them as before."""
RENAMED = {"mask_mates": "mask_teammates", "sightings_check": "mutual_observations_check"}
"""Settings of earlier versions and their present names."""


def _near(key, known, is_top: bool) -> str:
    """What to do instead of an unknown name; at the top there are two short forms, too."""
    if isinstance(key, str) and RENAMED.get(key) in known:
        return f": it is now {RENAMED[key]}"
    if is_top and key == "task":
        return ": twc_env.task_config(ID) gives the settings of a task, and parallel_env takes task=ID"
    if is_top and (whole := [name for name in dotted_keys(to_dict(EnvConfig())) if name.endswith(f".{key}")]):
        return f"; did you mean {' or '.join(whole[:3])}?"  # without its section
    return one_of(key, [*known, "world", "team"] if is_top else known)
