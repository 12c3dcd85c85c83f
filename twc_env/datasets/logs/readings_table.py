"""WiFi and sign readings beside a log, as tables of text (CSV): columns by name, units told or recognised.

A table of WiFi has the columns time, address and strength, one row per reading; one of signs time, text, bearing and
range, as seen from the robot. A column `robot` names the robot (number, or namespace in the bag) where there are
several. Rows of equal time are one WiFi scan.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.datasets.logs.column_units import Span, angle_unit, length_unit
from twc_env.datasets.logs.text_table import TextTable, is_within
from twc_env.errors import DataError
from twc_env.records.messages import SignReading, WifiScan

WIFI_COLUMNS = ("time", "address", "strength")
SIGN_COLUMNS = ("time", "text", "bearing", "range")
_RSSI_MIN_DBM, _RSSI_MAX_DBM = -150.0, 30.0
"""Strengths outside, and 0, stand for "not heard"."""
_SCAN_S = 0.5
"""Readings within this time, each of another address, are one scan."""


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """Readings of one robot, in order of time."""

    times_s: Array
    """(k,) on the clock of the log."""
    values: tuple
    """(k) `WifiScan` or `SignReading` each."""


def read_wifi(path: str | Path, span: Span) -> tuple[list[Readings], list[str]]:
    """Scans of each robot, and notes of one line. Raises DataError for tables that cannot be told."""
    table = TextTable(path, WIFI_COLUMNS)
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
    table = TextTable(path, SIGN_COLUMNS)
    times_s, robots = table.times_s(span), table.robots(span)
    bearings, angle = table.in_unit("bearing", "angle", span, angle_unit)
    ranges_m, length = table.in_unit("range", "length", span, length_unit)
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
    inside = is_used & is_within(times_s, span)
    return [Readings(*of_robot(np.flatnonzero(inside & (robots == robot)))) for robot in range(len(span.robots))]
