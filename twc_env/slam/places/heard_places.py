"""Fingerprints of many places in flat arrays, so that a kernel can compare any two of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twc_env.records.growing_arrays import READINGS_ROOM, grown, lazy_zeros
from twc_env.records.messages import Fingerprint


class HeardPlaces:
    """Concatenated fingerprints; that of place k has the rows `starts[k]` to `starts[k + 1] - 1`."""

    def __init__(self) -> None:
        self.macs, self.rssi_dbm = lazy_zeros((READINGS_ROOM,), np.int64), lazy_zeros((READINGS_ROOM,))
        """(room,) readings of all places, followed by spare room."""
        self.starts = np.zeros(1, np.int64)
        """(places + 1,) first row of each place."""

    def add(self, fingerprints: Sequence[Fingerprint]) -> None:
        """Append places."""
        if not fingerprints:
            return
        first = self.starts[-1]
        ends = first + np.cumsum([len(f.macs) for f in fingerprints])
        while ends[-1] > len(self.macs):
            self.macs, self.rssi_dbm = grown(self.macs), grown(self.rssi_dbm)
        self.macs[first : ends[-1]] = np.concatenate([f.macs for f in fingerprints])
        self.rssi_dbm[first : ends[-1]] = np.concatenate([f.rssi_dbm for f in fingerprints])
        self.starts = np.append(self.starts, ends)

    def __len__(self) -> int:
        return len(self.starts) - 1
