"""How strong the best access point is, all over a floor: path loss and walls, without shadowing. For pictures."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import RadioConfig
from twc_env.world.floorplan import Floorplan

SIGNAL_SPAN_DBM = (-90.0, -30.0)
"""The range that pictures tell apart."""
_POINTS = 6000


def strongest_signal_dbm(plan: Floorplan, points_m: Array, config: RadioConfig | None = None) -> Array:
    """(k, 2) places -> (k,) mean strength of the best access point: path loss and walls, without shadowing."""
    config = config or RadioConfig()
    best = np.full(len(points_m), -np.inf)
    for access_point in plan.access_points:
        losses_db = plan.wall_index.crossing(access_point.position_m, points_m)[1]
        distance_m = np.linalg.norm(points_m - access_point.position_m, axis=1)
        path_loss_db = 10 * config.path_loss_exponent * np.log10(np.maximum(distance_m, config.distance_min_m))
        best = np.maximum(best, config.power_at_1m_dbm - path_loss_db - losses_db)
    return best


def signal_map_dbm(plan: Floorplan, config: RadioConfig | None = None) -> tuple[Array, tuple[float, float], float]:
    """(rows, columns) strength on a raster of some thousand cells, NaN off the floor; its lower left corner, cell [m].

    Row 0 is the lowest y.
    """
    x0, y0, x1, y1 = plan.bounds_m
    step_m = max(0.1, float(np.sqrt((x1 - x0) * (y1 - y0) / _POINTS)))
    xs, ys = np.arange(x0 + step_m / 2, x1, step_m), np.arange(y0 + step_m / 2, y1, step_m)
    points = np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2)
    signal = strongest_signal_dbm(plan, points, config)
    cells = plan.cells()
    # Under thin walls too: a pixel is wider than a wall, and would leave a gap.
    signal[~dataclasses.replace(cells, free=cells.free | cells.wall).is_free(points)] = np.nan
    return signal.reshape(len(ys), len(xs)), (float(x0), float(y0)), step_m
