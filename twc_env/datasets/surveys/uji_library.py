"""UJI library, long term (Mendoza-Silva et al. 2018): twelve WiFi samples at each of 48 points between book shelves."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twc_env.datasets.surveys.fingerprints import RadioSurvey, heard_only, numbered_words, numbers
from twc_env.errors import DataError

_PART = "trn01"


def read_uji_library(folder: str | Path, month: str) -> RadioSurvey:
    """One collection of one month ("01", "13"). Raises DataError for missing or inconsistent files."""
    values = []
    paths = [Path(folder) / month / f"{_PART}{what}.csv.gz" for what in ("rss", "crd", "tms")]
    for path in paths:
        values.append(numbers(*numbered_words(path), path))
    rssi, places, times = values
    if len({len(table) for table in values}) > 1:
        told = ", ".join(f"{path.name} {len(table)}" for path, table in zip(paths, values, strict=True))
        raise DataError(f"the tables of {paths[0].parent} differ in rows ({told}); fetch the shorter ones again")
    if places.shape[1] < 3:
        raise DataError(f"{paths[1]}, line 1: expected x, y and floor; got {places.shape[1]} values")
    heard = heard_only(rssi)
    known = np.isfinite(heard).any(axis=0)
    _, point = np.unique(places, axis=0, return_inverse=True)
    return RadioSurvey(
        name=f"uji_lib/{month}",
        position_m=places[:, :2],
        floor=places[:, 2].astype(int),
        time_s=_seconds(times[:, 0]),
        walk=point,
        addresses=tuple(f"wap{i:03d}" for i in np.flatnonzero(known)),
        rssi_dbm=heard[:, known],
    )


def _seconds(stamps: np.ndarray) -> np.ndarray:
    """yyyymmddHHMMSSmmm -> seconds since the first scan, if all are from one day."""
    clock = stamps.astype(np.int64) % 10**9
    seconds = clock // 10**7 * 3600 + clock // 10**5 % 100 * 60 + clock // 10**3 % 100 + clock % 1000 / 1000
    return seconds - seconds.min()
