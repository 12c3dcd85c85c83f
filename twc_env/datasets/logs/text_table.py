"""Tables of text (CSV) whose columns are found by name, also in tables of other programs."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Collection, Sequence
from operator import methodcaller
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.datasets.logs.column_units import (
    UNIT_NAMES,
    UNITS,
    Span,
    is_since_begin,
    name_and_unit,
    part_of_second,
    time_unit,
)
from twc_env.datasets.logs.text_file import read_text
from twc_env.datasets.logs.written_times import is_time_of_day, written_times_s
from twc_env.errors import DataError

_NAMES = {
    "time": (
        "time", "t", "stamp", "timestamp", "headerstamp", "ts", "unix", "unixtime", "epoch", "datetime", "date", "sec",
        "secs", "clock",
    ),
    "address": ("bssid", "mac", "ap", "address", "macaddress", "addr", "transmitter", "beacon", "accesspoint"),
    "strength": ("rssi", "level", "rss", "signal", "strength", "signalstrength", "power", "dbm", "signallevel"),
    "robot": ("robot", "robotid", "agent", "namespace", "vehicle"),
    "text": ("text", "label", "sign", "ocr", "reading", "content", "string", "name"),
    "bearing": ("bearing", "angle", "azimuth", "direction", "theta", "bearingangle"),
    "range": ("range", "distance", "dist", "r", "depth"),
}  # fmt: skip
"""Names of columns in other tables, without units, spaces and underscores."""
_SEPARATORS = ";\t|,"
"""Of those that are equally frequent the first counts: beside it, commas are decimal ones."""
_NUMBER = re.compile(r"([+-]?[\d.,]+(?:e[+-]?\d+)?)\s*(dbm|m|rad|deg|°)", re.IGNORECASE)
"""A number with its unit in the cell."""
_MAC = re.compile(r"[0-9a-fA-F]{2}([:-])(?:[0-9a-fA-F]{2}\1){4}[0-9a-fA-F]{2}")
_DIGITS_MAX = 40
"""Characters of a number."""
CELLS_MAX = 10_000_000
"""Cells of a table, all rows together."""


class TextTable:
    """The columns of a text table."""

    def __init__(self, path: str | Path, needed: Sequence[str]):
        self._path = path
        self.notes: list[str] = []
        """What was assumed or left out, one line each."""
        self._numbers: list[int] = []
        """Line of each row in the file."""
        text = read_text(path, errors="replace")
        if "\x00" in text:
            raise DataError(f"{path} is no table of text; give one with the columns {', '.join(needed)}")
        lines = _without_comments(re.split("\r\n?|\n", text.lstrip("\ufeff")))  # a text may hold other separators
        first = next((line for line in lines if line.strip()), "")
        separator = max(_SEPARATORS, key=first.count)
        if separator not in first and len(first.split()) >= len(needed):
            separator, lines = " ", [" ".join(line.split()) for line in lines]
        cells = sum(map(methodcaller("count", separator), lines)) + len(lines)
        if cells > CELLS_MAX:
            raise DataError(f"{path} has {cells} cells, {CELLS_MAX} are possible; cut it into parts")
        rows = self._cells("\n".join(lines), separator)
        if '"' in text and any("\n" in cell for row in rows for cell in row):  # of quotes that are not closed, too
            rows = self._cells("\n".join(lines), separator, is_strict=True)
        if not rows:
            raise DataError(f"{path} is empty; a table has the columns {', '.join(needed)}")
        self._decimal_comma = separator == ";"
        self._units: dict[str, str] = {}
        self._check_widths(rows)
        rows = _with_dates(self._with_whole_stamps(rows))
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
        width = max(self._columns.values())
        for number, row in zip(self._numbers, rows, strict=True):
            if len(row) <= width:
                raise DataError(f"{path}, row {number}: {len(row)} columns, expected {width + 1}; fix or delete it")
        self._rows = rows

    def _cells(self, text: str, separator: str, is_strict: bool = False) -> list[list[str]]:
        """The cells of each row that is not empty."""
        reader = csv.reader(io.StringIO(text), delimiter=separator, strict=is_strict)
        rows, self._numbers = [], []
        try:
            for row in reader:
                if any(map(str.strip, row)):
                    rows.append(row)
                    self._numbers.append(reader.line_num)
            return rows
        except csv.Error as error:
            told = f"{self._path} is no table of text: row {reader.line_num}: {error}"
            raise DataError(f"{told}; separate columns by commas, and close every quote") from error

    def _check_widths(self, rows: Sequence[Sequence[str]]) -> None:
        """Refuse rows with more cells than the first: a separator in a text would move all that follows."""
        width = len(rows[0])
        for number, row in zip(self._numbers, rows, strict=True):
            if len(row) > width and any(map(str.strip, row[width:])):
                raise DataError(
                    f"{self._path}, row {number}: {len(row)} columns, the first row has {len(rows[0])}; put texts that "
                    "hold a separator in quotes"
                )

    def _with_whole_stamps(self, rows: list[list[str]]) -> list[list[str]]:
        """Rows with the time in one column, of a table with one of whole seconds and one of nanoseconds beyond them;
        other tables as they are. Raises DataError for rows that have no such time."""
        at = _column_of(rows[0], "time")
        found = None if at is None else part_of_second(rows[0], at)
        if at is None or found is None:
            return rows
        part, unit_s = found
        self.notes.append(f"{self._path}: {rows[0][part].strip()} are added to {rows[0][at].strip()}")
        joined = [[*rows[0][:at], "time_s", *rows[0][at + 1 :]]]
        for number, row in zip(self._numbers[1:], rows[1:], strict=True):
            cells = [row[k].strip() if k < len(row) else "" for k in (at, part)]
            try:
                whole_s, beyond_s = float(cells[0]), float(cells[1]) * unit_s
            except ValueError:
                whole_s = beyond_s = math.nan
            if not (whole_s.is_integer() and 0.0 <= beyond_s < 1.0):
                raise DataError(
                    f"{self._path}, row {number}: {rows[0][at].strip()} and {rows[0][part].strip()} must be whole "
                    f"seconds and the rest below one second; got {' and '.join(cell[:30] for cell in cells)!r}; fix or "
                    "delete it"
                )
            joined.append([*row[:at], f"{whole_s + beyond_s:.9f}", *row[at + 1 :]])
        return joined

    def _one_per_reading(self, rows: list[list[str]], needed: Sequence[str]) -> list[list[str]]:
        """Rows of one reading each, of a table with a column per transmitter; other tables as they are."""
        at = [k for k, cell in enumerate(rows[0]) if _MAC.fullmatch(cell.strip())]
        if "address" not in needed or not at or not self._found(rows[0], "time"):
            return rows
        self.notes.append(f"{self._path}: {len(at)} columns, one per transmitter")
        # Columns of the address and strength there are the receiver's own address, or a storey.
        own_names = [name for name in (*needed, "robot") if name not in ("address", "strength")]
        others = [k for name in own_names if (k := _column_of(rows[0], name, at)) is not None]
        long, numbers = [[*(rows[0][k] for k in others), "address", "strength"]], self._numbers[:1]
        for number, row in zip(self._numbers[1:], rows[1:], strict=True):
            own = [row[k] if k < len(row) else "" for k in others]
            read = [[*own, rows[0][k], row[k]] for k in at if k < len(row) and row[k].strip()]
            long += read
            numbers += [number] * len(read)
        self._numbers = numbers
        return long

    def _found(self, header: Sequence[str], name: str) -> bool:
        return any(name_and_unit(cell)[0] in _NAMES[name] for cell in header)

    def _header(self, header: Sequence[str], needed: Sequence[str]) -> dict[str, int] | None:
        """The number of each column; None if one that is needed has no name."""
        columns: dict[str, int] = {}
        for name in (*needed, "robot"):
            at = _column_of(header, name, columns.values())
            if at is not None:
                columns[name] = at
                if unit := name_and_unit(header[at])[1]:
                    self._units[name] = unit
        return columns if all(name in columns for name in needed) else None

    def column(self, name: str) -> list[str]:
        """The cells of a column."""
        at = (self._columns or {})[name]
        return [row[at] for row in self._rows]

    def numbers(self, name: str, missing: float | None = None) -> Array:
        """A column as numbers; an empty cell is `missing`, or an error. Notes the unit that its cells tell."""
        if (plain := _plain_numbers(self.column(name))) is not None:
            self._take_unit(name, set())
            return plain
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
            if not math.isfinite(number) or len(word) > _DIGITS_MAX:
                raise DataError(f"{self._path}, row {k}: {name} must be a number; got {cell[:30]!r}; fix or delete it")
            values.append(number)
            units.add(with_unit[2].lower() if with_unit else "")
        self._take_unit(name, units)
        return np.array(values)

    def _take_unit(self, name: str, of_cells: set[str]) -> None:
        """The unit of a column that its header or its cells tell. Raises DataError for several."""
        told = {UNIT_NAMES.get(unit, unit) for unit in (*of_cells, self._units.get(name, "")) if unit}
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
            times_s, has_zones = written_times_s(cells, self._numbers, span.units.get("date"), self._path)
            if not has_zones:
                self.notes.append(f"{self._path}: times without a time zone are taken for UTC")
            remedy = "put both on one clock, or name the time zone, as in 2026-05-01T12:00:00+02:00"
        else:
            times_s, unit = self.in_unit("time", "time", span, lambda values: time_unit(values, span))
            self.notes.append(f"{self._path}: times in {unit}")
            if is_since_begin(times_s, span):
                self.notes.append(f"{self._path}: times from {times_s.min():g} s are taken as since the log began")
                times_s = times_s + span.begin_s
            remedy = "put both on one clock, or give --units time=ms or another"
        if len(times_s) and not (times_s.min() <= span.end_s + 1.0 and times_s.max() >= span.begin_s - 1.0):
            raise DataError(
                f"{self._path}: times are {_moments(times_s.min(), times_s.max())}, those of the log "
                f"{_moments(span.begin_s, span.end_s)}; {remedy}"
            )
        return times_s

    def name_left_out(self, times_s: Array, span: Span) -> None:
        """Note how many rows are before or after the log."""
        if odd := int((~is_within(times_s, span)).sum()):
            self.notes.append(f"{self._path}: {odd} readings before or after the log left out")

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


def is_header(line: str, needed: Sequence[str]) -> bool:
    """Whether a line names these columns of a table, or transmitters in place of their address and strength."""
    words = _words(line.strip().lstrip("#% "))
    names = {name_and_unit(word)[0] for word in words}
    if any(_MAC.fullmatch(word) for word in words):
        names |= {"address", "strength"}
    return all(names.intersection(_NAMES[name]) for name in needed)


def _with_dates(rows: list[list[str]]) -> list[list[str]]:
    """Rows with date and time of day in one column, of a table with one of each; other tables as they are."""
    day = next((k for k, cell in enumerate(rows[0]) if name_and_unit(cell)[0] == "date"), None)
    at = None if day is None else _column_of(rows[0], "time", {day})
    if day is None or at is None or len(rows) < 2 or max(day, at) >= len(rows[1]):
        return rows
    if ":" in rows[1][day] or not is_time_of_day(rows[1][at]):
        return rows
    joined = [[*rows[0][:at], "time", *rows[0][at + 1 :]]]
    for row in rows[1:]:
        date, clock = (row[k].strip() if k < len(row) else "" for k in (day, at))
        joined.append([*row[:at], f"{date} {clock}" if date and clock else clock, *row[at + 1 :]])
    return joined


def _column_of(header: Sequence[str], name: str, taken: Collection[int] = ()) -> int | None:
    """The first column of a name, by the order of its aliases, that is not taken; None if there is none."""
    names = [name_and_unit(cell)[0] if k not in taken else None for k, cell in enumerate(header)]
    return next((names.index(alias) for alias in _NAMES[name] if alias in names), None)


def _without_comments(lines: Sequence[str]) -> list[str]:
    """Lines with empty ones for comments before the table; a header may be one (`# time, bssid, rssi`, `%time,...`), if
    none follows."""
    begin = next((k for k, line in enumerate(lines) if line.strip() and line.lstrip()[0] not in "#%"), len(lines))
    head, *rest = (line.lstrip("#% \t") for line in (*lines[max(begin - 1, 0) : begin + 1], ""))
    if begin and _names_time(head) and not _names_time(rest[0]):
        return [*[""] * (begin - 1), head, *lines[begin:]]
    return [*[""] * begin, *lines[begin:]]


def _words(line: str) -> list[str]:
    return re.split(rf"[{_SEPARATORS}\s]+", line)


def _names_time(line: str) -> bool:
    """Whether a line may be a header with a time; one with numbers, as in "every 5 sec", is none."""
    words = _words(line)
    return not any(map(_is_number, words)) and any(name_and_unit(word)[0] in _NAMES["time"] for word in words)


def _moments(first_s: float, last_s: float) -> str:
    return f"{first_s:.1f} to {last_s:.1f} s"


def _plain_numbers(cells: Sequence[str]) -> Array | None:
    """Cells as numbers, if each is finite and nothing else, such as a decimal comma or a unit, is in it."""
    try:
        values = np.array(list(map(float, cells)))
    except ValueError:
        return None
    return values if np.isfinite(values).all() and max(map(len, cells), default=0) <= _DIGITS_MAX else None


def _is_number(cell: str) -> bool:
    try:
        return math.isfinite(float(cell))
    except ValueError:
        return False


def is_within(times_s: Array, span: Span) -> Array:
    """(k,) bool: whether times are those of the log, to a second."""
    return (times_s >= span.begin_s - 1.0) & (times_s <= span.end_s + 1.0)
