"""Maps of the strongest access point's mean RSSI over a floor, without shadowing; for images."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import RadioConfig
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.sensors.radio import bypass_share

SIGNAL_SPAN_DBM = (-90.0, -30.0)
"""Range of the colour scale."""
_POINTS = 6000
"""Approximate raster cells of a map."""


def strongest_signal_dbm(plan: Floorplan, points_m: Array, config: RadioConfig | None = None) -> Array:
    """(k, 2) points -> (k,) mean RSSI of the strongest access point: path loss, walls and ceilings, without shadowing.

    At 2.4 GHz, as `RadioModel.mean_rssi_dbm` has it.
    """
    config = config or RadioConfig()
    best = np.full(len(points_m), -np.inf)
    for access_point in plan.access_points:
        losses_db = config.wall_loss_scale * plan.wall_index.crossing(access_point.position_m, points_m)[1]
        if config.wall_loss_limit_db:
            bypass = bypass_share(config.wall_loss_limit_db)
            losses_db = -10 * np.log10((1 - bypass) * 10 ** (-0.1 * losses_db) + bypass)
        ceilings = abs(access_point.floor)
        height_m = ceilings * config.floor_height_m
        distance_m = np.hypot(np.linalg.norm(points_m - access_point.position_m, axis=1), height_m)
        if ceilings:
            losses_db += config.floor_loss_db + config.floor_loss_further_db * (ceilings - 1)
            losses_db += config.floor_loss_grazing_db * (1 - height_m / distance_m)
        path_loss_db = 10 * config.path_loss_exponent * np.log10(np.maximum(distance_m, config.distance_min_m))
        best = np.maximum(best, config.power_at_1m_dbm - path_loss_db - losses_db)
    return best


def signal_map_dbm(plan: Floorplan, config: RadioConfig | None = None) -> tuple[Array, tuple[float, float], float]:
    """(rows, columns) RSSI on a raster, NaN off the floor; its lower left corner [m] and cell size [m].

    Row 0 has the least y.
    """
    x0, y0, x1, y1 = plan.bounds_m
    step_m = max(0.1, float(np.sqrt((x1 - x0) * (y1 - y0) / _POINTS)))
    xs, ys = np.arange(x0 + step_m / 2, x1, step_m), np.arange(y0 + step_m / 2, y1, step_m)
    points = np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2)
    signal = strongest_signal_dbm(plan, points, config)
    cells = plan.cells()
    # Walls count as floor: gaps of one pixel would be wider than the walls.
    signal[~dataclasses.replace(cells, free=cells.free | cells.wall).is_free(points)] = np.nan
    return signal.reshape(len(ys), len(xs)), (float(x0), float(y0)), step_m
