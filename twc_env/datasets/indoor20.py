"""Phone traces of the indoor-location-competition-20 (Microsoft, XYZ10; MIT): surveyed waypoints and WiFi scans."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from twc_env.datasets.fingerprints import RadioSurvey, from_rows
from twc_env.datasets.text_file import read_text
from twc_env.errors import DataError

FRESH_S = 4.0
"""Rows of a scan that were really heard this recently; the rest are the phone's memory."""


def read_indoor20(folder: str | Path, age_max_s: float = FRESH_S, traces_max: int | None = None) -> RadioSurvey:
    """All traces of one floor folder. Scans lie where the walker was, by interpolation between the waypoints.

    Readings older than `age_max_s` are left out (infinity keeps all).

    Raises DataError for a folder without traces and for broken lines.
    """
    paths = sorted((Path(folder) / "traces").glob("*.txt*"))[:traces_max]
    if not paths:
        raise DataError(f"{folder} holds no traces/*.txt.xz; check the path")
    parts = [part for number, path in enumerate(paths) if (part := _trace(path, number, age_max_s)) is not None]
    if not parts:
        raise DataError(f"no trace of {folder} holds a WiFi scan between waypoints; check the folder")
    scan, places, times, walks, rssi, age, high = (np.concatenate([p[k] for p in parts]) for k in range(7))
    addresses = [address for part in parts for address in part[7]]
    survey = from_rows(f"indoor20/{Path(folder).name}", scan, places, times, walks, addresses, rssi, age)
    is_high = dict(zip(addresses, high.tolist(), strict=True))
    return dataclasses.replace(survey, is_high_band=np.array([is_high[a] for a in survey.addresses]))


def _trace(path: Path, number: int, age_max_s: float):
    """The readings of one file as columns; None when it has no scan between its waypoints."""
    waypoints, readings = [], []
    try:
        for line in read_text(path).splitlines():
            if "\tTYPE_WAYPOINT\t" in line:
                time_ms, _, x, y = line.split("\t")[:4]
                waypoints.append((float(time_ms), float(x), float(y)))
            elif "\tTYPE_WIFI\t" in line:
                time_ms, _, _, bssid, rssi, mhz, seen_ms = line.split("\t")[:7]
                readings.append((float(time_ms), float(rssi), float(mhz), float(seen_ms), bssid))
    except ValueError as error:
        raise DataError(f"{path.name}: {error}; fetch the trace again") from error
    if len(waypoints) < 2 or not readings:
        return None
    route = np.array(waypoints)
    values = np.array([r[:4] for r in readings])
    inside = (values[:, 0] >= route[0, 0]) & (values[:, 0] <= route[-1, 0])
    kept = inside & (values[:, 0] - values[:, 3] <= 1000 * age_max_s)
    if not kept.any():
        return None
    values, addresses = values[kept], [r[4] for r, keep in zip(readings, kept, strict=True) if keep]
    places = np.column_stack([np.interp(values[:, 0], route[:, 0], route[:, k]) for k in (1, 2)])
    # Times are unix milliseconds; the walk's number keeps scans of two phones at one moment apart.
    time_ms, rssi, mhz, seen_ms = values.T
    scan, walk = time_ms + number * 1e13, np.full(len(values), number)
    return scan, places, time_ms / 1000, walk, rssi, (time_ms - seen_ms) / 1000, mhz > 4000, addresses
