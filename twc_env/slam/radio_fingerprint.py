"""The radio signature of a place, and how alike two of them are (TWC-SLAM Eq. 7-10, repaired as in SPEC T6-T8)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twc_env.messages import Fingerprint, WifiScan

Array = NDArray

EMPTY = Fingerprint(np.zeros(0, np.int64), np.zeros(0))


def fingerprint(scans: Sequence[WifiScan], detection_min: float, std_mode: str = "population") -> Fingerprint:
    """Clipped mean strength of every transmitter heard in at least `detection_min` of the scans.

    A reading counts when it lies within one spread of the mean (TWC-SLAM Eq. 7-8). `std_mode` says what the spread is:
    "population" (1/n), "sample" (1/(n-1)) or "paper" (no division at all: then nothing is ever rejected).
    """
    if not scans:
        return EMPTY
    macs, column = np.unique(np.concatenate([scan.macs for scan in scans]), return_inverse=True)
    if len(macs) == 0:
        return EMPTY
    row = np.repeat(np.arange(len(scans)), [len(scan.macs) for scan in scans])
    level = np.zeros((len(scans), len(macs)))
    heard = np.zeros((len(scans), len(macs)), bool)
    level[row, column] = np.concatenate([scan.rssi_dbm for scan in scans])
    heard[row, column] = True
    count = heard.sum(axis=0)
    deviation = np.where(heard, level - level.sum(axis=0) / count, 0.0)
    spread_squared = (deviation**2).sum(axis=0) / _divisor(count, std_mode)
    kept = heard & (np.abs(deviation) <= np.sqrt(spread_squared) + 1e-9)
    kept |= heard & (count == 1)
    mean = (level * kept).sum(axis=0) / kept.sum(axis=0)
    often = count >= detection_min * len(scans) - 1e-9
    return Fingerprint(macs[often], mean[often])


def _divisor(count: Array, std_mode: str) -> Array:
    if std_mode == "population":
        return count
    if std_mode == "sample":
        return np.maximum(count - 1, 1)
    return np.ones_like(count)


def mac_similarity(a: Fingerprint, b: Fingerprint) -> float:
    """Shared transmitters over the larger set (TWC-SLAM Eq. 9); 0 where one side heard nothing."""
    if len(a.macs) == 0 or len(b.macs) == 0:
        return 0.0
    return _shared(a, b)[0].sum() / max(len(a.macs), len(b.macs))


def rssi_distance_db(a: Fingerprint, b: Fingerprint) -> tuple[float, int]:
    """Root of the summed squared differences over the shared transmitters [dB] (Eq. 10), and how many they are."""
    in_a, position = _shared(a, b)
    difference = a.rssi_dbm[in_a] - b.rssi_dbm[position[in_a]]
    return float(np.sqrt((difference**2).sum())), int(in_a.sum())


def rssi_similarity(distance_db: float, shared: int, tolerance_db: float) -> float:
    """min(1, tolerance / rms difference): 1 within the tolerance, falling beyond (SPEC T8); 0 with nothing shared."""
    if shared == 0:
        return 0.0
    rms = distance_db / np.sqrt(shared)
    return 1.0 if rms <= tolerance_db else float(tolerance_db / rms)


def _shared(a: Fingerprint, b: Fingerprint) -> tuple[Array, Array]:
    """For each transmitter of a: is it in b, and where."""
    position = np.minimum(np.searchsorted(b.macs, a.macs), max(len(b.macs) - 1, 0))
    return (b.macs[position] == a.macs) if len(b.macs) else np.zeros(len(a.macs), bool), position
