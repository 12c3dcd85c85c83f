"""How alike the strengths of two fingerprints are: readings of TWC-SLAM's Eq. 10 (papers.md T8).

In the print a distance d [dB] is compared with gamma from the wrong side: `paper` accepts d >= gamma. All others turn
d over p shared transmitters, or its root mean square d / sqrt(p), into a similarity. Only those that reach 1 for real,
noisy pairs can pass the print's gamma = 1: `saturating` (the default), `saturating-sum`, `linear` and `cosine-rounded`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.records.messages import Fingerprint

SUM_TOLERANCE_DB, LINEAR_DB, EXPONENTIAL_DB, RANGE_DB = 20.0, 10.0, 10.0, 30.0
COSINE_OFFSET_DB = 100.0
"""Levels count from so far below zero, so that a transmitter that is not heard is the weakest there is."""

BY_DISTANCE: dict[str, Callable[[Array, Array, float], Array]] = {
    "saturating": lambda d, rms, tau: np.minimum(1.0, tau / np.maximum(rms, 1e-9)),
    "linear": lambda d, rms, tau: np.clip(1.0 - np.maximum(rms - tau, 0.0) / LINEAR_DB, 0.0, 1.0),
    "saturating-sum": lambda d, rms, tau: np.minimum(1.0, SUM_TOLERANCE_DB / np.maximum(d, 1e-9)),
    "inverse": lambda d, rms, tau: 1.0 / (1.0 + d),
    "inverse-rms": lambda d, rms, tau: 1.0 / (1.0 + rms),
    "exponential": lambda d, rms, tau: np.exp(-d / EXPONENTIAL_DB),
    "range": lambda d, rms, tau: np.clip(1.0 - rms / RANGE_DB, 0.0, 1.0),
}
COSINES = {"cosine": COSINE_OFFSET_DB, "cosine-rounded": COSINE_OFFSET_DB, "cosine-raw": 0.0}
"""Mode -> offset [dB]; `cosine-rounded` keeps two decimals."""


def by_distance(mode: str, distance_db: Array, shared: Array, tolerance_db: float) -> Array:
    """(k,) similarity of distances (k,) over `shared` (k,) transmitters; 0 where nothing is shared.

    `paper` gives the distance itself, to be compared as printed.
    """
    distance_db, shared = np.asarray(distance_db, float), np.asarray(shared)
    if mode == "paper":
        return distance_db
    rms = distance_db / np.sqrt(np.maximum(shared, 1))
    return np.where(shared > 0, BY_DISTANCE[mode](distance_db, rms, tolerance_db), 0.0)


def by_cosine(mode: str, a: Fingerprint, b: Fingerprint) -> float:
    """Cosine between two fingerprints over all transmitters that either heard; 0 where one heard nothing."""
    offset_db = COSINES[mode]
    levels = [np.maximum(f.rssi_dbm + offset_db, 0.0) if offset_db else f.rssi_dbm for f in (a, b)]
    norm = np.linalg.norm(levels[0]) * np.linalg.norm(levels[1])
    if norm == 0.0:
        return 0.0
    _, in_a, in_b = np.intersect1d(a.macs, b.macs, assume_unique=True, return_indices=True)
    cosine = float(levels[0][in_a] @ levels[1][in_b] / norm)
    return round(cosine, 2) if mode == "cosine-rounded" else cosine
