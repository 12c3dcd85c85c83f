"""Localisation in a radio map (fingerprints at known places): nearest neighbours, or a Gaussian process.

A radio map is a result of radio SLAM (papers.md R10): its optimised places with their fingerprints.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array
from scipy.linalg import cho_factor, cho_solve

from twc_env.errors import DataError
from twc_env.kernels.blas_threads import one_blas_thread
from twc_env.records.array_validation import validated_points
from twc_env.records.fingerprint_validation import validated_fingerprint, validated_fingerprints
from twc_env.records.messages import Fingerprint
from twc_env.slam.radio.radio_similarity import FingerprintStore, features

CANDIDATE_M = 0.5
"""Spacing of the candidate places around those of the map."""
CANDIDATES_PER_PLACE = 9
_AT_ONCE = 256
"""Candidates per block of the correlation matrix (bounds memory)."""


class RadioMap:
    """Fingerprints at places (n, 2)."""

    def __init__(self, positions_m: Array, fingerprints: Sequence[Fingerprint], mode: str = "shifted"):
        self.positions_m = validated_points(positions_m, "the positions of a radio map").copy()
        if len(self.positions_m) != len(fingerprints) or not len(fingerprints):
            raise DataError(
                "a radio map needs one position (n, 2) per fingerprint, at least one; "
                f"got {len(self.positions_m)} for {len(fingerprints)}"
            )
        self.fingerprints = validated_fingerprints(fingerprints)
        self._store = FingerprintStore(mode)
        for fingerprint in self.fingerprints:
            self._store.add(fingerprint)

    def nearest(self, fingerprint: Fingerprint, neighbours: int = 4) -> Array:
        """(2,) mean place of the most similar fingerprints, weighted by similarity; the map's centroid for an empty
        one.

        Raises DataError for an invalid fingerprint or fewer than one neighbour.
        """
        if not neighbours >= 1:
            raise DataError(f"neighbours must be 1 or more; got {neighbours!r}")
        best, similarity = self._store.nearest(validated_fingerprint(fingerprint), neighbours)
        weight = similarity.astype(float) ** 2
        if not weight.any():
            return self.positions_m.mean(axis=0)
        return weight @ self.positions_m[best] / weight.sum()


class GaussianProcessMap:
    """Signal strength of every transmitter as a Gaussian process over the floor, all with one kernel (Ferris 2006).

    A transmitter that is not received counts as the weakest strength. The estimate is the mean of the likelihood over
    candidate places: those of the map and around them.
    """

    @one_blas_thread()
    def __init__(
        self, radio_map: RadioMap, length_m: float = 6.0, signal_std_db: float = 8.0, noise_std_db: float = 4.0
    ):
        """Raises DataError for a length or a standard deviation that is not finite and above 0, and for noise too small
        for places so close."""
        if not all(0.0 < value < np.inf for value in (length_m, signal_std_db, noise_std_db)):
            raise DataError(
                "length_m, signal_std_db and noise_std_db must be finite and above 0; "
                f"got {length_m!r}, {signal_std_db!r} and {noise_std_db!r}"
            )
        known = np.unique(np.concatenate([f.macs for f in radio_map.fingerprints]))
        self._column = {mac: k for k, mac in enumerate(known.tolist())}
        self._noise_db = noise_std_db
        heard = np.array([self._row(f) for f in radio_map.fingerprints])
        self._mean = heard.mean(axis=0)
        places = radio_map.positions_m
        covariance = signal_std_db**2 * _kernel(places, places, length_m) + noise_std_db**2 * np.eye(len(places))
        try:
            factor = cho_factor(covariance, lower=True)
        except np.linalg.LinAlgError as error:
            raise DataError(f"noise_std_db {noise_std_db!r} is too small for places so close; raise it") from error
        around = CANDIDATE_M * np.stack(np.meshgrid((-1, 0, 1), (-1, 0, 1)), axis=-1).reshape(CANDIDATES_PER_PLACE, 2)
        self._candidates = (places[:, None] + around[None]).reshape(-1, 2)
        solved = cho_solve(factor, heard - self._mean)
        self._expected = np.empty((len(self._candidates), len(known)))
        self._variance = np.empty(len(self._candidates))
        for first in range(0, len(self._candidates), _AT_ONCE):
            part = slice(first, first + _AT_ONCE)
            cross = signal_std_db**2 * _kernel(self._candidates[part], places, length_m)
            self._expected[part] = cross @ solved + self._mean
            explained = np.einsum("cp,pc->c", cross, cho_solve(factor, cross.T))
            self._variance[part] = np.maximum(signal_std_db**2 - explained, 0.0)

    @one_blas_thread()
    def locate(self, fingerprint: Fingerprint) -> tuple[Array, Array]:
        """Place (2,) and its covariance (2, 2); those of all candidates if it heard no transmitter of the map.

        Raises DataError for an invalid fingerprint.
        """
        row = self._row(validated_fingerprint(fingerprint))
        total = self._variance + self._noise_db**2
        squared = ((row - self._expected) ** 2).sum(axis=1)
        log_likelihood = -0.5 * squared / total - 0.5 * len(self._mean) * np.log(total)
        if not row.any():  # as outside the map, or with a receiver that is off
            log_likelihood[:] = 0.0
        weight = np.exp(log_likelihood - log_likelihood.max())
        weight /= weight.sum()
        place = weight @ self._candidates
        away = self._candidates - place
        return place, (weight[:, None] * away).T @ away

    def _row(self, fingerprint: Fingerprint) -> Array:
        row = np.zeros(len(self._column))
        values = features(fingerprint.macs, fingerprint.rssi_dbm)
        for mac, value in zip(fingerprint.macs.tolist(), values.tolist(), strict=True):
            if mac in self._column:
                row[self._column[mac]] = value
        return row


def _kernel(a: Array, b: Array, length_m: float) -> Array:
    """(a, b) correlation of places, 1 at distance 0."""
    squared = (a[:, :1] - b[:, 0]) ** 2 + (a[:, 1:] - b[:, 1]) ** 2
    return np.exp(-0.5 * squared / length_m**2)
