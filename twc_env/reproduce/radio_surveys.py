"""Published radio surveys and the radio model at the same places: offices, a library, a flat.

What belongs to a place or a device is taken from the set as an input and never judged: where the access points stand or
how many there are, which surveyed points share a room, and how faint signals each receiver still hears. All else is the
preset's.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twc_env.config import RadioConfig
from twc_env.datasets.ble_flat import read_ble_run, read_flat
from twc_env.datasets.fingerprints import RadioSurvey
from twc_env.datasets.sod_indoor_loc import read_sod
from twc_env.datasets.uji_library import read_uji_library
from twc_env.metrics.radio import detection_rates, fit_path_loss, mean_rssi_by_walls, spread_at_points
from twc_env.reproduce import radio_places as places
from twc_env.reproduce.radio_rooms import surveyed_rooms
from twc_env.reproduce.radio_study import (
    Figures,
    Spread,
    Study,
    device_hearing,
    extent,
    spread_over,
    thinned,
    with_settings,
)
from twc_env.world.floorplan import Floorplan

Array = NDArray

_DISTANCES_M = np.array([0.0, 10.0, 20.0, 30.0, 40.0, 50.0])
_NEAR_BY_M = 10.0
_FLOORS_AWAY = 2
_WALLS_MAX = 2
_WALL_FACES = 2
"""Lines of the flat's outline that one wall crossing meets."""
_HEARD_MIN = 8

# --- offices with known access points (SODIndoorLoc) ------------------------------------------------------------------


def office_studies() -> Iterator[Study]:
    """Places and storeys of the access points are known, and of each point the kind of room and the phone."""
    for building, role, reasons in (
        ("CETC331", "calibrated", _OFFICE_REASONS),
        ("SYL", "reported", _SECOND_OFFICE_REASONS),
    ):

        def survey(folder: Path, quick: bool, building: str = building) -> RadioSurvey:
            true = read_sod(folder / "wifi" / "sod", building)
            return thinned(true.of_transmitters(_is_heard_near_by(true)), quick)

        def real(folder: Path, quick: bool, survey=survey) -> Figures:
            return _office_figures(survey(folder, quick), survey(folder, quick).rssi_dbm)

        def simulated(folder: Path, config: RadioConfig, seed: int, quick: bool, survey=survey) -> Figures:
            true = survey(folder, quick)
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

        def spread(folder: Path, quick: bool, survey=survey) -> Spread:
            true = survey(folder, quick)
            _, box = np.unique(np.column_stack(true.transmitters[:2]), axis=0, return_inverse=True)
            columns = [np.flatnonzero(box == number) for number in range(box.max() + 1)]

            def of_boxes(drawn: Array) -> Figures:
                some = true.of_transmitters(np.concatenate([columns[number] for number in drawn]))
                return _office_figures(some, some.rssi_dbm)

            return spread_over(len(columns), of_boxes)

        changes = {"high_band": {"share": 0.5}}
        yield Study(f"wifi/sod {building}", role, "radio-indoor", changes, real, simulated, reasons, spread, runs=4)


_OFFICE_REASONS = {
    "detection rate": "through ceilings a rate rests on the few access points that are that far: another building of "
    "the kind differs by as much",
}
_SECOND_OFFICE_REASONS = {
    "detection rate": "here a phone misses up to one strong 2.4 GHz signal in six, which the levels of what it hears "
    "do not tell; at 5 GHz what is heard 45 m off is 10 dB above what gets lost, as if the corridor guided it",
}


def _is_heard_near_by(survey: RadioSurvey) -> Array:
    """(t,) whether any scan near an access point heard its address: else it was off, or stands elsewhere than told."""
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


# --- samples at fixed points (UJI library) ----------------------------------------------------------------------------


