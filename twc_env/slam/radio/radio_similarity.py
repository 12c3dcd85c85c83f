"""Similarity of radio fingerprints: cosine similarity (radio SLAM Eq. 2), one against many and all pairs.

Fingerprints are stored by transmitter (inverted index): each transmitter has a list of the places that received it, so
a comparison touches only common transmitters.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import ConfigError
from twc_env.kernels.compiled import kernel
from twc_env.records.messages import Fingerprint

if TYPE_CHECKING:
    from scipy.sparse import csr_array


CELL_ID_MIN = 1 << 48
"""LTE cell ids start here, above all MAC addresses."""
MODES = ("shifted", "raw", "linear")
WIFI_OFFSET_DB, CELL_OFFSET_DB = 100.0, 120.0
"""Offsets of mode `shifted` (papers.md R4): a transmitter that is not received equals one barely received."""
_SHORTEST = 1e-12


def features(macs: Array, rssi_dbm: Array, mode: str = "shifted") -> Array:
    """(transmitters,) feature values of the cosine.

    `shifted`: dB above the weakest possible reading; `raw`: dBm as printed, in which weak readings weigh most;
    `linear`: amplitude 10^(dBm / 20).
    """
    if mode == "shifted":
        return np.maximum(rssi_dbm + np.where(macs >= CELL_ID_MIN, CELL_OFFSET_DB, WIFI_OFFSET_DB), 0.0)
    if mode == "raw":
        return np.asarray(rssi_dbm, float)
    if mode == "linear":
        return 10.0 ** (np.asarray(rssi_dbm, float) / 20.0)
    raise ConfigError(f"a similarity mode is one of {', '.join(MODES)}; got {mode!r}")


def split_cues(fingerprint: Fingerprint) -> dict[str, Fingerprint]:
    """The WiFi and the LTE part of a fingerprint."""
    is_cell = fingerprint.macs >= CELL_ID_MIN
    return {
        "wifi": Fingerprint(fingerprint.macs[~is_cell], fingerprint.rssi_dbm[~is_cell]),
        "lte": Fingerprint(fingerprint.macs[is_cell], fingerprint.rssi_dbm[is_cell]),
    }


def feature_rows(fingerprints: Sequence[Fingerprint], mode: str = "shifted") -> csr_array:
    """(fingerprints, transmitters) sparse features; columns are all transmitters received, ascending."""
    from scipy.sparse import csr_array  # slow to import, and used by radio studies only

    macs = [f.macs for f in fingerprints]
    heard = np.concatenate(macs) if macs else np.zeros(0, np.int64)
    known, columns = np.unique(heard, return_inverse=True)
    levels = np.concatenate([f.rssi_dbm for f in fingerprints]) if macs else np.zeros(0)
    ends = np.concatenate([[0], np.cumsum([len(m) for m in macs])]).astype(np.int64)
    rows = csr_array((features(heard, levels, mode), columns, ends), shape=(len(macs), max(len(known), 1)))
    rows.eliminate_zeros()
    return rows


def averaged(rows: csr_array, travel_m: Array, reach_m: float, places: Array) -> csr_array:
    """(places, transmitters) rows averaged along the path with triangular weights; missing readings count as 0.

    travel_m (rows,) ascends; places are row indices. With reach 0 each row is used alone.
    """
    from scipy.sparse import csr_array  # slow to import, and used by radio studies only

    if reach_m <= 0.0:
        return csr_array(rows[places])
    at_m = travel_m[places]
    first = np.searchsorted(travel_m, at_m - reach_m, side="right")
    ends = np.concatenate([[0], np.cumsum(np.searchsorted(travel_m, at_m + reach_m, side="left") - first)])
    own = np.repeat(np.arange(len(places)), np.diff(ends))
    near = np.arange(ends[-1]) - ends[own] + first[own]
    weight = np.maximum(1.0 - np.abs(at_m[own] - travel_m[near]) / reach_m, 1e-3)
    weight /= np.bincount(own, weight)[own]
    return csr_array(csr_array((weight, near, ends), shape=(len(places), len(travel_m))) @ rows)


def all_similarities(rows: csr_array) -> Array:
    """(n, n) float32 cosine of all pairs of rows; 0 for an empty one."""
    unit = _normalised(rows)
    starts, members, weights = _by_transmitter(unit)
    return _all_pairs(unit.indptr, unit.indices, unit.data, starts, members, weights)


def _normalised(rows: csr_array) -> csr_array:
    lengths = np.sqrt(np.asarray(rows.multiply(rows).sum(axis=1)).ravel())
    unit = rows.astype(np.float32)  # may reorder the columns within a row
    unit.data = (unit.data / np.repeat(np.maximum(lengths, _SHORTEST), np.diff(unit.indptr))).astype(np.float32)
    return unit


def _by_transmitter(unit: csr_array) -> tuple[Array, Array, Array]:
    columns = unit.tocsc()
    return columns.indptr, columns.indices, columns.data


class FingerprintStore:
    """Growing store of fingerprints with similarity search.

    Each transmitter's list is a segment of one pool; a full segment moves to the end of the pool with twice the
    capacity.
    """

    def __init__(self, mode: str = "shifted"):
        if mode not in MODES:
            raise ConfigError(f"a similarity mode is one of {', '.join(MODES)}; got {mode!r}")
        self._mode = mode
        self._number: dict[int, int] = {}
        self._start, self._length, self._room = (np.zeros(64, np.int64) for _ in range(3))
        self._member, self._weight = np.zeros(1024, np.int32), np.zeros(1024, np.float32)
        self._used = 0
        self.count = 0
        """Number of stored fingerprints; each is identified by its index in order of `add`."""

    def __len__(self) -> int:
        return self.count

    def add(self, fingerprint: Fingerprint) -> int:
        """Store one fingerprint; returns its index."""
        columns, weights = self._vector(fingerprint, grow=True)
        for column in columns.tolist():
            if self._length[column] == self._room[column]:
                self._enlarge(column)
        at = self._start[columns] + self._length[columns]
        self._member[at], self._weight[at] = self.count, weights
        self._length[columns] += 1
        self.count += 1
        return self.count - 1

    def similarities(self, fingerprint: Fingerprint) -> Array:
        """(count,) float32 similarity of each stored fingerprint to this one."""
        columns, weights = self._vector(fingerprint, grow=False)
        out = np.zeros(self.count, np.float32)
        _one_to_many(columns, weights, self._start, self._length, self._member, self._weight, out)
        return out

    def nearest(self, fingerprint: Fingerprint, count: int) -> tuple[Array, Array]:
        """Indices and similarities of the most similar ones, best first; equal ones by index, for any count."""
        similarity = self.similarities(fingerprint)
        count = min(count, self.count)
        if count <= 0:
            best = np.zeros(0, np.int64)
        elif count < self.count:
            least = -np.partition(-similarity, count - 1)[count - 1]
            above = np.flatnonzero(similarity > least)
            best = np.concatenate([above, np.flatnonzero(similarity == least)[: count - len(above)]])
        else:
            best = np.arange(self.count)
        best = best[np.argsort(-similarity[best], kind="stable")]
        return best, similarity[best]

    def _vector(self, fingerprint: Fingerprint, grow: bool) -> tuple[Array, Array]:
        """Columns and normalised features; without `grow`, unknown transmitters only contribute to the norm."""
        values = features(fingerprint.macs, fingerprint.rssi_dbm, self._mode)
        values = values / max(float(np.sqrt((values**2).sum())), _SHORTEST)
        columns = np.array([self._column(mac, grow) for mac in fingerprint.macs.tolist()], np.int64)
        known = (columns >= 0) & (values != 0.0)
        return columns[known], values[known].astype(np.float32)

    def _column(self, mac: int, grow: bool) -> int:
        column = self._number.get(mac, -1)
        if column < 0 and grow:
            column = self._number[mac] = len(self._number)
            if column == len(self._start):
                self._start, self._length, self._room = (_doubled(a) for a in (self._start, self._length, self._room))
        return column

    def _enlarge(self, column: int) -> None:
        room = max(4, 2 * int(self._room[column]))
        while self._used + room > len(self._member):
            self._member, self._weight = _doubled(self._member), _doubled(self._weight)
        old, length = int(self._start[column]), int(self._length[column])
        for pool in (self._member, self._weight):
            pool[self._used : self._used + length] = pool[old : old + length]
        self._start[column], self._room[column] = self._used, room
        self._used += room


def _doubled(values: Array) -> Array:
    return np.concatenate([values, np.zeros_like(values)])


@kernel
def _one_to_many(columns, weights, start, length, member, weight, out):
    for k in range(len(columns)):
        first, size, w = start[columns[k]], length[columns[k]], weights[k]
        if size == 0:
            continue
        if member[first + size - 1] - member[first] == size - 1:  # heard without a gap: one run that vectorises
            run, own = out[member[first] : member[first] + size], weight[first : first + size]
            for i in range(size):
                run[i] += w * own[i]
            continue
        for at in range(first, first + size):
            out[member[at]] += w * weight[at]


@kernel
def _all_pairs(row_starts, columns, weights, starts, members, member_weights):
    count = len(row_starts) - 1
    out = np.zeros((count, count), np.float32)
    begin = starts.copy()  # members ascend: what lies before a row was compared from the other side
    for i in range(count):
        row = out[i]
        for k in range(row_starts[i], row_starts[i + 1]):
            column, w = columns[k], weights[k]
            for at in range(begin[column], starts[column + 1]):
                row[members[at]] += w * member_weights[at]
            begin[column] += 1
    for i in range(count):
        for j in range(i):
            out[i, j] = out[j, i]
    return out
