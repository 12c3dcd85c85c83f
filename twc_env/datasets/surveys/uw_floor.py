"""The WiFi-SLAM log of one floor by a robot (Ferris and Fox, University of Washington)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twc_env.datasets.surveys.fingerprints import RadioSurvey, from_rows, numbered_words, numbers
from twc_env.errors import DataError


def read_uw_floor(path: str | Path) -> RadioSurvey:
    """The survey of a file of lines `unix_s MAC x_m y_m rss_dBm`, one per reading; readings of one time are one scan.

    Raises DataError, which names the line, where one is short or holds no numbers.
    """
    path = Path(path)
    rows, lines = numbered_words(path, separator=None)
    for k, row in zip(lines, rows, strict=True):
        if len(row) < 5:
            raise DataError(f"{path}, line {k}: expected time, MAC, x, y and strength; got {len(row)} values")
    values = numbers([[row[0], *row[2:5]] for row in rows], lines, path)
    time_s, places_m, rssi_dbm = values[:, 0], values[:, 1:3], values[:, 3]
    return from_rows(
        "uw_floor", time_s, places_m, time_s, np.zeros(len(values), int), [row[1] for row in rows], rssi_dbm
    )
