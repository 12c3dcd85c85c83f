"""WiFi and sign readings beside a log, as tables of text (CSV): columns by name, units told or recognised.

A table of WiFi has the columns time, address and strength, one row per reading; one of signs time, text, bearing and
range, as seen from the robot. A column `robot` names the robot (number, or namespace in the bag) where there are
several. Rows of equal time are one WiFi scan.
"""

from __future__ import annotations

import csv
import hashlib
import io
import itertools
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.datasets.logs.text_file import read_text
from twc_env.errors import DataError
from twc_env.records.messages import SignReading, WifiScan

UNITS = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "angle": {"rad": 1.0, "deg": math.pi / 180.0},
    "length": {"m": 1.0, "cm": 0.01, "mm": 0.001},
    "date": {"dmy": 1.0, "mdy": 1.0},
}
"""Units of each quantity, as multiples of seconds, radians and metres; of dates, what comes first."""
_UNIT_NAMES = {
    "sec": "s", "secs": "s", "second": "s", "seconds": "s", "msec": "ms", "millis": "ms", "milliseconds": "ms",
    "micros": "us", "microseconds": "us", "µs": "us", "nsec": "ns", "nanos": "ns", "nanoseconds": "ns",
    "radians": "rad", "radian": "rad", "degrees": "deg", "degree": "deg", "°": "deg", "metres": "m", "meters": "m",
    "metre": "m", "meter": "m",
}  # fmt: skip
_NAMES = {
    "time": ("time", "t", "stamp", "timestamp", "ts", "unix", "unixtime", "epoch", "datetime", "date", "secs", "clock"),
    "address": ("bssid", "mac", "ap", "address", "macaddress", "addr", "transmitter", "beacon", "accesspoint"),
    "strength": ("rssi", "level", "rss", "signal", "strength", "signalstrength", "power", "dbm", "signallevel"),
    "robot": ("robot", "robotid", "agent", "namespace", "vehicle"),
    "text": ("text", "label", "sign", "ocr", "reading", "content", "string", "name"),
    "bearing": ("bearing", "angle", "azimuth", "direction", "theta", "bearingangle"),
    "range": ("range", "distance", "dist", "r", "depth"),
}
"""Names of columns in other tables, without units, spaces and underscores."""
_SEPARATORS = ";\t|,"
"""Of those that are equally frequent the first counts: beside it, commas are decimal ones."""
_NUMBER = re.compile(r"([+-]?[\d.,]+(?:e[+-]?\d+)?)\s*(dbm|m|rad|deg|°)", re.IGNORECASE)
"""A number with its unit in the cell."""
_MAC = re.compile(r"[0-9a-fA-F]{2}([:-])(?:[0-9a-fA-F]{2}\1){4}[0-9a-fA-F]{2}")
_DATE = re.compile(
    r"(\d{1,2})([./-])(\d{1,2})\2(\d{4})[ T,]+(\d{1,2}):(\d\d)(?::(\d\d(?:[.,]\d+)?))?(?: ?([AaPp])[Mm])?"
)
"""Date with the year last, and time of day."""
_OF_LOG = 0.5
"""Times from 0 that cover more than this share of the log are seconds since it began."""
_RSSI_MIN_DBM, _RSSI_MAX_DBM = -150.0, 30.0
"""Strengths outside, and 0, stand for "not heard"."""
_SCAN_S = 0.5
"""Readings within this time, each of another address, are one scan."""
_EPOCHS = (("s", 1e8, 1e11), ("ms", 1e11, 1e14), ("us", 1e14, 1e17), ("ns", 1e17, 1e20))
"""Unix times of the years from 1973 to 5138 in each unit."""
_READINGS_MIN = 20
"""So many bearings that all are within a turn of 2 pi are radians."""
_ROWS_MAX = 20_000_000
_MONTHS = 12


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


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """Readings of one robot, in order of time."""

    times_s: Array
    """(k,) on the clock of the log."""
    values: tuple
    """(k) `WifiScan` or `SignReading` each."""


