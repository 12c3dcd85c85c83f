"""Radio fingerprints at known positions: the common record of all data sets, and helpers of their readers."""

from __future__ import annotations

import csv
import dataclasses
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.datasets.logs.text_file import TextLines, read_text
from twc_env.errors import DataError

NUMBER_MAX = 9e18
"""Larger numbers are no measurements; times in nanoseconds and stamps of seventeen digits are smaller."""


@dataclass(frozen=True, slots=True, eq=False)
class RadioSurvey:
    """Scans at known positions. Array dimensions are scans (s) and transmitters (t)."""

    name: str
    position_m: Array
    """(s, 2)."""
    floor: Array
    """(s,) int, floor number of the scan."""
    time_s: Array
    """(s,) time since the first scan; zeros if the set has no times."""
    walk: Array
    """(s,) int, number of the walk on which the scan was taken."""
    addresses: tuple[str, ...]
    """(t,) names of the transmitters."""
    rssi_dbm: Array
    """(s, t) float32, NaN where a scan did not hear the transmitter."""
    transmitter_m: Array | None = None
    """(t, 2) true positions, if known."""
    transmitter_floor: Array | None = None
    """(t,) int."""
    is_high_band: Array | None = None
    """(t,) bool: 5 GHz."""
    age_s: Array | None = None
    """(s, t) float32, age of each reading at the time of its scan; NaN where not heard."""
    room_kind: Array | None = None
    """(s,) int, type of room of each scan, if known."""

    def fresh(self, age_max_s: float) -> RadioSurvey:
        """The survey without readings older than this; unchanged if the set has no ages."""
        if self.age_s is None:
            return self
        young = self.age_s <= age_max_s
        rssi, age = (np.where(young, table, np.float32(np.nan)) for table in (self.rssi_dbm, self.age_s))
        return dataclasses.replace(self, rssi_dbm=rssi, age_s=age)

    def at_scans(self, chosen: Array) -> RadioSurvey:
        """The survey with a subset of the scans: their indices (k,), in this order, or a mask (scans,)."""
        told = self._told("position_m", "floor", "time_s", "walk", "rssi_dbm", "age_s", "room_kind")
        return dataclasses.replace(self, **{name: values[chosen] for name, values in told.items()})

    def of_transmitters(self, chosen: Array) -> RadioSurvey:
        """The survey with a subset of the transmitters: their indices (k,) or a mask (transmitters,)."""
        rows, tables = self._told("transmitter_m", "transmitter_floor", "is_high_band"), self._told("rssi_dbm", "age_s")
        parts = {name: values[chosen] for name, values in rows.items()}
        parts |= {name: values[:, chosen] for name, values in tables.items()}
        addresses = np.array(self.addresses, object)[chosen].tolist()
        return dataclasses.replace(self, addresses=tuple(addresses), **parts)

    def _told(self, *names: str) -> dict[str, Array]:
        """Those of these arrays that are not None."""
        return {name: values for name in names if (values := getattr(self, name)) is not None}

    @property
    def room_kinds(self) -> Array:
        """(s,) types of rooms; raises DataError if unknown."""
        if self.room_kind is None:
            raise DataError(f"survey {self.name} has no room types; use one that does")
        return self.room_kind

    @property
    def transmitters(self) -> tuple[Array, Array, Array]:
        """Positions (t, 2), floor numbers (t,) and 5 GHz flags (t,); raises DataError if unknown."""
        if self.transmitter_m is None or self.transmitter_floor is None or self.is_high_band is None:
            raise DataError(f"survey {self.name} has no transmitter positions; use one that does")
        return self.transmitter_m, self.transmitter_floor, self.is_high_band


def read_table(path: Path, columns: tuple[str, ...] = ()) -> tuple[list[str], list[list[str]], list[int]]:
    """Header, non-empty rows and their line numbers of a CSV file.

    Raises DataError if `columns` are missing or a row is incomplete.
    """
    reader = csv.reader(io.StringIO(read_text(path)))
    try:
        rows = [(reader.line_num, row) for row in reader]
    except csv.Error as error:
        raise DataError(f"{path}, line {reader.line_num}: no table: {error}; fetch the file again") from error
    header = rows[0][1] if rows else []
    if not rows or (missing := [c for c in columns if c not in header]):
        raise DataError(f"{path} lacks the columns {', '.join(columns if not rows else missing)}; fetch the file again")
    for number, row in rows[1:]:
        if row and len(row) != len(header):
            raise DataError(f"{path}, line {number}: expected {len(header)} values; got {len(row)}")
    told = [(number, row) for number, row in rows[1:] if row]
    return header, [row for _, row in told], [number for number, _ in told]


