"""How well radio could place phone walks: one walk is looked for while all others are told where they truly lie.

The scans of the others span a map: at each place the mean of what was heard around, the walk itself left out. The walk
is laid where its scans are most alike to the map, over the whole floor. This uses surveyed positions and is no method:
it says how much of an error is left by what radio tells, by one of the best likelihoods that were found without
training on surveyed positions.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import RadioSlamConfig
from twc_env.datasets.step_heading import WalkerTrace
from twc_env.slam.radio_similarity import all_similarities, feature_rows
from twc_env.slam.trace_joining import COMPASS_STD_RAD, SHARPNESS

CELL_M, MARGIN_M = 2.0, 15.0
REACH_M, FALL = 2.5, 1.5
"""A scan counts (1 + (distance / reach)^2)^-fall at a place."""
GAIN = 30.0
"""How much the cosine of one scan says, in units of log likelihood; a walk of n scans says sqrt(n) of that."""
TURNS_RAD = np.linspace(-0.2, 0.2, 3)
"""Headings that are tried of a walk whose compass may be off."""
_SMALLEST = 1e-9
_ROUNDING = 1e-5
"""Of a sum of single precision, at most: less is left of none."""


def sought(walks: Sequence[WalkerTrace], is_shape_told: bool) -> Array:
    """(n,) how far [m] each scan of every walk is found from the truth.

    With `is_shape_told` the walk's true shape and heading are known and only its place is looked for; else its shape
    is dead reckoning and its heading the compass's.
    """
    true_m = np.concatenate([walk.surveyed_m for walk in walks])
    shape_m = true_m if is_shape_told else np.concatenate([walk.reckoned[:, :2] for walk in walks])
    turns_rad = np.zeros(1) if is_shape_told else TURNS_RAD
    told = _Others(true_m, [print_ for walk in walks for print_ in walk.fingerprints])
    ends = np.cumsum([len(walk.surveyed_m) for walk in walks])
    away = []
    for end, walk in zip(ends, walks, strict=True):
        own = np.arange(end - len(walk.surveyed_m), end)
        away.append(np.linalg.norm(told.placed(own, shape_m[own], turns_rad) - true_m[own], axis=1))
    return np.concatenate(away)


class _Others:
    """The map that scans span, of which any walk can be left out."""

    def __init__(self, positions_m: Array, fingerprints: Sequence):
        rows = feature_rows(fingerprints, RadioSlamConfig().similarity)
        rows.data = rows.data**SHARPNESS
        self._alike = all_similarities(rows)  # (n, n)
        low = positions_m.min(axis=0) - MARGIN_M
        self._shape = tuple(np.ceil((np.ptp(positions_m, axis=0) + 2 * MARGIN_M) / CELL_M).astype(int) + 1)
        cells = np.stack(np.meshgrid(*map(np.arange, self._shape), indexing="ij"), axis=-1).reshape(-1, 2)
        self._cells_m = low + CELL_M * cells
        away = [np.subtract.outer(c, p).astype(np.float32) for c, p in zip(self._cells_m.T, positions_m.T, strict=True)]
        self._weight = (1.0 + (away[0] ** 2 + away[1] ** 2) / REACH_M**2) ** np.float32(-FALL)  # (cells, n)
        self._product = self._weight @ self._alike  # of each cell's mean, not of unit length, with each scan
        self._squared = (self._product * self._weight).sum(axis=1)  # length of that mean

    def placed(self, own: Array, shape_m: Array, turns_rad: Array) -> Array:
        """(k, 2) where scans `own` (k,) of a walk of this shape (k, 2) most likely lie, by all other scans."""
        alike = self._alikeness(own)
        centred = shape_m - shape_m.mean(axis=0)
        best, found = -np.inf, centred
        for turn in turns_rad:
            c, s = np.cos(turn), np.sin(turn)
            turned = centred @ np.array([[c, s], [-s, c]])
            score = GAIN * self._summed(alike, turned) / np.sqrt(len(own)) - 0.5 * (turn / COMPASS_STD_RAD) ** 2
            if score.max() > best:
                best, found = score.max(), self._cells_m[score.argmax()] + turned
        return found

    def _alikeness(self, own: Array) -> Array:
        """(k, cells) cosine of each of a walk's scans with the map that the others span."""
        weight, alike = self._weight[:, own], self._alike[np.ix_(own, own)]
        within = weight @ alike
        squared = self._squared - 2 * (self._product[:, own] * weight).sum(axis=1) + (within * weight).sum(axis=1)
        others = self._product[:, own] - within
        others[others < _ROUNDING * within] = 0.0  # nobody else heard the like
        return (others / np.sqrt(np.maximum(squared, _SMALLEST))[:, None]).T

    def _summed(self, alike: Array, offsets_m: Array) -> Array:
        """(cells,) what scans say together of their middle being there; beyond the floor as at its edge."""
        width, height = self._shape
        total = np.zeros(self._shape)
        for row, (dx, dy) in zip(alike, np.rint(offsets_m / CELL_M).astype(int), strict=True):
            x, y = np.clip(np.arange(width) + dx, 0, width - 1), np.clip(np.arange(height) + dy, 0, height - 1)
            total += row.reshape(self._shape)[x[:, None], y[None]]
        return total.ravel()