def read_wifi(path: str | Path, span: Span) -> tuple[list[Readings], list[str]]:
    """Scans of each robot, and notes of one line. Raises DataError for tables that cannot be told."""
    table = _Table(path, ("time", "address", "strength"))
    times_s, robots = table.times_s(span), table.robots(span)
    strengths = table.numbers("strength", missing=math.nan)
    table.name_left_out(times_s, span)
    cells = table.column("address")
    is_named = np.array([bool(cell.strip()) for cell in cells], bool)
    is_heard = (strengths > _RSSI_MIN_DBM) & (strengths <= _RSSI_MAX_DBM) & (strengths != 0.0)
    if len(strengths) and not (strengths[is_heard] < 0.0).any():
        raise DataError(f"{path}: no strength is below 0: give dBm, such as -67, not percent or bars")
    notes = [f"{path}: {len(strengths)} readings", *table.notes]
    if not is_heard.all():
        odd = int((~is_heard).sum())
        notes.append(f"{path}: {odd} readings without a strength, or of 0 or 100 dBm and the like, mean not heard")
    if not is_named.all():
        notes.append(f"{path}: {int((~is_named).sum())} readings without an address left out")
    macs, named = _addresses(cells)
    if named:
        notes.append(f"{path}: {named} addresses are no MAC addresses, and are taken as names")
    is_used = is_heard & is_named
    return _per_robot(times_s, robots, is_used, span, lambda rows: _scans(times_s, macs, strengths, rows)), notes


def read_signs(path: str | Path, span: Span) -> tuple[list[Readings], list[str]]:
    """Sign readings of each robot, and notes of one line. Raises DataError as above."""
    table = _Table(path, ("time", "text", "bearing", "range"))
    times_s, robots = table.times_s(span), table.robots(span)
    bearings, angle = table.in_unit("bearing", "angle", span, _angle_unit)
    ranges_m, length = table.in_unit("range", "length", span, _length_unit)
    texts = [text.strip() for text in table.column("text")]
    if (ranges_m < 0.0).any():
        raise DataError(f"{path}: a range is negative: give the distance to the sign")
    is_read = np.array([bool(text) for text in texts], bool)
    table.name_left_out(times_s, span)
    notes = [f"{path}: {len(texts)} readings, bearings in {angle}, ranges in {length}", *table.notes]
    if not is_read.all():
        notes.append(f"{path}: {int((~is_read).sum())} readings without a text left out")

    def of_robot(rows: Array) -> tuple[Array, tuple]:
        rows = rows[np.argsort(times_s[rows], kind="stable")]
        return times_s[rows], tuple(SignReading(texts[k], float(bearings[k]), float(ranges_m[k])) for k in rows)

    return _per_robot(times_s, robots, is_read, span, of_robot), notes


