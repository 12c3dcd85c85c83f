"""Bin WiFi readings along a path at even steps, as input of the signal model and the wall sampler."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array
from scipy.ndimage import uniform_filter1d
from scipy.stats import norm

from twc_env.errors import DataError
from twc_env.records.array_validation import validated_points
from twc_env.records.geometry import travelled_m

_NOISE_MAX_DB = 6.0
_SHARE_REACH = 3
"""Bins on either side that are averaged for the share of readings that received a router."""


@dataclass(frozen=True, slots=True, eq=False)
class PathBins:
    """Binned readings of a path."""

    position_m: Array
    """(bins, 2) mean position."""
    rssi_dbm: Array
    """(bins, routers) mean reading, NaN where a router was not received."""
    count: Array
    """(bins, routers) number of readings in each mean."""
    travel_m: Array
    """(bins,) path length at the bin."""
    bin_of: Array
    """(readings,) bin index of each reading."""

    @property
    def step_m(self) -> float:
        """Mean spacing of the bins [m]."""
        return float(self.travel_m[-1] - self.travel_m[0]) / max(len(self.travel_m) - 1, 1) or 1e-3


def bin_along_path(position_m: Array, rssi_dbm: Array, step_m: float = 0.1) -> PathBins:
    """Average readings (n, routers), NaN where not received, at positions (n, 2), over steps of the path.

    Raises DataError for positions that are not finite and for arrays of inconsistent shape.
    """
    position, rssi = validated_points(position_m, "positions"), np.asarray(rssi_dbm, float)
    if rssi.ndim != 2 or rssi.shape[1] == 0 or len(position) != len(rssi) or len(position) < 2:
        raise DataError(
            "k-visibility needs positions (n, 2) and readings (n, routers), n >= 2 and a router at least; "
            f"got {position.shape}, {rssi.shape}"
        )
    travel = travelled_m(position)
    _, bin_of = np.unique(np.floor(travel / step_m).astype(np.int64), return_inverse=True)
    total = np.bincount(bin_of).astype(float)
    heard = np.isfinite(rssi)
    count = np.column_stack([np.bincount(bin_of, column) for column in heard.T.astype(float)])
    sums = np.column_stack([np.bincount(bin_of, column) for column in np.where(heard, rssi, 0.0).T])
    with np.errstate(invalid="ignore"):
        mean = sums / np.where(count > 0, count, np.nan)
    mean -= _censoring_bias(rssi, count, total)
    place = np.column_stack([np.bincount(bin_of, position[:, axis]) / total for axis in (0, 1)])
    return PathBins(place, mean, count, np.bincount(bin_of, travel) / total, bin_of)


def _censoring_bias(rssi: Array, count: Array, total: Array) -> Array:
    """(bins, routers) bias of the mean where weak readings are missing [dB].

    The mean of a truncated normal distribution, with the truncation limit from the share of readings received.
    """
    width = 2 * _SHARE_REACH + 1
    heard = uniform_filter1d(count, width, axis=0, mode="nearest")
    share = np.clip(heard / uniform_filter1d(total, width, mode="nearest")[:, None], 0.02, 1.0)
    bias = np.zeros(share.shape)
    for router in range(rssi.shape[1]):
        steps = np.diff(rssi[np.isfinite(rssi[:, router]), router])
        noise = min(float(np.median(np.abs(steps))) / 0.954, _NOISE_MAX_DB) if len(steps) else 0.0
        bias[:, router] = noise * norm.pdf(norm.ppf(share[:, router])) / share[:, router]
    return bias
