"""Oracle for the localisation of phone walks by radio: one walk is localised while the poses of all others are known.

The scans of the others give a radio map: at each cell the weighted mean of the scans around it. The walk is placed
where its scans are most similar to this map, over the whole floor. This uses surveyed positions and is no method: it
shows the error that remains with one of the best likelihoods found without training on surveyed positions.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import RadioSlamConfig
from twc_env.datasets.surveys.step_heading import WalkerTrace
from twc_env.slam.radio.radio_similarity import all_similarities, feature_rows
from twc_env.slam.radio.trace_joining import COMPASS_STD_RAD, SHARPNESS

CELL_M, MARGIN_M = 2.0, 15.0
REACH_M, FALL = 2.5, 1.5
"""Weight of a scan at a cell: (1 + (distance / reach)^2)^-fall."""
GAIN = 30.0
"""Log likelihood per unit of cosine of one scan; a walk of n scans counts sqrt(n) times."""
TURNS_RAD = np.linspace(-0.2, 0.2, 3)
"""Tested rotations of a walk, for errors of its compass."""
_SMALLEST = 1e-9
_ROUNDING = 1e-5
"""Relative rounding error of sums in single precision: smaller remainders are zero."""


def localisation_errors_m(walks: Sequence[WalkerTrace], is_shape_known: bool) -> Array:
    """(n,) distance [m] of each scan of every walk from its true position.

    With `is_shape_known` the true shape and heading of the walk are known and only its position is estimated; otherwise
    they are from dead reckoning and compass.
    """
    true_m = np.concatenate([walk.surveyed_m for walk in walks])
    shape_m = true_m if is_shape_known else np.concatenate([walk.reckoned[:, :2] for walk in walks])
    turns_rad = np.zeros(1) if is_shape_known else TURNS_RAD
    told = _Others(true_m, [print_ for walk in walks for print_ in walk.fingerprints])
    ends = np.cumsum([len(walk.surveyed_m) for walk in walks])
    away = []
    for end, walk in zip(ends, walks, strict=True):
        own = np.arange(end - len(walk.surveyed_m), end)
        away.append(np.linalg.norm(told.localised(own, shape_m[own], turns_rad) - true_m[own], axis=1))
    return np.concatenate(away)


class _Others:
    """The radio map of all scans, from which any walk can be excluded."""

    def __init__(self, positions_m: Array, fingerprints: Sequence):
        rows = feature_rows(fingerprints, RadioSlamConfig().similarity)
        rows.data = rows.data**SHARPNESS
        self._similarity = all_similarities(rows)  # (n, n)
        low = positions_m.min(axis=0) - MARGIN_M
        self._shape = tuple(np.ceil((np.ptp(positions_m, axis=0) + 2 * MARGIN_M) / CELL_M).astype(int) + 1)
        cells = np.stack(np.meshgrid(*map(np.arange, self._shape), indexing="ij"), axis=-1).reshape(-1, 2)
        self._cells_m = low + CELL_M * cells
        away = [np.subtract.outer(c, p).astype(np.float32) for c, p in zip(self._cells_m.T, positions_m.T, strict=True)]
        self._weight = (1.0 + (away[0] ** 2 + away[1] ** 2) / REACH_M**2) ** np.float32(-FALL)  # (cells, n)
        self._product = self._weight @ self._similarity  # of the mean of each cell (not normalised) with each scan
        self._squared = (self._product * self._weight).sum(axis=1)  # squared length of that mean

    def localised(self, own: Array, shape_m: Array, turns_rad: Array) -> Array:
        """(k, 2) the most likely positions of scans `own` (k,) of a walk of this shape (k, 2), given all other
        scans."""
        similarity = self._similarities(own)
        centred = shape_m - shape_m.mean(axis=0)
        best, found = -np.inf, centred
        for turn in turns_rad:
            c, s = np.cos(turn), np.sin(turn)
            turned = centred @ np.array([[c, s], [-s, c]])
            score = (
                GAIN * self._summed_scores(similarity, turned) / np.sqrt(len(own)) - 0.5 * (turn / COMPASS_STD_RAD) ** 2
            )
            if score.max() > best:
                best, found = score.max(), self._cells_m[score.argmax()] + turned
        return found

    def _similarities(self, own: Array) -> Array:
        """(k, cells) cosine of each scan of a walk with the radio map of the others."""
        weight, similarity = self._weight[:, own], self._similarity[np.ix_(own, own)]
        within = weight @ similarity
        squared = self._squared - 2 * (self._product[:, own] * weight).sum(axis=1) + (within * weight).sum(axis=1)
        others = self._product[:, own] - within
        others[others < _ROUNDING * within] = 0.0  # no other scan is similar
        return (others / np.sqrt(np.maximum(squared, _SMALLEST))[:, None]).T

    def _summed_scores(self, similarity: Array, offsets_m: Array) -> Array:
        """(cells,) summed cosines for the middle of the walk at each cell; positions off the floor count as its
        edge."""
        width, height = self._shape
        total = np.zeros(self._shape)
        for row, (dx, dy) in zip(similarity, np.rint(offsets_m / CELL_M).astype(int), strict=True):
            x, y = np.clip(np.arange(width) + dx, 0, width - 1), np.clip(np.arange(height) + dy, 0, height - 1)
            total += row.reshape(self._shape)[x[:, None], y[None]]
        return total.ravel()
