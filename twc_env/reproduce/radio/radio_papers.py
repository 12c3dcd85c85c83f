"""Signal statistics published by two papers, and the radio model in twins of their places.

Radio fingerprint SLAM (papers.md R14-R15): transmitters per scan, and distance at cosine 0.8. Inverse k-visibility: the
strengths along the walks of its experiments E3 and E5, classified by the thresholds of the authors' program.
"""

from __future__ import annotations

import dataclasses
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import RADIO_PRESETS, HighBandConfig, RadioConfig
from twc_env.datasets.buildings.raster import plan_from_free
from twc_env.datasets.surveys.fingerprints import RadioSurvey
from twc_env.datasets.surveys.sfw_authors import THRESHOLDS_DBM, AuthorsWalk
from twc_env.maps import load_map
from twc_env.metrics.radio import fit_path_loss
from twc_env.records.geometry import travelled_m
from twc_env.reproduce import radio_places as places
from twc_env.reproduce.radio.radio_study import Figures, Spread, Study, share_near, similarity_figures, with_settings
from twc_env.reproduce.walls.sfw_authors import LaidWalk, lay
from twc_env.world.building.floorplan import AccessPoint, Floorplan

_PHONES = 5
_STROLL_M, _STROLL_SPEED_M_S, _STROLL_STEP_M = 1072.6, 0.42, 1.5
"""The robot of papers.md R14 at NTU: path length, speed, and distance between two scans."""
_WINDOW_M = {"wifi": 60.0, "lte": 150.0}
"""The similarity model is trained on pairs closer than this along the path (papers.md R5)."""
_OFFSET_DB = {"wifi": 100.0, "lte": 120.0}

_QUANTITIES = "transmitters per scan", "distance at cosine 0.8: mean [m]", "distance at cosine 0.8: sd [m]"
_PRINTED = {
    ("radio-ntu", "wifi"): (48.88, 3.79, 2.70),
    ("radio-ntu", "lte"): (16.59, 30.25, 22.13),
    ("radio-sutd-indoor", "wifi"): (118.34,),
    ("radio-sutd-indoor", "lte"): (19.49,),
    ("radio-sutd-outdoor", "wifi"): (88.23,),
    ("radio-sutd-outdoor", "lte"): (18.74,),
}
"""Published values of `_QUANTITIES`, as far as available."""
_CELLS_HEARD = {"radio-ntu": 85, "radio-sutd-indoor": 193, "radio-sutd-outdoor": 170}
"""Published total numbers of LTE cells heard; the simulated numbers of cells have the same ratios."""
_WIFI_PRESET = {
    "radio-ntu": "radio-semi-indoor",
    "radio-sutd-indoor": "radio-indoor",
    "radio-sutd-outdoor": "radio-outdoor",
}

_PHONE_SETTINGS = ("detection_floor_dbm", "detection_slope_db", "miss_probability", "device_sensitivity_std_db")
_PHONE = {key: RADIO_PRESETS["radio-semi-indoor"][key] for key in _PHONE_SETTINGS}
"""The same five phones were used at all three places: their detection was fitted at NTU."""
_STOREYS = {"radio-sutd-indoor": (0, 1, -1, 2, -2, 3, -3)}
"""1,921 addresses are too many for one floor of 5,000 m2: other storeys hold access points too."""


@lru_cache(maxsize=16)
def _stroll(name: str, length_m: float, seed: int) -> RadioSurvey:
    """A walk without readings, the same for both radios."""
    return places.stroll(load_map(name), length_m, _STROLL_STEP_M, _STROLL_SPEED_M_S, seed)


class _FingerprintSlam(Study):
    """Walks of a robot with five phones."""

    def __init__(self, place: str, kind: str):
        is_fitted = place == "radio-ntu" or (place, kind) == ("radio-sutd-outdoor", "wifi")
        is_lte = kind == "lte"
        changes: dict = {"cells": {"count": _cells(place)}} if is_lte else {"high_band": {"share": 0.5}}
        if (place, kind) == ("radio-sutd-indoor", "wifi"):
            changes |= _PHONE
        super().__init__(
            f"paper {place} {kind}",
            "calibrated" if is_fitted else "reported",
            "lte" if is_lte else _WIFI_PRESET[place],
            changes,
        )
        self._place, self._kind = place, kind

    def real(self, folder: Path, quick: bool) -> Figures:
        return dict(zip(_QUANTITIES, _PRINTED[self._place, self._kind], strict=False))

    def simulated(self, folder: Path, config: RadioConfig, seed: int, quick: bool) -> Figures:
        plan = places.over_storeys(load_map(self._place), _STOREYS.get(self._place, (0,)))
        walk, is_pair = self._walk(seed, quick)
        model = places.RememberingModel(config, plan)
        phones = [places.simulate(walk, plan, config, _PHONES * seed + k, model=model) for k in range(_PHONES)]
        return similarity_figures(walk, places.merged(phones).rssi_dbm, is_pair, _OFFSET_DB[self._kind])

    def _walk(self, seed: int, quick: bool) -> tuple[RadioSurvey, Array]:
        """A walk (n) without readings, and which pairs (n, n) of its places are within the window."""
        walk = _stroll(self._place, 100.0 if quick else _STROLL_M, seed)
        travel_m = walk.time_s * _STROLL_SPEED_M_S
        return walk, np.abs(travel_m[:, None] - travel_m[None]) < _WINDOW_M[self._kind]