class _Table:
    """The columns of a text table."""

    def __init__(self, path: str | Path, needed: Sequence[str]):
        self._path = path
        self.notes: list[str] = []
        """What was assumed or left out, one line each."""
        text = read_text(path, errors="replace")
        if "\x00" in text:
            raise DataError(f"{path} is no table of text; give one with the columns {', '.join(needed)}")
        lines = _without_comments(text.lstrip("\ufeff").splitlines())
        first = next((line for line in lines if line.strip()), "")
        separator = max(_SEPARATORS, key=first.count)
        if separator not in first and len(first.split()) >= len(needed):
            separator, lines = " ", [" ".join(line.split()) for line in lines]
        found = self._cells("\n".join(lines), separator)
        if any("\n" in cell for _, row in found for cell in row):  # of quotes that are not closed, too
            found = self._cells("\n".join(lines), separator, is_strict=True)
        rows = [row for _, row in found]
        if not rows:
            raise DataError(f"{path} is empty; a table has the columns {', '.join(needed)}")
        if len(rows) > _ROWS_MAX:
            raise DataError(f"{path} has {len(rows)} rows, {_ROWS_MAX} are possible; cut it into parts")
        self._decimal_comma = separator == ";"
        self._units: dict[str, str] = {}
        self._numbers = [number for number, _ in found]
        """Line of each row in the file."""
        self._check_widths(rows)
        rows = self._one_per_reading(rows, needed)
        self._columns = self._header(rows[0], needed)
        if self._columns is not None:
            rows, self._numbers = rows[1:], self._numbers[1:]
        elif _is_number(rows[0][0].replace(",", ".")) and len(rows[0]) >= len(needed):
            self._columns = {name: k for k, name in enumerate(needed)}
            self.notes.append(f"{path}: without a header, the columns are taken for {', '.join(needed)}")
        else:
            missing = ", ".join(name for name in needed if not self._found(rows[0], name))
            raise DataError(
                f"{path}: no column for {missing} in the header {separator.join(rows[0])[:80]!r}; name the columns "
                f"{', '.join(needed)}"
            )
        width = max(self._columns[name] for name in needed)
        for number, row in zip(self._numbers, rows, strict=True):
            if len(row) <= width:
                raise DataError(f"{path}, row {number}: {len(row)} columns, expected {width + 1}; fix or delete it")
        self._rows = rows

    def _cells(self, text: str, separator: str, is_strict: bool = False) -> list[tuple[int, list[str]]]:
        """Line number and cells of each row that is not empty."""
        reader = csv.reader(io.StringIO(text), delimiter=separator, strict=is_strict)
        try:
            return [(reader.line_num, row) for row in reader if any(map(str.strip, row))]
        except csv.Error as error:
            told = f"{self._path} is no table of text: row {reader.line_num}: {error}"
            raise DataError(f"{told}; separate columns by commas, and close every quote") from error

    def _check_widths(self, rows: Sequence[Sequence[str]]) -> None:
        """Refuse rows with more cells than the first: a separator in a text would move all that follows."""
        for number, row in zip(self._numbers, rows, strict=True):
            if any(cell.strip() for cell in row[len(rows[0]) :]):
                raise DataError(
                    f"{self._path}, row {number}: {len(row)} columns, the first row has {len(rows[0])}; put texts that "
                    "hold a separator in quotes"
                )

    def _one_per_reading(self, rows: list[list[str]], needed: Sequence[str]) -> list[list[str]]:
        """Rows of one reading each, of a table with a column per transmitter; other tables as they are."""
        at = [k for k, cell in enumerate(rows[0]) if _MAC.fullmatch(cell.strip())]
        if "address" not in needed or not at or not self._found(rows[0], "time"):
            return rows
        self.notes.append(f"{self._path}: {len(at)} columns, one per transmitter")
        taken = _NAMES["address"] + _NAMES["strength"]  # there, the receiver's own address, or a storey
        others = [k for k, cell in enumerate(rows[0]) if k not in at and _plain(cell)[0] not in taken]
        long, numbers = [[*(rows[0][k] for k in others), "address", "strength"]], self._numbers[:1]
        for number, row in zip(self._numbers[1:], rows[1:], strict=True):
            own = [row[k] if k < len(row) else "" for k in others]
            read = [[*own, rows[0][k], row[k]] for k in at if k < len(row) and row[k].strip()]
            long += read
            numbers += [number] * len(read)
        self._numbers = numbers
        return long

    def _found(self, header: Sequence[str], name: str) -> bool:
        return any(_plain(cell)[0] in _NAMES[name] for cell in header)

    def _header(self, header: Sequence[str], needed: Sequence[str]) -> dict[str, int] | None:
        """The number of each column; None if one that is needed has no name."""
        columns: dict[str, int] = {}
        for name in (*needed, "robot"):
            for alias in _NAMES[name]:
                at = next(
                    (k for k, cell in enumerate(header) if _plain(cell)[0] == alias and k not in columns.values()), None
                )
                if at is not None:
                    columns[name] = at
                    if unit := _plain(header[at])[1]:
                        self._units[name] = unit
                    break
        return columns if all(name in columns for name in needed) else None

    def column(self, name: str) -> list[str]:
        """The cells of a column."""
        at = (self._columns or {})[name]
        return [row[at] for row in self._rows]

    def numbers(self, name: str, missing: float | None = None) -> Array:
        """A column as numbers; an empty cell is `missing`, or an error. Notes the unit that its cells tell."""
        values, units = [], set()
        for k, cell in zip(self._numbers, self.column(name), strict=True):
            word = cell.strip().replace(",", ".") if self._decimal_comma else cell.strip()
            if missing is not None and word.lower() in ("", "nan", "null", "none", "na"):
                values.append(missing)
                continue
            with_unit = _NUMBER.fullmatch(word)
            try:
                number = float(with_unit[1] if with_unit else word)
            except ValueError:
                number = math.nan
            if not math.isfinite(number) or len(word) > 40:
                raise DataError(f"{self._path}, row {k}: {name} must be a number; got {cell[:30]!r}; fix or delete it")
            values.append(number)
            units.add(with_unit[2].lower() if with_unit else "")
        self._take_unit(name, units)
        return np.array(values)

    def _take_unit(self, name: str, of_cells: set[str]) -> None:
        """The unit of a column that its header or its cells tell. Raises DataError for several."""
        told = {_UNIT_NAMES.get(unit, unit) for unit in (*of_cells, self._units.get(name, "")) if unit}
        if len(told) > 1:
            raise DataError(f"{self._path}: {name} is given in {' and '.join(sorted(told))}; give all in one unit")
        self._units.update((name, unit) for unit in told)

    def in_unit(self, name: str, quantity: str, span: Span, guess: Callable[[Array], str | None]) -> tuple[Array, str]:
        """A column in SI units, and its unit: as the user or the header says, else as guessed."""
        values = self.numbers(name)
        told = span.units.get(quantity) or self._units.get(name)
        unit = told if told in UNITS[quantity] else guess(values)
        if unit is None:
            known = " or ".join(f"--units {quantity}={unit}" for unit in UNITS[quantity])
            shown = f"{values.min():g} to {values.max():g}" if len(values) else "no values"
            raise DataError(f"{self._path}: the unit of {name} ({shown}) cannot be told; give {known}")
        return values * UNITS[quantity][unit], unit

    def times_s(self, span: Span) -> Array:
        """Times of the rows [s], on the clock of the log."""
        cells = self.column("time")
        if cells and not _is_number(cells[0].replace(",", ".")):
            is_day_first = self._is_day_first(cells, span)
            rows = zip(cells, self._numbers, strict=True)
            moments = [self._clock(cell, number, is_day_first) for cell, number in rows]
            if any(moment.tzinfo is None for moment in moments):
                self.notes.append(f"{self._path}: times without a time zone are taken for UTC")
            times_s = np.array([(m if m.tzinfo else m.replace(tzinfo=UTC)).timestamp() for m in moments])
            remedy = "put both on one clock, or name the time zone, as in 2026-05-01T12:00:00+02:00"
        else:
            times_s, unit = self.in_unit("time", "time", span, lambda values: _time_unit(values, span))
            self.notes.append(f"{self._path}: times in {unit}")
            if _is_since_begin(times_s, span):
                self.notes.append(f"{self._path}: times from {times_s.min():g} s are taken as since the log began")
                times_s = times_s + span.begin_s
            remedy = "put both on one clock, or give --units time=ms or another"
        if len(times_s) and not (times_s.min() <= span.end_s + 1.0 and times_s.max() >= span.begin_s - 1.0):
            raise DataError(
                f"{self._path}: times are {_moments(times_s.min(), times_s.max())}, those of the log "
                f"{_moments(span.begin_s, span.end_s)}; {remedy}"
            )
        return times_s

    def _is_day_first(self, cells: Sequence[str], span: Span) -> bool | None:
        """Whether dates such as 01/05/2026 begin with the day; None if there are none. With points they do."""
        dates = [match for match in (_DATE.fullmatch(cell.strip()) for cell in cells) if match]
        if not dates:
            return None
        if dates[0][2] == ".":
            return True
        told = span.units.get("date")
        can = {
            "dmy": all(int(date[3]) <= _MONTHS for date in dates),
            "mdy": all(int(date[1]) <= _MONTHS for date in dates),
        }
        if told is None and all(can.values()):
            shown = dates[0][0]
            raise DataError(
                f"{self._path}: the date {shown!r} can be day or month first; give --units date=dmy or --units date=mdy"
            )
        return told == "dmy" if told else can["dmy"]

    def name_left_out(self, times_s: Array, span: Span) -> None:
        """Note how many rows are before or after the log."""
        if odd := int((~_is_within(times_s, span)).sum()):
            self.notes.append(f"{self._path}: {odd} readings before or after the log left out")

    def _clock(self, cell: str, row: int, is_day_first: bool | None) -> datetime:
        """Time of ISO 8601 text, or of a date with the year last."""
        date = _DATE.fullmatch(cell.strip())
        try:
            if date and is_day_first is not None:
                return _moment(date, is_day_first)
            return datetime.fromisoformat(cell.strip().replace("/", "-"))
        except (ValueError, OverflowError) as error:
            raise DataError(
                f"{self._path}, row {row}: {cell[:40]!r} is no time; give seconds, or 2026-05-01T12:00:00.5Z"
            ) from error

    def robots(self, span: Span) -> Array:
        """(rows,) number of the robot of each row."""
        if "robot" not in (self._columns or {}):
            if len(span.robots) > 1:
                raise DataError(
                    f"{self._path} does not say which of the {len(span.robots)} robots read what: add a column robot "
                    f"(0 to {len(span.robots) - 1})"
                )
            return np.zeros(len(self._rows), int)
        if span.robots == ("",) and len({cell.strip() for cell in self.column("robot")}) == 1:
            return np.zeros(len(self._rows), int)
        known = {name: k for k, name in enumerate(span.robots) if name}
        if not any(name.isdecimal() for name in known):  # else a number is a name
            known |= {str(k): k for k in range(len(span.robots))}
        numbers = []
        for k, cell in zip(self._numbers, self.column("robot"), strict=True):
            if cell.strip().strip("/") not in known:
                raise DataError(
                    f"{self._path}, row {k}: there is no robot {cell[:30]!r}; the log has {', '.join(known)}"
                )
            numbers.append(known[cell.strip().strip("/")])
        return np.array(numbers, int)


