"""Radio fingerprints of places and their similarity (TWC-SLAM Eq. 7-10, corrected as in papers.md T6-T8)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import Lent, borrowing_kernel, kernel, parts_of
from twc_env.records.messages import Fingerprint, WifiScan
from twc_env.records.team_messages import WifiScans

STD_MODES = {"population": 0, "sample": 1, "paper": 2}
EMPTY = Fingerprint(np.zeros(0, np.int64), np.zeros(0))
NO_AGES = np.zeros((0, 0))
NO_MAC = np.int64(2**63 - 1)
"""Larger than any address: end marker."""


class ScanWindows:
    """Ring buffers with the latest scans of several receivers, from which fingerprints are computed."""

    def __init__(self, receivers: int, scans_max: int):
        self.width = 32
        """Capacity: transmitters per scan."""
        self._macs, self._rssi_dbm, self._ages_s = _rings(receivers, scans_max, self.width)
        self._counts, self._times_s = np.zeros((receivers, scans_max), np.int64), np.zeros((receivers, scans_max))
        self._added = np.zeros(receivers, np.int64)
        self._found = _found(scans_max, self.width)
        self._room = np.empty((3, scans_max), np.int64), np.empty(scans_max)
        """Work arrays of `fingerprint_of`: row, position and transmitter of each scan; strengths."""
        self._pack: Lent | None = None

    @property
    def rings(self) -> Lent:
        """All arrays, for `fingerprint_of`."""
        if self._pack is None:
            self._pack = Lent((*self.kept, *self._found, *self._room))
        return self._pack

    @property
    def kept(self) -> tuple[Array, ...]:
        """The stored scans, for `keep`."""
        return self._macs, self._rssi_dbm, self._ages_s, self._counts, self._times_s, self._added

    def __getstate__(self) -> dict:
        return self.__dict__ | {"_pack": None}

    def clear(self, receiver: int) -> None:
        """Drop the scans of one receiver."""
        self._times_s[receiver] = -math.inf

    def widen(self, to: int) -> None:
        """Enlarge the capacity to `to` transmitters per scan; invalidates references to `kept`."""
        receivers, scans, width = self._macs.shape
        wider = _rings(receivers, scans, to)
        for new, old in zip(wider, (self._macs, self._rssi_dbm, self._ages_s), strict=True):
            new[..., :width] = old
        self._macs, self._rssi_dbm, self._ages_s = wider
        self._found, self._pack, self.width = _found(scans, to), None, to

    def fingerprint(
        self,
        receiver: int,
        after_s: float,
        detection_min: float,
        std_mode: str = "population",
        age_max_s: float = math.inf,
    ) -> Fingerprint:
        """See `fingerprint`; uses the stored scans of one receiver that are newer than `after_s`."""
        return self.latest(fingerprint_of(receiver, self.rings, after_s, age_max_s, detection_min, STD_MODES[std_mode]))

    def latest(self, count: int) -> Fingerprint:
        """The fingerprint of `count` transmitters that `fingerprint_of` computed last."""
        macs, levels = self._found
        return Fingerprint(macs[:count].copy(), levels[:count].copy()) if count else EMPTY


def _rings(receivers: int, scans: int, width: int) -> tuple[Array, Array, Array]:
    shape = receivers, scans, width
    return np.zeros(shape, np.int64), np.zeros(shape), np.zeros(shape)


def _found(scans: int, width: int) -> tuple[Array, Array]:
    """Output arrays for the transmitters of a fingerprint and their strengths."""
    return np.empty(scans * width, np.int64), np.empty(scans * width)


@borrowing_kernel
def keep(kept, time, receivers, whose, macs, levels, ages, heard):
    """Store scans in `ScanWindows.kept`, whose capacity must suffice; replaces the oldest of each receiver.

    receivers (n,); whose (k,): index into receivers of each scan. ages (k, most) of the readings; `NO_AGES` if all are
    new.
    """
    kept_macs, kept_levels, kept_ages, counts, times, added = kept
    for a in range(whose.shape[0]):
        receiver = receivers[whose[a]]
        row = added[receiver] % counts.shape[1]
        for k in range(heard[a]):
            kept_macs[receiver, row, k], kept_levels[receiver, row, k] = macs[a, k], levels[a, k]
            kept_ages[receiver, row, k] = ages[a, k] if ages.shape[0] > 0 else 0.0
        counts[receiver, row], times[receiver, row] = heard[a], time
        added[receiver] += 1


def fingerprint(
    scans: Sequence[WifiScan], detection_min: float, std_mode: str = "population", age_max_s: float = math.inf
) -> Fingerprint:
    """Clipped mean strength of every transmitter received in at least `detection_min` of the scans.

    A reading counts if it is within one standard deviation of the mean (TWC-SLAM Eq. 7-8). `std_mode`: "population"
    (1/n), "sample" (1/(n-1)) or "paper" (no division: then nothing is ever rejected). Cached readings older than
    `age_max_s` belong to another place and are dropped.
    """
    window, receiver = ScanWindows(1, max(len(scans), 1)), np.zeros(1, np.int64)
    for scan in scans:
        whose, macs, rssi_dbm, counts = WifiScans.of([scan])
        window.widen(max(window.width, macs.shape[1]))
        keep(window.kept, 0.0, receiver, whose, macs, rssi_dbm, ages_of([scan]), counts)
    return window.fingerprint(0, -1.0, detection_min, std_mode, age_max_s)


def ages_of(scans: Sequence[WifiScan | None]) -> Array:
    """(k, most) ages [s] of the readings in the order of `WifiScans.of`; `NO_AGES` if no scan has cached readings."""
    heard = [scan for scan in scans if scan is not None]
    if all(scan.age_s is None for scan in heard):
        return NO_AGES
    ages_s = np.zeros((len(heard), max(len(scan.macs) for scan in heard)))
    for row, scan in zip(ages_s, heard, strict=True):
        row[: len(scan.macs)] = 0.0 if scan.age_s is None else scan.age_s
    return ages_s


@borrowing_kernel
def _next_young(ages, count, at, age_max):
    """Index of the first reading from `at` on that is not too old; the count if there is none."""
    while at < count and ages[at] > age_max:
        at += 1
    return at


@borrowing_kernel
def _clipped_means(
    macs, levels, ages, counts, times, added, after, age_max, detection_min, std_mode, out_macs, out_levels,
    places, heard,
):  # fmt: skip
    """For each transmitter with enough readings, the mean of those within one standard deviation; returns their number.

    The rows are a ring buffer in which the next scan would be number `added`, each sorted by transmitter. Rows later
    than `after` are merged: lowest transmitter first, oldest scan first. places (3, scans), heard (scans,) are work
    arrays.
    """
    size = counts.shape[0]
    rows, at, following = places[0], places[1], places[2]
    scans = 0
    for k in range(max(added - size, 0), added):
        row = k % size
        if times[row] > after:
            rows[scans] = row
            at[scans] = 0
            at[scans] = _next_young(ages[row], counts[row], at[scans], age_max)
            following[scans] = macs[row, at[scans]] if at[scans] < counts[row] else NO_MAC
            scans += 1
    count_min = detection_min * scans - 1e-9
    found = 0
    while True:
        mac = NO_MAC
        for k in range(scans):
            mac = min(mac, following[k])
        if mac == NO_MAC:
            return found
        n, total = 0, 0.0
        for k in range(scans):
            if following[k] == mac:
                row = rows[k]
                heard[n] = levels[row, at[k]]
                total += heard[n]
                n += 1
                at[k] = _next_young(ages[row], counts[row], at[k] + 1, age_max)
                following[k] = macs[row, at[k]] if at[k] < counts[row] else NO_MAC
        if n < count_min:
            continue
        mean = total / n
        squares = 0.0
        for k in range(n):
            squares += (heard[k] - mean) ** 2
        if std_mode == 0:
            squares /= n
        elif std_mode == 1:
            squares /= max(n - 1, 1)
        limit = math.sqrt(squares) + 1e-9
        kept, kept_total = 0, 0.0
        for k in range(n):
            if abs(heard[k] - mean) <= limit:
                kept += 1
                kept_total += heard[k]
        out_macs[found] = mac
        out_levels[found] = kept_total / kept if kept else mean
        found += 1


@borrowing_kernel
def fingerprint_of(receiver, rings, after, age_max, detection_min, std_mode):
    """`_clipped_means` of one receiver of `ScanWindows.rings`, stored there."""
    macs, levels, ages, counts, times, added, found_macs, found_levels, places, heard = parts_of(rings)
    return _clipped_means(
        macs[receiver], levels[receiver], ages[receiver], counts[receiver], times[receiver], added[receiver], after,
        age_max, detection_min, std_mode, found_macs, found_levels, places, heard,
    )  # fmt: skip


def mac_similarity(a: Fingerprint, b: Fingerprint) -> float:
    """Number of shared transmitters over the size of the larger set (TWC-SLAM Eq. 9); 0 if one side is empty."""
    if len(a.macs) == 0 or len(b.macs) == 0:
        return 0.0
    return _shared(a, b)[0].sum() / max(len(a.macs), len(b.macs))


def rssi_distance_db(a: Fingerprint, b: Fingerprint) -> tuple[float, int]:
    """Root of the summed squared differences over the shared transmitters [dB] (Eq. 10), and their number."""
    in_a, position = _shared(a, b)
    difference = a.rssi_dbm[in_a] - b.rssi_dbm[position[in_a]]
    return float(np.sqrt((difference**2).sum())), int(in_a.sum())


@kernel
def rssi_similarity(distance_db, shared, tolerance_db):
    """min(1, tolerance / RMS difference) (papers.md T8); 0 without shared transmitters."""
    if shared == 0:
        return 0.0
    rms = distance_db / math.sqrt(shared)
    return 1.0 if rms <= tolerance_db else tolerance_db / rms


def _shared(a: Fingerprint, b: Fingerprint) -> tuple[Array, Array]:
    """For each transmitter of a: whether it is in b, and its index there."""
    position = np.minimum(np.searchsorted(b.macs, a.macs), max(len(b.macs) - 1, 0))
    return (b.macs[position] == a.macs) if len(b.macs) else np.zeros(len(a.macs), bool), position