def _cells(name: str) -> int:
    fitted = RADIO_PRESETS["lte"]["cells"]["count"]
    return round(fitted * _CELLS_HEARD[name] / _CELLS_HEARD["radio-ntu"])


FINGERPRINT_SLAM = tuple(_FingerprintSlam(place, kind) for place, kind in _PRINTED)

_ROUTERS, _SMOOTHED = {"E3": 1, "E5": 2}, {"E3": 25, "E5": 1}
"""Number of routers, and of samples over which the authors smoothed (papers.md K6), by experiment."""
_WALK_SPEED_M_S = 0.3
_WALL_DB = 16.7
_AUTHORS_FLAT = {
    "path_loss_exponent": 2.2,
    "distance_min_m": 0.35,
    "wall_loss_scale": 0.9,
    "wall_loss_limit_db": 12.5,
    "shadowing_std_db": 3.35,
    "shadowing_length_m": 0.3,
    "noise_std_db": 2.5,
}
"""Fitted to E3 with known rooms; further walls add almost no loss there, as in the flat with BLE anchors. The power of
the routers follows from near readings in line of sight, the wall loss from 5 GHz where available. The preset `sfw` is
for the twins, whose rooms are designed to give the printed classes: there strength decreases less with distance."""
_FITTED = "E3"
_MAP_CELL_M = 0.1
_NEAR_M = 3.0


class _KVisibility(Study):
    """The authors' own walks, routers and LiDAR map."""

    def __init__(self, experiment: str, role: str):
        super().__init__(f"sfw_authors {experiment}", role, "sfw", _AUTHORS_FLAT, runs=4)
        self._experiment, self._routers = experiment, _ROUTERS[experiment]

    def real(self, folder: Path, quick: bool) -> Figures:
        return _class_figures(_low_band(_laid(folder, self._routers).walk))

    def simulated(self, folder: Path, config: RadioConfig, seed: int, quick: bool) -> Figures:
        heard = _heard_in_flat(folder, self._experiment, config, seed).rssi_dbm
        window = _SMOOTHED[self._experiment]
        return _class_figures([_smoothed(level[np.isfinite(level)], window) for level in heard.T])

    def spread(self, folder: Path, quick: bool) -> Spread:
        mine, others = (
            [_class_figures([level]) for level in _low_band(_laid(folder, routers).walk)]
            for routers in sorted(_ROUTERS.values(), key=lambda routers: routers != self._routers)
        )
        return {
            name: _range(value, [router[name] for router in mine], [router[name] for router in others])
            for name, value in self.real(folder, quick).items()
        }


def _heard_in_flat(folder: Path, experiment: str, config: RadioConfig, seed: int) -> RadioSurvey:
    """Simulated readings along the walk of an experiment."""
    laid = _laid(folder, _ROUTERS[experiment])
    walk, plan = _walk_and_plan(laid)
    share = _wall_loss_db(laid) / _wall_loss_db(_laid(folder, _ROUTERS[_FITTED]))
    told = {name: share * getattr(config, name) for name in ("wall_loss_scale", "wall_loss_limit_db")}
    config = with_settings(config, {"power_at_1m_dbm": _power_in_sight(laid, walk, plan, config), **told})
    return places.simulate(walk, places.another(plan, seed), config, seed, phones=False)


def _power_in_sight(laid: LaidWalk, walk: RadioSurvey, plan: Floorplan, config: RadioConfig) -> float:
    """Strength at 1 m [dBm] of the routers of an experiment, from near readings in line of sight."""
    powers = []
    for point, level in zip(plan.access_points, _low_band(laid.walk), strict=True):
        apart_m = np.maximum(np.linalg.norm(walk.position_m - point.position_m, axis=1), config.distance_min_m)
        walls = plan.wall_index.crossing(point.position_m, walk.position_m)[0]
        is_near = (apart_m < _NEAR_M) & (walls == 0)
        powers.append(np.mean(level[is_near] + 10 * config.path_loss_exponent * np.log10(apart_m[is_near])))
    return float(np.mean(powers))


