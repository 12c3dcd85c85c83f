"""Published radio surveys and the radio model at the same places: a library and a flat.

Properties of a place or device are inputs and not evaluated: positions of anchors or the number of access points. All
other settings are those of the preset.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import RadioConfig
from twc_env.datasets.surveys.ble_flat import read_ble_run, read_flat
from twc_env.datasets.surveys.fingerprints import RadioSurvey
from twc_env.datasets.surveys.uji_library import read_uji_library
from twc_env.metrics.radio import fit_path_loss, mean_rssi_by_walls, spread_at_points
from twc_env.reproduce import radio_places as places
from twc_env.reproduce.radio.radio_study import Figures, Spread, Study, extent, spread_over, subsampled
from twc_env.world.building.floorplan import Floorplan

_WALLS_MAX = 2
_HEARD_MIN = 8

# --- samples at fixed points (UJI library) ----------------------------------------------------------------------------


class _Library(Study):
    """Twelve samples at each of 48 points."""

    def __init__(self, month: str, role: str):
        changes = {"bssids_per_access_point": 0, "high_band": {"share": 0.5}}
        super().__init__(f"wifi/uji_lib {month}", role, "radio-indoor", changes, runs=4)
        self._month = month

    def real(self, folder: Path, quick: bool) -> Figures:
        true = _library(folder, self._month)
        return _library_figures(true, true.rssi_dbm)

    def simulated(self, folder: Path, config: RadioConfig, seed: int, quick: bool) -> Figures:
        true = _library(folder, self._month)
        plan = places.office(true.name, extent(true.position_m, 15.0))
        plan = places.with_spread_transmitters(plan, 40, len(true.addresses), seed, floors=(0, 0, 1, -1))
        return _library_figures(true, places.simulate(true, plan, config, seed, phones=False).rssi_dbm)

    def spread(self, folder: Path, quick: bool) -> Spread:
        true = _library(folder, self._month)
        return spread_over(len(true.addresses), lambda drawn: _library_figures(true, true.rssi_dbm[:, drawn]))


LIBRARIES = (_Library("01", "calibrated"), _Library("13", "reported"))


def _library(folder: Path, month: str) -> RadioSurvey:
    return read_uji_library(folder / "wifi" / "uji_lib", month)


def _library_figures(survey: RadioSurvey, rssi_dbm: Array) -> Figures:
    return {"sd at a fixed point [dB]": spread_at_points(survey.walk, rssi_dbm, _HEARD_MIN)}


# --- walls of a flat (BLE) --------------------------------------------------------------------------------------------

_FLAT_WALL_DB = 8.0
_BLE_TAG = {
    "power_at_1m_dbm": -49.5,
    "miss_probability": 0.1,
    "path_loss_exponent": 0.9,
    "wall_loss_scale": 1.0,
    "wall_loss_limit_db": 14.5,
    "shadowing_std_db": 3.3,
    "shadowing_length_m": 1.5,
    "fading_std_db": 4.4,
    "access_point_spread_db": 1.5,
    "power_spread_db": 0.0,
    "high_band": {"share": 0.0},
}
"""A tag on a robot in rooms of 4 m: over short distances reflections compensate for distance."""
_OWN_WALKS = (0, 1)
"""Walks of the calibration run that are calibrated; its other two are the reported runs."""


class _Flat(Study):
    """Six anchors and a wall plan."""

    def __init__(self, role: str, *runs: str):
        name = f"wifi/ble_lidar {'+'.join(runs)}"
        super().__init__(name, role, "radio-indoor", _BLE_TAG, runs=4)
        self._drives = runs

    def real(self, folder: Path, quick: bool) -> Figures:
        own = self._surveys(folder, quick)
        return _flat_figures(*_flat_ways(own, _flat_plan(folder)), _together(own))

    def simulated(self, folder: Path, config: RadioConfig, seed: int, quick: bool) -> Figures:
        own, plan = self._surveys(folder, quick), places.another(_flat_plan(folder), seed)
        heard = [places.simulate(survey, plan, config, seed, phones=False) for survey in own]
        return _flat_figures(*_flat_ways(own, plan), _together(heard))

    def spread(self, folder: Path, quick: bool) -> Spread:
        own = self._surveys(folder, quick)
        distance_m, walls = _flat_ways(own, _flat_plan(folder))
        rssi = _together(own)

        def of_anchors(drawn: Array) -> Figures:
            return _flat_figures(distance_m[:, drawn], walls[:, drawn], rssi[:, drawn])

        return spread_over(rssi.shape[1], of_anchors)

    def _surveys(self, folder: Path, quick: bool) -> list[RadioSurvey]:
        read = [read_ble_run(folder / "wifi" / "ble_lidar", run) for run in self._drives]
        return [subsampled(survey.at_scans(np.isin(survey.walk, _OWN_WALKS)), quick) for survey in read]


FLATS = (_Flat("calibrated", "calibration"), _Flat("reported", "calib3", "calib4"))


def _flat_plan(folder: Path) -> Floorplan:
    return places.flat(read_flat(folder / "wifi" / "ble_lidar"), _FLAT_WALL_DB)


def _together(surveys: list[RadioSurvey]) -> Array:
    """(scans, anchors) readings of all drives."""
    return np.concatenate([survey.rssi_dbm for survey in surveys])


def _flat_ways(surveys: list[RadioSurvey], plan: Floorplan) -> tuple[Array, Array]:
    """(scans, anchors) distances, and walls in between."""
    distances, walls = [], []
    for survey in surveys:
        transmitter_m = survey.transmitters[0]
        crossed = np.array([plan.wall_index.crossing(place, transmitter_m)[0] for place in survey.position_m])
        distances.append(np.linalg.norm(survey.position_m[:, None] - transmitter_m[None], axis=2))
        walls.append(places.walls_of(crossed))
    return np.concatenate(distances), np.concatenate(walls)


def _flat_figures(distances_m: Array, walls: Array, rssi_dbm: Array) -> Figures:
    heard = np.isfinite(rssi_dbm)
    distance_m, strength, wall = distances_m[heard], rssi_dbm[heard], walls[heard]
    bare, walled = fit_path_loss(distance_m, strength), fit_path_loss(distance_m, strength, wall)
    figures = {
        "path-loss exponent without walls": bare.exponent,
        "path-loss exponent with walls": walled.exponent,
        "loss per wall [dB]": walled.wall_loss_db,
        "residual sd without walls [dB]": bare.residual_std_db,
        "residual sd with walls [dB]": walled.residual_std_db,
    }
    for count, mean in enumerate(mean_rssi_by_walls(wall, strength, _WALLS_MAX)):
        figures[f"mean RSS behind {count} walls [dBm]"] = float(mean)
    return figures
