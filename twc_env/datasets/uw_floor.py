"""The WiFi-SLAM log of one floor by a robot (Ferris and Fox, University of Washington)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twc_env.datasets.fingerprints import RadioSurvey, from_rows
from twc_env.datasets.text_file import read_text
from twc_env.errors import DataError


def read_uw_floor(path: str | Path) -> RadioSurvey:
    """Lines `unix_s MAC x_m y_m rss_dBm`, one per reading; readings of one time are one scan."""
    path = Path(path)
    rows = [line.split() for line in read_text(path).splitlines() if line.strip()]
    try:
        values = np.array([[row[0], row[2], row[3], row[4]] for row in rows], float)
    except (IndexError, ValueError) as error:
        raise DataError(f"{path}: {error}; expected lines of time, MAC, x, y, strength") from error
    if not len(values) or not np.isfinite(values).all():
        raise DataError(f"{path} holds no readings, or one that is not finite; fetch the file again")
    time_s, places_m, rssi_dbm = values[:, 0], values[:, 1:3], values[:, 3]
    return from_rows(
        "uw_floor", time_s, places_m, time_s, np.zeros(len(values), int), [row[1] for row in rows], rssi_dbm
    )