@lru_cache(maxsize=2)
def _wall_loss_db(laid: LaidWalk) -> float:
    """Loss behind walls at 2.4 GHz, from the 5 GHz columns if the log has them, since these are not evaluated.

    The ratio of losses at 5 and 2.4 GHz is that of the default settings. Doors may be open in one experiment only.
    """
    first = np.unique(laid.walk.router_of, return_index=True)[1]
    high = np.setdiff1d(np.arange(len(laid.walk.router_of)), first)
    if not len(high):
        return float(np.mean([_behind_walls_db(laid, k, laid.walk.rssi_dbm[:, k]) for k in first]))
    losses = [_behind_walls_db(laid, k, laid.walk.rssi_dbm[:, k]) for k in high]
    return float(np.mean(losses)) / HighBandConfig().wall_loss_factor


def _behind_walls_db(laid: LaidWalk, column: int, rssi_dbm: Array) -> float:
    """Loss of the readings (k,) of a column behind any number of walls [dB]."""
    walk, plan = _walk_and_plan(laid)
    router_m = plan.access_points[laid.walk.router_of[column]].position_m
    behind = plan.wall_index.crossing(router_m, walk.position_m)[0] > 0
    apart_m, heard = np.linalg.norm(walk.position_m - router_m, axis=1), np.isfinite(rssi_dbm)
    return fit_path_loss(apart_m[heard], rssi_dbm[heard], behind[heard]).wall_loss_db


K_VISIBILITY = (_KVisibility("E3", "calibrated"), _KVisibility("E5", "reported"))
"""The experiment with one router is calibrated, the one with two is reported."""


@lru_cache(maxsize=2)
def _laid(folder: Path, routers: int) -> LaidWalk:
    return lay(folder / "sfw_authors", routers)


def _low_band(walk: AuthorsWalk) -> list[Array]:
    """Readings of each router at 2.4 GHz, its first column."""
    return [walk.rssi_dbm[:, int(np.flatnonzero(walk.router_of == router)[0])] for router in np.unique(walk.router_of)]


def _walk_and_plan(laid: LaidWalk) -> tuple[RadioSurvey, Floorplan]:
    """The walk as a survey without readings, and the rooms of the LiDAR map with the authors' routers."""
    at_m = laid.placed.position_m
    travel_m = travelled_m(at_m)
    zeros = np.zeros(len(at_m), int)
    walk = RadioSurvey("authors' flat", at_m, zeros, travel_m / _WALK_SPEED_M_S, zeros, (), np.zeros((len(at_m), 0)))
    plan = plan_from_free(laid.cells.free, _MAP_CELL_M, walk.name, laid.cells.origin_m.tolist())
    routers = [
        laid.placed.router_m[np.flatnonzero(laid.walk.router_of == k)[0]] for k in np.unique(laid.walk.router_of)
    ]
    points = tuple(AccessPoint(f"router-{k}", place, (k + 1,)) for k, place in enumerate(routers))
    return walk, dataclasses.replace(
        plan, wall_loss_db=np.full(len(plan.walls_m), _WALL_DB / places.WALL_FACES), access_points=points
    )


def _range(real: float, mine: list[float], others: list[float]) -> tuple[float, float, float]:
    """Range over the routers of both experiments, and the share of the other experiment's routers near a figure."""
    return float(np.nanmin(mine + others)), float(np.nanmax(mine + others)), share_near(np.array(others), real)


def _class_figures(levels_dbm: list[Array]) -> Figures:
    """Spread of the readings, and share, mean and spread of each class; means over routers."""
    found: list[Figures] = []
    for level in levels_dbm:
        figures: Figures = {"mean RSS [dBm]": float(level.mean()), "sd of all readings [dB]": float(level.std())}
        walls = np.digitize(-level, [-t for t in THRESHOLDS_DBM])
        for k in range(len(THRESHOLDS_DBM) + 1):
            mine = level[walls == k]
            figures[f"share in class {k}"] = len(mine) / len(level)
            figures[f"mean RSS of class {k} [dBm]"] = float(mine.mean()) if len(mine) else float("nan")
            figures[f"sd within class {k} [dB]"] = float(mine.std()) if len(mine) else float("nan")
        found.append(figures)
    means = {name: float(np.nanmean([figures[name] for figures in found])) for name in found[0]}
    for k in range(len(THRESHOLDS_DBM)):
        step = means[f"mean RSS of class {k} [dBm]"] - means[f"mean RSS of class {k + 1} [dBm]"]
        means[f"step from class {k} to {k + 1} [dB]"] = step
    return means


def _smoothed(levels: Array, window: int) -> Array:
    return np.convolve(levels, np.full(window, 1.0 / window), "valid")