def _without_comments(lines: Sequence[str]) -> list[str]:
    """Lines with empty ones for comments before the table; a header may be one (`# time, bssid, rssi`, `%time,...`), if
    none follows."""
    begin = next((k for k, line in enumerate(lines) if line.strip() and line.lstrip()[0] not in "#%"), len(lines))
    head, *rest = (line.lstrip("#% \t") for line in (*lines[max(begin - 1, 0) : begin + 1], ""))
    if begin and _names_time(head) and not (_names_time(rest[0]) and not any(map(_is_number, _words(rest[0])))):
        return [*[""] * (begin - 1), head, *lines[begin:]]
    return [*[""] * begin, *lines[begin:]]


def _words(line: str) -> list[str]:
    return re.split(rf"[{_SEPARATORS}\s]+", line)


def _names_time(line: str) -> bool:
    return any(_plain(word)[0] in _NAMES["time"] for word in _words(line))


def _moment(date: re.Match[str], is_day_first: bool) -> datetime:
    """Time of a match of `_DATE`."""
    first, _, second, year, hour, minute, seconds, half = date.groups()
    day, month = (first, second) if is_day_first else (second, first)
    hours = int(hour) % 12 + 12 * (half in "Pp") if half else int(hour)
    whole = datetime(int(year), int(month), int(day), hours, int(minute))
    return whole + timedelta(seconds=float((seconds or "0").replace(",", ".")))


