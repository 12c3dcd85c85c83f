"""Fields of a config section that know what may stand in them."""

from __future__ import annotations

import dataclasses
import difflib
import math
from dataclasses import field

from twc_env.errors import ConfigError


def number(default, minimum: float = -math.inf, maximum: float = math.inf):
    """A number with its allowed range (both ends included)."""
    return field(default=default, metadata={"minimum": minimum, "maximum": maximum})


def choice(default: str, *others: str):
    """A name out of a fixed list."""
    return field(default=default, metadata={"choices": (default, *others)})


class Checked:
    """Checks each field against the range or list it was declared with."""

    __slots__ = ()

    def __post_init__(self) -> None:
        where = type(self).__name__.removesuffix("Config").lower()
        for f in dataclasses.fields(self):  # type: ignore[arg-type]
            value = getattr(self, f.name)
            if (choices := f.metadata.get("choices")) and value not in choices:
                near = difflib.get_close_matches(str(value), choices, n=1)
                hint = f"; did you mean {near[0]!r}?" if near else ""
                raise ConfigError(f"{where}.{f.name} must be one of {', '.join(choices)}; got {value!r}{hint}")
            if "minimum" in f.metadata:
                low, high = f.metadata["minimum"], f.metadata["maximum"]
                if isinstance(value, bool) or not isinstance(value, (int, float)):
                    raise ConfigError(f"{where}.{f.name} must be a number; got {value!r}")
                if not low <= value <= high:
                    raise ConfigError(f"{where}.{f.name} must lie in [{low:g}, {high:g}]; got {value!r}")
