"""Units of the columns of a table: told by the user or the header, or recognised by their values."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import DataError

UNITS = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "angle": {"rad": 1.0, "deg": math.pi / 180.0},
    "length": {"m": 1.0, "cm": 0.01, "mm": 0.001},
    "date": {"dmy": 1.0, "mdy": 1.0},
}
"""Units of each quantity, as multiples of seconds, radians and metres; of dates, what comes first."""
UNIT_NAMES = {
    "sec": "s", "secs": "s", "second": "s", "seconds": "s", "msec": "ms", "millis": "ms", "milliseconds": "ms",
    "micros": "us", "microseconds": "us", "µs": "us", "nsec": "ns", "nanos": "ns", "nanoseconds": "ns",
    "radians": "rad", "radian": "rad", "degrees": "deg", "degree": "deg", "°": "deg", "metres": "m", "meters": "m",
    "metre": "m", "meter": "m",
}  # fmt: skip
_SECONDS = ("sec", "secs", "seconds")
_PARTS_S = (
    dict.fromkeys(("nsec", "nsecs", "nanosec", "nanosecs", "nanos", "nanoseconds"), 1e-9)
    | dict.fromkeys(("usec", "usecs", "microsec", "microsecs", "micros", "microseconds"), 1e-6)
)  # fmt: skip
"""Last words of columns beside whole seconds, and their units [s]: those of ROS stamps, and of `timeval`."""
_OF_LOG = 0.5
"""Times from 0 that cover more than this share of the log are seconds since it began."""
_EPOCHS = (("s", 1e8, 1e11), ("ms", 1e11, 1e14), ("us", 1e14, 1e17), ("ns", 1e17, 1e20))
"""Unix times of the years from 1973 to 5138 in each unit."""
_READINGS_MIN = 20
"""So many bearings that all are within a turn of 2 pi are radians."""


@dataclass(frozen=True, slots=True)
class Span:
    """What a table is read for."""

    begin_s: float
    end_s: float
    """Times of the log."""
    robots: tuple[str, ...] = ("",)
    """Names of its robots."""
    units: Mapping[str, str] = field(default_factory=dict)
    """Units that the user tells: quantity of `UNITS` -> unit."""


def name_and_unit(cell: str) -> tuple[str, str]:
    """A column's name without unit, spaces and underscores, and its unit ("" if it tells none)."""
    words = _words(cell)
    unit = ""
    if len(words) > 1:
        last = UNIT_NAMES.get(words[-1], words[-1])
        if last == "dbm" or any(last in units for units in UNITS.values()):
            unit, words = last, words[:-1]
    return "".join(words), unit


def part_of_second(header: Sequence[str], seconds: int) -> tuple[int, float] | None:
    """The column with the part of a second beyond the whole ones of a column (`stamp.secs` has `stamp.nsecs`), and its
    unit [s]; None if there is none."""
    *stem, last = _words(header[seconds]) or [""]
    if last not in _SECONDS:
        return None
    for k, cell in enumerate(header):
        *other, part = _words(cell) or [""]
        if other == stem and part in _PARTS_S:
            return k, _PARTS_S[part]
    return None


def _words(cell: str) -> list[str]:
    return [word for word in re.split(r"[\s_\-()\[\]/.:]+", cell.strip().strip("\"'").lower()) if word]


def time_unit(values: Array, span: Span) -> str | None:
    """The unit of unix times by their size, else the only one in which they meet the log."""
    if not len(values):
        return "s"
    for unit, least, most in _EPOCHS:
        if least <= values.min() and values.max() < most:
            return unit
    meets = [
        unit for unit, factor in UNITS["time"].items()
        if values.min() * factor <= span.end_s and values.max() * factor >= span.begin_s
    ]  # fmt: skip
    if not meets and is_since_begin(values, span):
        return "s"
    return meets[0] if len(meets) == 1 else None


def is_since_begin(times_s: Array, span: Span) -> bool:
    """Whether times that miss a log on another clock are since its begin: from about 0, and of its length."""
    if not len(times_s) or times_s.max() >= span.begin_s - 1.0:
        return False
    log_s = span.end_s - span.begin_s
    return bool(times_s.min() >= -1.0 and _OF_LOG * log_s <= times_s.max() <= log_s + 1.0)


def angle_unit(values: Array) -> str | None:
    """The unit of bearings: degrees beyond a turn of 2 pi; None for a few within it."""
    if len(values) and np.abs(values).max() > 2.0 * math.pi + 1e-6:
        return "deg"
    return "rad" if len(values) >= _READINGS_MIN or not np.any(values) else None


def length_unit(values: Array) -> str | None:
    """By the median: signs are read from 0.3 to 15 m away."""
    middle = float(np.median(values)) if len(values) else 1.0
    bands = (("m", 0.0, 15.0), ("cm", 100.0, 500.0), ("mm", 1500.0, math.inf))
    return next((unit for unit, least, most in bands if least <= middle <= most), None)


def unit_choices(texts: Sequence[str]) -> dict[str, str]:
    """`QUANTITY=UNIT` texts of the command line. Raises DataError for others."""
    chosen = {}
    for text in itertools.chain.from_iterable(each.split(",") for each in texts):
        quantity, _, unit = text.partition("=")
        if unit not in UNITS.get(quantity, {}):
            known = ", ".join(f"{key}={'|'.join(units)}" for key, units in UNITS.items())
            raise DataError(f"--units takes {known}; got {text!r}")
        chosen[quantity] = unit
    return chosen
