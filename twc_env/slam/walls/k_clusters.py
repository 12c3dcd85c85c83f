"""Published estimate of the number of walls: smooth RSSI, cluster it, take the cluster's rank (Eq. 1-3, K5, K6)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import DataError

_DISTANCE_MIN_M = 0.5
_K_MAX = 5


def sliding_window(rssi_dbm: Array, width: int, median: bool = False) -> Array:
    """(n,) running mean (or median) of readings (n,) of one router in path order; the edges are padded."""
    width = max(1, min(width, len(rssi_dbm)))
    padded = np.pad(np.asarray(rssi_dbm, float), (width // 2, width - 1 - width // 2), mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, width)
    return np.median(windows, axis=1) if median else windows.mean(axis=1)


def k_means(values: Array, clusters: int, iterations: int = 100) -> Array:
    """(clusters,) centroids, descending (C_0 strongest); starts at quantiles, an empty cluster keeps its centroid.

    Raises DataError for values that are not finite.
    """
    values = _finite(values)
    centroids = np.quantile(values, (np.arange(clusters) + 0.5) / clusters)
    for _ in range(iterations):
        nearest = np.argmin(np.abs(values[:, None] - centroids), axis=1)
        counts = np.bincount(nearest, minlength=clusters)
        sums = np.bincount(nearest, values, minlength=clusters)
        updated = np.where(counts > 0, sums / np.maximum(counts, 1), centroids)
        if np.allclose(updated, centroids):
            break
        centroids = updated
    return np.sort(centroids)[::-1]


def predict_walls(values: Array, centroids: Array) -> Array:
    """(n,) k of each value: how many thresholds t_k = (C_(k-1) + C_k) / 2 it does not exceed (Eq. 1 and 3).

    Raises DataError for values that are not finite: what was not heard has no k, not k = 0.
    """
    thresholds = (centroids[:-1] + centroids[1:]) / 2
    return (_finite(values)[:, None] <= thresholds).sum(axis=1)


def silhouette_k(values: Array, k_max: int = _K_MAX) -> int:
    """The k, 1 to k_max, whose k + 1 clusters of the values (n,) have the best mean simplified silhouette: 1 - distance
    to the own centre / distance to the next one."""
    values = np.asarray(values, float)
    scores = []
    for k in range(1, k_max + 1):
        gaps = np.sort(np.abs(values[:, None] - k_means(values, k + 1)), axis=1)
        scores.append(float(np.mean(1.0 - gaps[:, 0] / np.maximum(gaps[:, 1], 1e-9))))
    return int(np.argmax(scores)) + 1


def compensate_distance(rssi_dbm: Array, distance_m: Array, exponent: float) -> Array:
    """(n,) readings [dBm] normalised to a distance of one metre: 10 n dB per decade of distance_m (n,) are added."""
    return rssi_dbm + 10.0 * exponent * np.log10(np.maximum(distance_m, _DISTANCE_MIN_M))


def _finite(values: Array) -> Array:
    values = np.asarray(values, float)
    if not np.isfinite(values).all():
        raise DataError("readings of one router must be finite: leave out those in which it was not heard")
    return values
