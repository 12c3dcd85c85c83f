"""Offices with known access points (SODIndoorLoc), and the radio model at the same places.

Properties of a place or device are inputs and not evaluated: positions of access points, which surveyed points share a
room, and the detection floor of each phone. All other settings are those of the preset.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import RadioConfig
from twc_env.datasets.surveys.fingerprints import RadioSurvey
from twc_env.datasets.surveys.sod_indoor_loc import read_sod
from twc_env.metrics.radio import detection_rates, fit_path_loss
from twc_env.reproduce import radio_places as places
from twc_env.reproduce.radio.radio_hearing import device_hearing
from twc_env.reproduce.radio.radio_rooms import surveyed_rooms
from twc_env.reproduce.radio.radio_study import Figures, Spread, Study, extent, spread_over, subsampled, with_settings

_DISTANCES_M = np.array([0.0, 10.0, 20.0, 30.0, 40.0, 50.0])
_NEAR_BY_M = 10.0
_FLOORS_AWAY = 2


class _Office(Study):
    """Known are positions and storeys of access points, and room type and phone of each point."""

    def __init__(self, building: str, role: str):
        changes = {"high_band": {"share": 0.5}}
        super().__init__(f"wifi/sod {building}", role, "radio-indoor", changes, runs=4)
        self._building = building

    def real(self, folder: Path, quick: bool) -> Figures:
        true = self._survey(folder, quick)
        return _office_figures(true, true.rssi_dbm)

    def simulated(self, folder: Path, config: RadioConfig, seed: int, quick: bool) -> Figures:
        true = self._survey(folder, quick)
        rssi = np.full(true.rssi_dbm.shape, np.nan, np.float32)
        for floor in np.unique(true.floor).tolist():
            rooms = places.another(surveyed_rooms(true, floor, extent(true.position_m, 2.0)), seed)
            equipped = places.with_known_transmitters(rooms, true, floor)
            for phone in np.unique(true.walk).tolist():
                mine = true.walk == phone
                own = with_settings(config, device_hearing(true.at_scans(mine)))
                here = np.flatnonzero(mine & (true.floor == floor))
                rssi[here] = places.simulate(true.at_scans(here), equipped, own, seed).rssi_dbm
        return _office_figures(true, rssi)

    def spread(self, folder: Path, quick: bool) -> Spread:
        true = self._survey(folder, quick)
        _, box = np.unique(np.column_stack(true.transmitters[:2]), axis=0, return_inverse=True)
        columns = [np.flatnonzero(box == number) for number in range(box.max() + 1)]

        def of_boxes(drawn: Array) -> Figures:
            some = true.of_transmitters(np.concatenate([columns[number] for number in drawn]))
            return _office_figures(some, some.rssi_dbm)

        return spread_over(len(columns), of_boxes)

    def _survey(self, folder: Path, quick: bool) -> RadioSurvey:
        true = read_sod(folder / "wifi" / "sod", self._building)
        return subsampled(true.of_transmitters(_is_heard_near_by(true)), quick)


OFFICES = (_Office("CETC331", "calibrated"), _Office("SYL", "reported"))


def _is_heard_near_by(survey: RadioSurvey) -> Array:
    """(t,) whether any scan near an access point heard its address; else it was off or its position is wrong."""
    transmitter_m, storeys, _ = survey.transmitters
    apart_m = np.linalg.norm(survey.position_m[:, None] - transmitter_m[None], axis=2)
    is_near = (apart_m < _NEAR_BY_M) & (survey.floor[:, None] == storeys[None])
    return (is_near & np.isfinite(survey.rssi_dbm)).any(axis=0)


def _office_figures(survey: RadioSurvey, rssi_dbm: Array) -> Figures:
    transmitter_m, storeys, on_high_band = survey.transmitters
    apart_m = np.linalg.norm(survey.position_m[:, None] - transmitter_m[None], axis=2)
    ceilings = np.abs(survey.floor[:, None] - storeys[None])
    heard = np.isfinite(rssi_dbm)
    figures: Figures = {}
    for band, is_high in (("2.4 GHz", False), ("5 GHz", True)):
        mine = (on_high_band == is_high)[None] & (ceilings == 0)
        fit = fit_path_loss(apart_m[mine & heard], rssi_dbm[mine & heard])
        figures[f"path-loss exponent without walls, {band}"] = fit.exponent
        figures[f"residual sd without walls [dB], {band}"] = fit.residual_std_db
        figures[f"mean RSS at 10 m [dBm], {band}"] = fit.power_at_1m_dbm - 10 * fit.exponent
        for away in range(min(_FLOORS_AWAY, int(ceilings.max())) + 1):
            mine = (on_high_band == is_high)[None] & (ceilings == away)
            rates = detection_rates(apart_m[mine], heard[mine], _DISTANCES_M)
            for near, rate in zip(_DISTANCES_M[:-1], rates, strict=True):
                name = f"detection rate {near:.0f}-{near + 10:.0f} m, {band}, {away} floors away"
                figures[name] = float(rate)
    return figures