def _moments(first_s: float, last_s: float) -> str:
    return f"{first_s:.1f} to {last_s:.1f} s"


def _is_since_begin(times_s: Array, span: Span) -> bool:
    """Whether times that miss a log on another clock are since its begin: from about 0, and of its length."""
    if not len(times_s) or times_s.max() >= span.begin_s - 1.0:
        return False
    log_s = span.end_s - span.begin_s
    return bool(times_s.min() >= -1.0 and _OF_LOG * log_s <= times_s.max() <= log_s + 1.0)


def _plain(cell: str) -> tuple[str, str]:
    """A column's name without unit, spaces and underscores, and its unit ("" if it tells none)."""
    words = [word for word in re.split(r"[\s_\-()\[\]/.:]+", cell.strip().strip("\"'").lower()) if word]
    unit = ""
    if len(words) > 1:
        last = _UNIT_NAMES.get(words[-1], words[-1])
        if last == "dbm" or any(last in units for units in UNITS.values()):
            unit, words = last, words[:-1]
    return "".join(words), unit


def _is_number(cell: str) -> bool:
    try:
        return math.isfinite(float(cell))
    except ValueError:
        return False


def _time_unit(values: Array, span: Span) -> str | None:
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
    if not meets and _is_since_begin(values, span):
        return "s"
    return meets[0] if len(meets) == 1 else None


