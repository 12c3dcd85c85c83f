"""Similarity of fingerprints by distance: phones in two malls, and a laptop on a robot on an office floor.

Properties of a place or device are inputs and not evaluated: the number of transmitters, the reporting of weak signals,
and the share of missed strong ones. All other settings are those of the preset.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import RadioConfig
from twc_env.datasets.buildings.geojson import read_geojson
from twc_env.datasets.surveys.fingerprints import RadioSurvey
from twc_env.datasets.surveys.indoor20 import FRESH_S, read_indoor20
from twc_env.datasets.surveys.uw_floor import read_uw_floor
from twc_env.reproduce import radio_places as places
from twc_env.reproduce.radio.radio_hearing import missed_by_sweeps
from twc_env.reproduce.radio.radio_study import (
    Figures,
    Spread,
    Study,
    extent,
    similarity_figures,
    spread_over,
    subsampled,
    with_settings,
)

_APART_S = 30.0
_ADDRESSES_PER_BOX = 4.83
_MALL_DRAWS = 40
_MALL_CELL_M = 0.5
_CONCOURSE_WIDTH_M, _SHOP_DEPTH_M = 4.0, 8.64
"""Access points are within this depth (fitted) of floor at least this wide: in shops along concourses, not along
service corridors."""
_FITTED = "site1_B1"


class _Mall(Study):
    """Phones of one model carried by walkers; their scans repeat old readings."""

    def __init__(self, floor: str, role: str, boxes_per_m2: float, high_share: float):
        changes = {"high_band": {"share": high_share}}
        super().__init__(f"indoor20 {floor}", role, "radio-mall", changes)
        self._floor, self._boxes_per_m2 = floor, boxes_per_m2

    def real(self, folder: Path, quick: bool) -> Figures:
        return _mall_figures(_mall(folder, self._floor, quick))

    def simulated(self, folder: Path, config: RadioConfig, seed: int, quick: bool) -> Figures:
        plan = read_geojson(folder / "indoor20" / self._floor / "geojson_map.json.gz", seed)
        shops = places.beside_wide_floor(plan.cells(_MALL_CELL_M), _CONCOURSE_WIDTH_M, _SHOP_DEPTH_M)
        boxes = round(self._boxes_per_m2 * float(shops.free.sum()) * _MALL_CELL_M**2)
        addresses = round(_ADDRESSES_PER_BOX * boxes)
        plan = places.with_spread_transmitters(plan, boxes, addresses, seed, floors=(0, 0, 1, -1), around=shops)
        config = with_settings(config, _missed_beside_the_fit(folder, self._floor, config, quick))
        return _mall_figures(places.simulate(_mall(folder, self._floor, quick), plan, config, seed))

    def spread(self, folder: Path, quick: bool) -> Spread:
        true = _mall(folder, self._floor, quick)
        scans = [np.flatnonzero(true.walk == walk) for walk in np.unique(true.walk)]

        def of_walks(drawn: Array) -> Figures:
            return _mall_figures(true.at_scans(np.concatenate([scans[walk] for walk in drawn])))

        return spread_over(len(scans), of_walks, _MALL_DRAWS)


@lru_cache(maxsize=2)
def _mall(folder: Path, floor: str, quick: bool) -> RadioSurvey:
    """All readings of one floor, including old ones."""
    return read_indoor20(folder / "indoor20" / floor, np.inf, traces_max=12 if quick else None)


@lru_cache(maxsize=2)
def _missed(folder: Path, floor: str, quick: bool) -> tuple[float, float]:
    """Share of strong signals that sweeps miss at 2.4 and at 5 GHz."""
    return missed_by_sweeps(_mall(folder, floor, quick), False), missed_by_sweeps(_mall(folder, floor, quick), True)


def _missed_beside_the_fit(folder: Path, floor: str, config: RadioConfig, quick: bool) -> dict:
    """Settings for a floor whose sweeps miss more strong signals than on the floor of the fit: the phones are of one
    model, but channels may be crowded."""
    low, high = np.subtract(_missed(folder, floor, quick), _missed(folder, _FITTED, quick)).tolist()
    return {
        "miss_probability": max(0.0, config.miss_probability + low),
        "high_band": {"miss_probability_offset": config.high_band.miss_probability_offset + high - low},
    }


def _mall_figures(survey: RadioSurvey) -> Figures:
    """Similarity of the fresh readings, and ages of the others."""
    fresh, heard = survey.fresh(FRESH_S), np.isfinite(survey.rssi_dbm)
    age_s = survey.age_s[heard] if survey.age_s is not None else np.zeros(1)
    is_high = np.broadcast_to(False if survey.is_high_band is None else survey.is_high_band, heard.shape)
    is_other_walk = survey.walk[:, None] != survey.walk[None]
    return {
        **similarity_figures(fresh, fresh.rssi_dbm, is_other_walk),
        "rows per scan": float(heard.sum(axis=1).mean()),
        "age of rows: median [s]": float(np.median(age_s)),
        "age of rows: 95 % [s]": float(np.quantile(age_s, 0.95)),
        "share of rows at 5 GHz": float(is_high[heard].mean()),
        "sd of transmitters per scan": float(np.isfinite(fresh.rssi_dbm).sum(axis=1).std()),
    }


MALLS = (_Mall("site1_B1", "calibrated", 0.011, 0.5), _Mall("site2_F6", "reported", 0.025, 0.68))
"""With access points per m2 of concourse and shops, and the share of addresses at 5 GHz. Fitted to site1_B1; on
site2_F6 both are scaled so that the numbers of addresses heard at least ten times, and of those at 5 GHz, have the same
ratio to the real ones as on site1_B1."""


_ROBOT_FAINTEST_DBM = -90.0
"""The log reports weaker signals, a third of its readings, as this value."""
_ROBOT_ROOMS = (5.0, 5.0)
"""Fitted width [m] and wall loss [dB] of the rooms of the simulated floor."""
_ROBOT_RECEIVER = {"detection_floor_dbm": -93.8, "detection_slope_db": 2.0, "high_band": {"share": 0.0}}


class _RobotFloor(Study):
    """A laptop on a robot: each scan is a whole sweep."""

    def real(self, folder: Path, quick: bool) -> Figures:
        true = self._survey(folder, quick)
        return similarity_figures(true, true.rssi_dbm, _apart_in_time(true))

    def simulated(self, folder: Path, config: RadioConfig, seed: int, quick: bool) -> Figures:
        true = self._survey(folder, quick)
        plan = places.office(true.name, extent(true.position_m, 3.0), *_ROBOT_ROOMS)
        around = extent(true.position_m, 20.0)
        plan = places.with_spread_transmitters(
            plan, len(true.addresses), len(true.addresses), seed, around, (0, 0, 1, -1)
        )
        rssi = places.simulate(true, plan, config, seed, phones=False).rssi_dbm
        return similarity_figures(true, np.maximum(rssi, _ROBOT_FAINTEST_DBM), _apart_in_time(true))

    def spread(self, folder: Path, quick: bool) -> Spread:
        true = self._survey(folder, quick)
        is_pair = _apart_in_time(true)
        return spread_over(len(true.addresses), lambda k: similarity_figures(true, true.rssi_dbm[:, k], is_pair))

    def _survey(self, folder: Path, quick: bool) -> RadioSurvey:
        return subsampled(read_uw_floor(folder / "wifi" / "uw_floor" / "uw-floor.txt"), quick)


ROBOT_FLOOR = _RobotFloor("wifi/uw_floor", "calibrated", "radio-indoor", _ROBOT_RECEIVER)


def _apart_in_time(survey: RadioSurvey) -> Array:
    return np.abs(survey.time_s[:, None] - survey.time_s[None]) > _APART_S