def numbered_words(path: Path, separator: str | None = ",") -> tuple[list[list[str]], list[int]]:
    """The words of the non-empty lines of a file (None: between spaces), and the numbers of these lines."""
    lines = [(k, line.strip()) for k, line in enumerate(TextLines(path), 1) if line.strip()]
    return [line.split(separator) for _, line in lines], [k for k, _ in lines]


def numbers(rows: list[list[str]], lines: Sequence[int], path: Path, filled: Sequence[int] | None = None) -> Array:
    """Rows of text, from these lines of a file, as (rows, columns) floats, empty cells as NaN.

    `filled`: the columns in which no cell may be empty; None: all. Raises DataError without rows, and naming the line
    for rows of unequal length, invalid numbers and empty cells.
    """
    if not rows:
        raise DataError(f"{path} holds no rows; fetch the file again")
    for number, row in zip(lines, rows, strict=True):
        if len(row) != len(rows[0]):
            raise DataError(f"{path}, line {number}: expected {len(rows[0])} values; got {len(row)}")
    values = np.array(
        [[_number(cell, path, number) for cell in row] for number, row in zip(lines, rows, strict=True)], float
    )
    needed = values if filled is None else values[:, filled]
    is_empty = np.isnan(needed).any(axis=1)
    if is_empty.any():
        raise DataError(f"{path}, line {lines[int(np.argmax(is_empty))]}: a value is missing; fetch the file again")
    return values


def _number(cell: str, path: Path, line: int) -> float:
    try:
        value = float(cell) if cell else math.nan
    except ValueError:
        value = math.inf
    if abs(value) > NUMBER_MAX:
        raise DataError(f"{path}, line {line}: expected a number of at most {NUMBER_MAX:g}; got {cell[:40]!r}")
    return value


def read_numbers(path: Path, columns: tuple[str, ...], filled: int | None = None) -> Array:
    """(rows, columns) the named columns of a CSV file, of which the first `filled` (None: all) have no empty cell.

    Raises DataError as from `read_table` and `numbers`.
    """
    header, rows, lines = read_table(path, columns)
    at = [header.index(name) for name in columns]
    return numbers([[row[k] for k in at] for row in rows], lines, path, range(len(at))[:filled])


def heard_only(rssi: Array) -> Array:
    """Readings [dBm] of any shape as float32, with NaN instead of those that mean "not heard", such as 100 and -105."""
    return np.where((rssi < 0) & (rssi > -105), rssi, np.nan).astype(np.float32)


def from_rows(
    name: str,
    scan: Array,
    position_m: Array,
    time_s: Array,
    walk: Array,
    address: list[str],
    rssi_dbm: Array,
    age_s: Array | None = None,
) -> RadioSurvey:
    """A survey from single readings: `scan` (readings,) is the number of the scan; the others are its position etc.

    Of several readings of one transmitter in a scan the strongest is kept.
    """
    _, first, which = np.unique(scan, return_index=True, return_inverse=True)
    addresses = sorted(set(address))
    column = {a: i for i, a in enumerate(addresses)}
    cells = (which, np.array([column[a] for a in address], int))
    # Written in rising order, so that the strongest reading of a cell is kept.
    rising = np.argsort(rssi_dbm, kind="stable")
    tables = []
    for values in (rssi_dbm, age_s):
        if values is not None:
            table = np.full((len(first), len(addresses)), np.nan, np.float32)
            table[cells[0][rising], cells[1][rising]] = values[rising]
            tables.append(table)
    return RadioSurvey(
        name=name,
        position_m=position_m[first],
        floor=np.zeros(len(first), int),
        time_s=time_s[first] - time_s[first].min(),
        walk=walk[first],
        addresses=tuple(addresses),
        rssi_dbm=tables[0],
        age_s=tables[1] if age_s is not None else None,
    )
