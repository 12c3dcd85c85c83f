"""What was heard at many places, side by side, so that a kernel can compare any two of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.messages import Fingerprint


class HeardPlaces:
    """Fingerprints one behind the other; that of place k is from `starts[k]` on and ends before `starts[k + 1]`."""

    def __init__(self) -> None:
        self.macs, self.rssi_dbm = np.zeros(0, np.int64), np.zeros(0)
        """(heard,) of all places."""
        self.starts = np.zeros(1, np.int64)
        """(places + 1,)."""

    @classmethod
    def joined(cls, parts: Sequence[HeardPlaces]) -> HeardPlaces:
        """All places of the first part, then those of the second, and so on."""
        places = cls()
        places._append([p.macs for p in parts], [p.rssi_dbm for p in parts], [np.diff(p.starts) for p in parts])
        return places

    def add(self, fingerprints: Sequence[Fingerprint]) -> None:
        """Append further places."""
        counts = np.array([len(f.macs) for f in fingerprints], np.int64)
        self._append([f.macs for f in fingerprints], [f.rssi_dbm for f in fingerprints], [counts])

    def _append(self, macs: list[Array], rssi_dbm: list[Array], counts: list[Array]) -> None:
        self.macs, self.rssi_dbm = np.concatenate([self.macs, *macs]), np.concatenate([self.rssi_dbm, *rssi_dbm])
        ends = self.starts[-1] + np.cumsum(np.concatenate(counts))
        self.starts = np.concatenate([self.starts, ends])

    def __len__(self) -> int:
        return len(self.starts) - 1