def library_studies() -> Iterator[Study]:
    """Twelve samples at each of 48 points."""
    for month, role in (("01", "calibrated"), ("13", "reported")):

        def survey(folder: Path, month: str = month) -> RadioSurvey:
            return read_uji_library(folder / "wifi" / "uji_lib", month)

        def real(folder: Path, quick: bool, survey=survey) -> Figures:
            return _library_figures(survey(folder), survey(folder).rssi_dbm)

        def simulated(folder: Path, config: RadioConfig, seed: int, quick: bool, survey=survey) -> Figures:
            true = survey(folder)
            around = extent(true.position_m, 15.0)
            plan = places.office(true.name, around)
            plan = places.with_spread_transmitters(plan, 40, len(true.addresses), seed, floors=(0, 0, 1, -1))
            return _library_figures(true, places.simulate(true, plan, config, seed, phones=False).rssi_dbm)

        def spread(folder: Path, quick: bool, survey=survey) -> Spread:
            true = survey(folder)
            return spread_over(len(true.addresses), lambda drawn: _library_figures(true, true.rssi_dbm[:, drawn]))

        changes = {"bssids_per_access_point": 0, "high_band": {"share": 0.5}}
        yield Study(
            f"wifi/uji_lib {month}", role, "radio-indoor", changes, real, simulated, _LIBRARY_REASONS, spread, runs=4
        )


_LIBRARY_REASONS = {"": "the same points differ by a quarter a year later: 3.4 and 4.3 dB"}


def _library_figures(survey: RadioSurvey, rssi_dbm: Array) -> Figures:
    return {"sd at a fixed point [dB]": spread_at_points(survey.walk, rssi_dbm, _HEARD_MIN)}


# --- walls of a flat (BLE) --------------------------------------------------------------------------------------------

_FLAT_WALL_DB = 6.5
_BLE_TAG = {
    "power_at_1m_dbm": -50.5,
    "miss_probability": 0.1,
    "path_loss_exponent": 0.72,
    "wall_loss_scale": 1.0,
    "shadowing_std_db": 3.7,
    "shadowing_length_m": 1.5,
    "fading_std_db": 3.9,
    "access_point_spread_db": 1.5,
    "power_spread_db": 0.0,
    "high_band": {"share": 0.0},
}
"""A tag on a robot in rooms of 4 m: short ways on which reflections make up for distance."""


def flat_studies() -> Iterator[Study]:
    """Six anchors and a wall plan."""
    for runs, role in ((("calibration",), "calibrated"), (("calib3", "calib4"), "reported")):

        def surveys(folder: Path, quick: bool, runs=runs) -> list[RadioSurvey]:
            return [thinned(read_ble_run(folder / "wifi" / "ble_lidar", run), quick) for run in runs]

        def place(folder: Path) -> Floorplan:
            return places.flat(read_flat(folder / "wifi" / "ble_lidar"), _FLAT_WALL_DB)

        def real(folder: Path, quick: bool, surveys=surveys, place=place) -> Figures:
            own = surveys(folder, quick)
            return _flat_figures(*_flat_ways(own, place(folder)), _together(own))

        def simulated(
            folder: Path, config: RadioConfig, seed: int, quick: bool, surveys=surveys, place=place
        ) -> Figures:
            own, plan = surveys(folder, quick), places.another(place(folder), seed)
            heard = [places.simulate(survey, plan, config, seed, phones=False) for survey in own]
            return _flat_figures(*_flat_ways(own, plan), _together(heard))

        def spread(folder: Path, quick: bool, surveys=surveys, place=place) -> Spread:
            own = surveys(folder, quick)
            distance_m, walls = _flat_ways(own, place(folder))
            rssi = _together(own)

            def of_anchors(drawn: Array) -> Figures:
                return _flat_figures(distance_m[:, drawn], walls[:, drawn], rssi[:, drawn])

            return spread_over(rssi.shape[1], of_anchors)

        name = f"wifi/ble_lidar {'+'.join(runs)}"
        yield Study(name, role, "radio-indoor", _BLE_TAG, real, simulated, _FLAT_REASONS, spread, runs=4)


_FLAT_REASONS = {
    "path-loss exponent": "drives meet few anchors near by: with other anchors of the same flat it lies anywhere from "
    "below 0 to 2",
    "loss per wall": "walls and distance rise together in a small flat: the fit trades one for the other",
}


def _together(surveys: list[RadioSurvey]) -> Array:
    """(scans, anchors) readings of all drives."""
    return np.concatenate([survey.rssi_dbm for survey in surveys])


def _flat_ways(surveys: list[RadioSurvey], plan: Floorplan) -> tuple[Array, Array]:
    """(scans, anchors) distance, and walls in between."""
    distances, walls = [], []
    for survey in surveys:
        transmitter_m = survey.transmitters[0]
        crossed = np.array([plan.wall_index.crossing(place, transmitter_m)[0] for place in survey.position_m])
        distances.append(np.linalg.norm(survey.position_m[:, None] - transmitter_m[None], axis=2))
        walls.append((crossed + 1) // _WALL_FACES)
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
