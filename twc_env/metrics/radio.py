"""Statistics of radio fingerprints: path loss, wall loss, detection rate, spread, similarity.

Plain arrays in, numbers out: the same functions evaluate measured and simulated surveys.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

DISTANCE_MIN_M = 0.5
_PAIRS_MIN = 10


@dataclass(frozen=True, slots=True)
class PathLoss:
    """Least-squares fit of rssi = power - 10 n log10 d - wall_loss * walls."""

    power_at_1m_dbm: float
    exponent: float
    wall_loss_db: float
    """NaN without walls."""
    residual_std_db: float


def fit_path_loss(distance_m: Array, rssi_dbm: Array, walls: Array | None = None) -> PathLoss:
    """Fit to (k,) distances and strengths, and optionally the walls crossed (k,)."""
    decades = 10 * np.log10(np.maximum(distance_m, DISTANCE_MIN_M))
    columns = [np.ones(len(decades)), -decades] + ([] if walls is None else [-np.asarray(walls, float)])
    design = np.column_stack(columns)
    solution = np.linalg.lstsq(design, np.asarray(rssi_dbm, float), rcond=None)[0]
    residual = rssi_dbm - design @ solution
    return PathLoss(
        power_at_1m_dbm=float(solution[0]),
        exponent=float(solution[1]),
        wall_loss_db=float("nan") if walls is None else float(solution[2]),
        residual_std_db=float(residual.std()),
    )


def detection_rates(distance_m: Array, is_heard: Array, edges_m: Array) -> Array:
    """(bands,) share heard of the pairs (k,) with a distance between consecutive edges; NaN for empty bands."""
    band = np.digitize(distance_m, edges_m) - 1
    inside = (band >= 0) & (band < len(edges_m) - 1)
    tried = np.bincount(band[inside], minlength=len(edges_m) - 1)
    heard = np.bincount(band[inside], np.asarray(is_heard, float)[inside], minlength=len(edges_m) - 1)
    with np.errstate(invalid="ignore"):
        return heard / tried


def spread_at_points(point: Array, rssi_dbm: Array, heard_min: int) -> float:
    """Mean standard deviation [dB] of a transmitter over the scans (s, t) of one point, NaN where not heard.

    `point` (s,) is the number of the point of each scan; transmitters heard fewer than `heard_min` times are left out.
    """
    spreads = []
    for place in np.unique(point):
        here = rssi_dbm[point == place]
        often = here[:, np.isfinite(here).sum(axis=0) >= heard_min]
        spreads.append(np.nanstd(often, axis=0, ddof=1) if often.size else np.zeros(0))
    return float(np.concatenate(spreads).mean())


def mean_rssi_by_walls(walls: Array, rssi_dbm: Array, walls_max: int) -> Array:
    """(walls_max + 1,) mean strength of the readings (k,) that crossed 0, 1, ... walls."""
    return np.array(
        [float(np.mean(rssi_dbm[walls == k])) if (walls == k).any() else np.nan for k in range(walls_max + 1)]
    )


def cosine_similarity(rssi_dbm: Array, offset_db: float = 100.0) -> Array:
    """(s, s) cosine of fingerprints (s, t), NaN where not heard; strengths count from -offset_db (papers.md R4)."""
    levels = np.maximum(np.nan_to_num(rssi_dbm + np.float32(offset_db), nan=0.0), 0.0).astype(np.float32)
    norms = np.linalg.norm(levels, axis=1)
    unit = levels / np.where(norms > 0, norms, 1.0)[:, None]
    return unit @ unit.T


def distance_at_similarity(
    position_m: Array, similarity: Array, is_pair: Array, at: float, width: float = 0.05
) -> tuple[float, float]:
    """Mean and standard deviation [m] of the distance of pairs with a similarity within width/2 of `at` (papers.md R6).

    Positions (s, 2); similarity and is_pair (s, s), of which the upper triangle counts. NaN for fewer than ten pairs.
    """
    first, second = np.nonzero(np.triu(is_pair & (np.abs(similarity - at) <= width / 2), 1))
    if len(first) < _PAIRS_MIN:
        return float("nan"), float("nan")
    distance_m = np.linalg.norm(position_m[first] - position_m[second], axis=1)
    return float(distance_m.mean()), float(distance_m.std())