def _angle_unit(values: Array) -> str | None:
    if len(values) and np.abs(values).max() > 2.0 * math.pi + 1e-6:
        return "deg"
    return "rad" if len(values) >= _READINGS_MIN or not np.any(values) else None


def _length_unit(values: Array) -> str | None:
    """By the median: signs are read from 0.3 to 15 m away."""
    middle = float(np.median(values)) if len(values) else 1.0
    bands = (("m", 0.0, 15.0), ("cm", 100.0, 500.0), ("mm", 1500.0, math.inf))
    return next((unit for unit, least, most in bands if least <= middle <= most), None)


def _addresses(cells: Sequence[str]) -> tuple[Array, int]:
    """(k,) int64 addresses, and how many different ones are no MAC addresses."""
    numbers, named = {}, 0
    for cell in cells:
        if cell in numbers:
            continue
        if not cell.strip():
            numbers[cell] = 0
            continue
        digits = re.sub(r"[:\-.\s]", "", cell)
        if re.fullmatch(r"[0-9a-fA-F]{12}", digits):
            numbers[cell] = int(digits, 16)
        else:
            numbers[cell] = int.from_bytes(hashlib.sha256(cell.strip().encode()).digest()[:6], "big")
            named += 1
    return np.array([numbers[cell] for cell in cells], np.int64), named


def _scans(times_s: Array, macs: Array, strengths: Array, rows: Array) -> tuple[Array, tuple]:
    """Readings of one robot as scans with ascending addresses."""
    rows = rows[np.argsort(times_s[rows], kind="stable")]
    groups: list[list[int]] = []
    heard: set[int] = set()
    for k in rows.tolist():
        begun_s = times_s[groups[-1][0]] if groups else -math.inf
        is_same = times_s[k] == begun_s or (times_s[k] - begun_s <= _SCAN_S and int(macs[k]) not in heard)
        if not is_same:
            groups.append([])
            heard = set()
        groups[-1].append(k)
        heard.add(int(macs[k]))
    return times_s[[group[-1] for group in groups]], tuple(wifi_scan(macs[g], strengths[g]) for g in groups)


def wifi_scan(macs: Array, strengths: Array) -> WifiScan:
    """A scan of readings (n,) [addresses as numbers, dBm] in any order, at least one; the strength of an address that
    is there twice is the mean."""
    addresses, place = np.unique(macs, return_inverse=True)
    return WifiScan(addresses, np.bincount(place, strengths) / np.bincount(place))


def _per_robot(
    times_s: Array, robots: Array, is_used: Array, span: Span, of_robot: Callable[[Array], tuple[Array, tuple]]
) -> list[Readings]:
    """Readings within the time of the log, for each robot."""
    inside = is_used & _is_within(times_s, span)
    return [Readings(*of_robot(np.flatnonzero(inside & (robots == robot)))) for robot in range(len(span.robots))]


def _is_within(times_s: Array, span: Span) -> Array:
    return (times_s >= span.begin_s - 1.0) & (times_s <= span.end_s + 1.0)


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
