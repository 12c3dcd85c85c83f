"""Distance of two places as a function of the similarity of their fingerprints, by binning (radio SLAM Eq. 3).

The model is trained on pairs close along the path, where odometry is accurate; it uses no surveyed position. As
printed, Eq. 3 averages squared distances and subtracts that from distances; `paper` does so, `repaired` averages
distances.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import DataError

BIN_STEP = 0.01
"""Spacing of bin centres; bins overlap."""
SAMPLES_MIN = 10
VARIANCE_MIN_M2 = 0.25
WINDOW_PER_MEAN = 3.0
"""Training pairs must come from a path window of this multiple of the predicted mean distance: a narrower window cuts
off large distances of that similarity."""
WINDOWS_M = (30.0, 60.0, 100.0, 150.0, 250.0, 400.0)
FORMULAS = ("repaired", "paper")
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class SimilarityModel:
    """Mean and variance of the distance per similarity bin, ascending; linear between bins, constant beyond."""

    centre: Array
    """(bins,) similarity."""
    mean_m: Array
    variance_m2: Array
    count: Array
    """(bins,) number of samples."""
    window_m: float
    """Maximum path length between the two fingerprints of a training pair."""

    def distance(self, similarity: Array) -> tuple[Array, Array]:
        """Mean [m] and variance [m2] of the distance at similarities (k,). Raises DataError for a model without
        bins."""
        if not len(self.centre):
            raise DataError("the model was trained on too few pairs to hold a bin; record a longer path")
        mean = np.interp(similarity, self.centre, self.mean_m)
        return mean, np.maximum(np.interp(similarity, self.centre, self.variance_m2), VARIANCE_MIN_M2)

    def is_truncated(self, similarity_min: float) -> bool:
        """Whether a bin in use predicts more than its window supports (papers.md R5)."""
        used = self.mean_m[self.centre >= similarity_min]
        return bool(len(used) and used.max() * WINDOW_PER_MEAN > self.window_m)


def train(
    similarity: Array, distance_m: Array, window_m: float, bin_width: float = 0.05, formula: str = "repaired"
) -> SimilarityModel:
    """A model from training pairs (k,). Raises DataError for an unknown formula and pairs that are not finite."""
    if formula not in FORMULAS:
        raise DataError(f"a formula is one of {', '.join(FORMULAS)}; got {formula!r}")
    similarity, distance_m = np.asarray(similarity), np.asarray(distance_m)
    if similarity.shape != distance_m.shape or not (np.isfinite(similarity).all() and np.isfinite(distance_m).all()):
        raise DataError("training pairs have a finite similarity and distance each")
    order = np.argsort(similarity, kind="stable")
    similarity, distance_m = similarity[order], distance_m[order]
    centres = np.arange(0.0, 1.0 + BIN_STEP / 2, BIN_STEP)
    first = np.searchsorted(similarity, centres - bin_width / 2, side="left")
    last = np.searchsorted(similarity, centres + bin_width / 2, side="right")
    count = last - first
    sums, squares = (np.concatenate([[0.0], np.cumsum(d)]) for d in (distance_m, distance_m**2))
    with np.errstate(invalid="ignore", divide="ignore"):
        first_moment, second_moment = (sums[last] - sums[first]) / count, (squares[last] - squares[first]) / count
    mean = second_moment if formula == "paper" else first_moment
    variance = second_moment - 2 * mean * first_moment + mean**2
    kept = count >= SAMPLES_MIN
    return SimilarityModel(centres[kept], mean[kept], variance[kept], count[kept], window_m)


def train_on_path(
    similarity: Array,
    travel_m: Array,
    positions_m: Array,
    similarity_min: float,
    window_m: float | None = None,
    bin_width: float = 0.05,
    formula: str = "repaired",
    warns: bool = True,
) -> SimilarityModel:
    """A model from one path: similarity (n, n), path length (n,) and dead-reckoned positions (n, 2) of its places.

    Without a window, the narrowest sufficient one is used, or the widest; `warns` if it is too narrow.
    """
    windows = WINDOWS_M if window_m is None else (window_m,)
    model = None
    for window in windows:
        i, j = _pairs_within(travel_m, window)
        away = np.linalg.norm(positions_m[i] - positions_m[j], axis=1)
        model = train(similarity[i, j], away, window, bin_width, formula)
        if len(model.centre) and not model.is_truncated(similarity_min):
            return model
    assert model is not None
    if warns and model.is_truncated(similarity_min):
        warn_cut_off(similarity_min, model.window_m)
    return model


@lru_cache
def warn_cut_off(similarity_min: float, window_m: float) -> None:
    """Log once per process that models of such a window underestimate distances."""
    _log.warning(
        "the similarity model is truncated: at similarity %.2f it predicts more than a third of its %.0f m window",
        similarity_min, window_m,
    )  # fmt: skip


def _pairs_within(travel_m: Array, window_m: float) -> tuple[Array, Array]:
    """Pairs i < j within a path length of each other; travel ascends."""
    last = np.searchsorted(travel_m, travel_m + window_m, side="right")
    size = last - np.arange(len(travel_m)) - 1
    i = np.repeat(np.arange(len(travel_m)), size)
    starts = np.repeat(np.cumsum(size) - size, size)
    return i, i + 1 + np.arange(len(i)) - starts
