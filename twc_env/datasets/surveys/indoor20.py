"""Phone traces of the indoor-location-competition-20 (Microsoft, XYZ10; MIT): surveyed waypoints and WiFi scans."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.datasets.logs.text_file import TextLines
from twc_env.datasets.surveys.fingerprints import NUMBER_MAX, RadioSurvey, from_rows
from twc_env.errors import DataError

FRESH_S = 4.0
"""Maximum age of readings of the last sweep; older ones are from the memory of the phone."""


def read_indoor20(folder: str | Path, age_max_s: float = FRESH_S, traces_max: int | None = None) -> RadioSurvey:
    """All traces of one floor folder; positions of scans are interpolated between the waypoints.

    Readings older than `age_max_s` are left out (infinity keeps all). Raises DataError for a folder without traces and
    for invalid lines.
    """
    paths = trace_paths(folder, traces_max)
    parts = [part for number, path in enumerate(paths) if (part := _trace(path, number, age_max_s)) is not None]
    if not parts:
        raise DataError(f"no trace of {folder} holds a WiFi scan between waypoints; check the folder")
    scan, places, times, walks, rssi, age, high = (np.concatenate([p[k] for p in parts]) for k in range(7))
    addresses = [address for part in parts for address in part[7]]
    survey = from_rows(f"indoor20/{Path(folder).name}", scan, places, times, walks, addresses, rssi, age)
    is_high = dict(zip(addresses, high.tolist(), strict=True))
    return dataclasses.replace(survey, is_high_band=np.array([is_high[a] for a in survey.addresses]))


def trace_paths(folder: str | Path, traces_max: int | None = None) -> list[Path]:
    """The files of the first traces of a floor, or of all. Raises DataError if there are none."""
    paths = sorted((Path(folder) / "traces").glob("*.txt*"))[:traces_max]
    if not paths:
        raise DataError(f"{folder} holds no traces/*.txt.xz; check the path (docs/real_data.md)")
    return paths


def trace_rows(path: Path, *kinds: str) -> list[list[list[str]]]:
    """For each kind of line (such as "WIFI") the words of its lines in a trace."""
    rows: dict[str, list[list[str]]] = {f"TYPE_{kind}": [] for kind in kinds}
    for line in TextLines(path):
        words = line.split("\t")
        if len(words) > 2 and words[1] in rows:
            rows[words[1]].append(words)
    return list(rows.values())


def numbers_in(path: Path, rows: list[list[str]], *columns: int) -> Array:
    """(rows, columns) the numbers in these columns of lines of a trace.

    Raises DataError naming the first line where one is missing, not finite or too large.
    """
    try:
        values = np.array([[float(words[k]) for k in columns] for words in rows]).reshape(-1, len(columns))
        if (np.abs(values) <= NUMBER_MAX).all():
            return values
    except (ValueError, IndexError):
        pass
    faulty = next(words for words in rows if not _has_numbers(words, columns))
    line = list(TextLines(path)).index("\t".join(faulty)) + 1
    raise DataError(f"{path}, line {line}: a number of {faulty[1]} is missing or invalid; fetch the trace again")


def _has_numbers(words: list[str], columns: Sequence[int]) -> bool:
    try:
        return all(abs(float(words[k])) <= NUMBER_MAX for k in columns)
    except (ValueError, IndexError):
        return False


def _trace(path: Path, number: int, age_max_s: float):
    """The readings of one file as columns; None if it has no scan between its waypoints."""
    waypoints, readings = trace_rows(path, "WAYPOINT", "WIFI")
    route, values = numbers_in(path, waypoints, 0, 2, 3), numbers_in(path, readings, 0, 4, 5, 6)
    if len(waypoints) < 2 or not readings:
        return None
    inside = (values[:, 0] >= route[0, 0]) & (values[:, 0] <= route[-1, 0])
    kept = inside & (values[:, 0] - values[:, 3] <= 1000 * age_max_s)
    if not kept.any():
        return None
    values, addresses = values[kept], [r[3] for r, keep in zip(readings, kept, strict=True) if keep]
    places = np.column_stack([np.interp(values[:, 0], route[:, 0], route[:, k]) for k in (1, 2)])
    # Times are unix milliseconds; the number of the walk separates simultaneous scans of two phones.
    time_ms, rssi, mhz, seen_ms = values.T
    scan, walk = time_ms + number * 1e13, np.full(len(values), number)
    return scan, places, time_ms / 1000, walk, rssi, (time_ms - seen_ms) / 1000, mhz > 4000, addresses
