"""Config fields with allowed values, and their validation."""

from __future__ import annotations

import dataclasses
import difflib
import inspect
import math
import os
import typing
from collections.abc import Callable, Iterable, Iterator
from dataclasses import field
from typing import Any

import numpy as np

from twc_env.errors import ArgumentError, ConfigError, did_you_mean
from twc_env.records.class_file import is_in_file

_BITS_MAX = 1000
"""Bits of whole numbers; a floating-point number reaches 1,024."""


def is_too_great(value: int) -> bool:
    """Whether a whole number is greater than any floating-point number, or close to it."""
    return value.bit_length() > _BITS_MAX


def number(default, minimum: float = -math.inf, maximum: float = math.inf, *, is_later: bool = False):
    """A numeric field with its allowed range (inclusive). is_later: as `later`."""
    return field(default=default, metadata={"minimum": minimum, "maximum": maximum, "is_later": is_later})


def later(default: Any):
    """A field added after digests were published: at its default, which changes nothing, the digest leaves it out."""
    return field(default=default, metadata={"is_later": True})


KINDS = {
    int: "a whole number", float: "a number", str: "text", bool: "true or false", dict: "a table of settings",
}  # fmt: skip
"""Types of values, for messages."""


def plain_value(value):
    """numpy scalars as Python numbers, paths as strings."""
    if isinstance(value, np.generic):
        return value.item()
    return os.fspath(value) if isinstance(value, os.PathLike) else value


def whole_number(name: str, value, least: int, most: float = math.inf) -> int:
    """The argument as an int. Raises ConfigError if it is no integer from `least` to `most`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not least <= value <= most:
        limits = f"of at least {least}" if most == math.inf else f"from {least} to {most}"
        raise ConfigError(f"{name} must be a whole number {limits}; got {value!r:.100}")
    return int(value)


def refuse_arguments(unknown: Iterable[str], function: Callable) -> None:
    """Raise ArgumentError for unknown keyword arguments of a function, with the most similar known one."""
    for name in unknown:
        given = inspect.signature(function).parameters.values()
        known = [argument.name for argument in given if argument.kind != argument.VAR_KEYWORD]
        near = difflib.get_close_matches(name, known, n=1)
        hint = f"did you mean {near[0]}?" if near else "settings go into config, as in config={'lidar.beam_count': 90}"
        raise ArgumentError(f"unexpected keyword argument {name!r}; known are {', '.join(known)}: {hint}")


def choice(default: str, *others: str, or_class: bool = False, is_later: bool = False):
    """A field with a fixed list of names; or_class: also a user's class, FILE.py:CLASS; is_later: as `later`."""
    return field(default=default, metadata={"choices": (default, *others), "or_class": or_class, "is_later": is_later})


def choices_of(setting: dataclasses.Field) -> str:
    """Text of the allowed values of a field made by `choice`."""
    return ", ".join(setting.metadata["choices"]) + (" or FILE.py:CLASS" if setting.metadata["or_class"] else "")


_SECTION_NAMES: dict[type, str] = {}
"""Dotted names of the sections, for messages; see `name_sections`."""


class Checked:
    """Base of config sections: checks each field against its declared range or list. Raises ConfigError."""

    __slots__ = ()

    def __post_init__(self) -> None:
        for f in dataclasses.fields(self):  # type: ignore[arg-type]
            value = plain_value(given := getattr(self, f.name))
            if value is not given:
                object.__setattr__(self, f.name, value)
            section = type(f.default) if dataclasses.is_dataclass(f.default) else f.default_factory
            if isinstance(section, type) and issubclass(section, Checked) and not isinstance(value, section):
                remedy = "`twc_env.config.from_dict` makes a config of tables"
                raise ConfigError(f"{self._name(f)} must be a {section.__name__}; got {value!r}: {remedy}")
            if (choices := f.metadata.get("choices")) and not (isinstance(value, str) and value in choices):
                if f.metadata["or_class"] and is_in_file(str(value)):
                    continue
                hint = did_you_mean(value, choices)
                raise ConfigError(f"{self._name(f)} must be one of {choices_of(f)}; got {value!r}{hint}")
            if type(f.default) in (bool, str) and type(value) is not type(f.default):
                raise ConfigError(f"{self._name(f)} must be {KINDS[type(f.default)]}; got {value!r}")
            if "minimum" in f.metadata:
                low, high = f.metadata["minimum"], f.metadata["maximum"]
                if isinstance(value, bool) or not isinstance(value, (int, float)):
                    raise ConfigError(f"{self._name(f)} must be a number; got {value!r}")
                if isinstance(value, int) and is_too_great(value):
                    digits = int(value.bit_length() * math.log10(2.0)) + 1
                    raise ConfigError(
                        f"{self._name(f)} must be a number of at most 300 digits; got one of about {digits}"
                    )
                if not low <= value <= high:
                    raise ConfigError(f"{self._name(f)} must lie in [{low:g}, {high:g}]; got {value!r}")

    def _name(self, setting: dataclasses.Field) -> str:
        """Dotted name of the field, such as slam.local_map.resolution_m."""
        return f"{_SECTION_NAMES.get(type(self), '')}.{setting.name}".lstrip(".")


def name_sections(cls: type) -> None:
    """Let messages call the sections of this config by their dotted names."""
    for name, section in sections_of(cls):
        _SECTION_NAMES.setdefault(section, name)


def sections_of(cls: type, name: str = "") -> Iterator[tuple[str, type]]:
    """Dotted names and classes of a section and its subsections."""
    yield name, cls
    for key, kind in typing.get_type_hints(cls).items():
        if dataclasses.is_dataclass(kind) and isinstance(kind, type):
            yield from sections_of(kind, f"{name}.{key}".lstrip("."))
