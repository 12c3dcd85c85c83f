"""Statistics of fingerprint differences at one place and between places, learned from the robots' own paths."""

from __future__ import annotations

import math

import numpy as np

from twc_env.kernels.compiled import kernel
from twc_env.records.messages import Fingerprint

DIFFERENCE_MIN_DB = 0.5
"""Smaller differences are treated as this one."""
FLOOR_DBM = -90.0
"""Replaces the reading of a transmitter that only one side received."""


def radio_difference_db(a: Fingerprint, b: Fingerprint) -> float:
    """RMS difference over all transmitters that either side received, after removing the mean (device offset).

    NaN if one side is empty, or both received a single common transmitter, whose difference may be the offset. A
    transmitter that only one side received counts as the detection floor on the other.
    """
    return _radio_difference(a.macs, a.rssi_dbm, b.macs, b.rssi_dbm, FLOOR_DBM)


@kernel
def _radio_difference(macs_a, levels_a, macs_b, levels_b, floor):
    total = squares = 0.0
    i = j = count = 0
    while i < len(macs_a) or j < len(macs_b):
        if j >= len(macs_b) or (i < len(macs_a) and macs_a[i] < macs_b[j]):
            difference = max(levels_a[i] - floor, 0.0)
            i += 1
        elif i >= len(macs_a) or macs_b[j] < macs_a[i]:
            difference = -max(levels_b[j] - floor, 0.0)
            j += 1
        else:
            difference = levels_a[i] - levels_b[j]
            i += 1
            j += 1
        total += difference
        squares += difference * difference
        count += 1
    if len(macs_a) == 0 or len(macs_b) == 0 or count == 1:
        return np.nan
    return math.sqrt(max(squares / count - (total / count) ** 2, 0.0))


class RadioStatistics:
    """Distributions of the fingerprint difference at one place and between places, learned from own trajectories.

    The logarithm of the difference is modelled as normal in both cases with a common variance, so that the
    log-likelihood ratio is monotonic. Starts from a weak prior.
    """

    def __init__(self):
        self._count = np.array([10.0, 10.0])
        self._sum = self._count * np.log([4.0, 10.0])
        self._squares = 0.35**2 * self._count + self._sum**2 / self._count
        self._line: tuple[float, float] | None = None

    def learn(self, difference_db: float, is_same_place: bool) -> None:
        """Add one pair of keyframes of one robot."""
        if math.isnan(difference_db):
            return
        value = math.log(max(difference_db, DIFFERENCE_MIN_DB))
        k = 0 if is_same_place else 1
        self._count[k] += 1
        self._sum[k] += value
        self._squares[k] += value * value
        self._line = None

    def log_ratio(self, difference_db: float) -> float:
        """Log-likelihood ratio of one place against two places; 0 if unknown."""
        if math.isnan(difference_db):
            return 0.0
        if self._line is None:
            same, apart = (self._sum / self._count).tolist()
            variance = float((self._squares - self._sum**2 / self._count).sum() / self._count.sum())
            self._line = max(apart - same, 0.05) / max(variance, 0.1**2), 0.5 * (same + apart)
        slope, middle = self._line
        return slope * (middle - math.log(max(difference_db, DIFFERENCE_MIN_DB)))
