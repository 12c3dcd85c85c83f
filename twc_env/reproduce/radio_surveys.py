"""Published radio surveys and the radio model at the same places: offices, a library, a flat, malls, a robot's floor.

What belongs to a place or a device is taken from the set as an input and never judged: where the access points stand or
how many there are, and how faint the receiver's faintest readings are. All else is the preset's.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twc_env.config import RadioConfig
from twc_env.datasets.ble_flat import read_ble_run, read_flat
from twc_env.datasets.fingerprints import RadioSurvey
from twc_env.datasets.geojson import read_geojson
from twc_env.datasets.indoor20 import FRESH_S, read_indoor20
from twc_env.datasets.sod_indoor_loc import read_sod
from twc_env.datasets.uji_library import read_uji_library
from twc_env.datasets.uw_floor import read_uw_floor
from twc_env.metrics.radio import detection_rates, fit_path_loss, mean_rssi_by_walls, spread_at_points
from twc_env.reproduce import radio_places as places
from twc_env.reproduce.radio_study import (
    Figures,
    Study,
    device_floors,
    extent,
    faintest_dbm,
    similarity_figures,
    thinned,
    with_settings,
)
from twc_env.world.floorplan import Floorplan

Array = NDArray

_DISTANCES_M = np.array([0.0, 10.0, 20.0, 30.0, 40.0, 50.0])
_FLOORS_AWAY = 2
_WALLS_MAX = 2
_WALL_FACES = 2
"""Lines of the flat's outline that one wall crossing meets."""
_HEARD_MIN = 8
_APART_S = 30.0

# --- offices with known access points (SODIndoorLoc) ------------------------------------------------------------------


def office_studies() -> Iterator[Study]:
    """Places and storeys of the access points are known."""
    for building, role, reasons in (
        ("CETC331", "calibrated", _OFFICE_REASONS),
        ("SYL", "reported", _SECOND_OFFICE_REASONS),
    ):

        def survey(folder: Path, quick: bool, building: str = building) -> RadioSurvey:
            true = read_sod(folder / "wifi" / "sod", building)
            # What no scan ever heard was switched off.
            return thinned(true.of_transmitters(np.isfinite(true.rssi_dbm).any(axis=0)), quick)

        def real(folder: Path, quick: bool, survey=survey) -> Figures:
            return _office_figures(survey(folder, quick), survey(folder, quick).rssi_dbm)

        def simulated(folder: Path, config: RadioConfig, seed: int, quick: bool, survey=survey) -> Figures:
            true = survey(folder, quick)
            config = with_settings(config, device_floors(true))
            plan = places.office(true.name, extent(true.position_m, 2.0))
            rssi = np.full(true.rssi_dbm.shape, np.nan, np.float32)
            for floor in np.unique(true.floor).tolist():
                here = true.floor == floor
                equipped = places.with_known_transmitters(plan, true, floor)
                rssi[here] = places.simulate(true.at_scans(here), equipped, config, seed, phones=False).rssi_dbm
            return _office_figures(true, rssi)

        yield Study(
            f"wifi/sod {building}",
            role,
            "radio-indoor",
            {"high_band": {"share": 0.5}},
            real,
            simulated,
            reasons,
        )


_OFFICE_REASONS = {
    "detection rate": "the rooms are drawn, not measured: walls on long ways and beside ceilings are a guess",
    "path-loss exponent": "few pairs are heard far away, and which are depends on rooms that are drawn, not measured",
    "residual sd": "the receivers' floor cuts off the weak side of the spread",
}
_SECOND_OFFICE_REASONS = _OFFICE_REASONS | {
    "detection rate": "the phone leaves out one strong signal in six, unlike that of CETC331, and the rooms are drawn"
}


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

        changes = {"bssids_per_access_point": 0, "high_band": {"share": 0.5}}
        yield Study(f"wifi/uji_lib {month}", role, "radio-indoor", changes, real, simulated, _LIBRARY_REASONS)


_LIBRARY_REASONS = {"": "the same points a year apart differ by a quarter themselves; one preset lies in between"}


def _library_figures(survey: RadioSurvey, rssi_dbm: Array) -> Figures:
    return {"sd at a fixed point [dB]": spread_at_points(survey.walk, rssi_dbm, _HEARD_MIN)}


# --- walls of a flat (BLE) --------------------------------------------------------------------------------------------

_FLAT_WALL_DB = 6.5
_BLE_TAG = {
    "power_at_1m_dbm": -51.0,
    "miss_probability": 0.1,
    "path_loss_exponent": 0.6,
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

        def real(folder: Path, quick: bool, surveys=surveys) -> Figures:
            own = surveys(folder, quick)
            plan = places.flat(read_flat(folder / "wifi" / "ble_lidar"), _FLAT_WALL_DB)
            return _flat_figures(own, [survey.rssi_dbm for survey in own], plan)

        def simulated(folder: Path, config: RadioConfig, seed: int, quick: bool, surveys=surveys) -> Figures:
            own = surveys(folder, quick)
            plan = places.flat(read_flat(folder / "wifi" / "ble_lidar"), _FLAT_WALL_DB)
            rssi = [places.simulate(survey, plan, config, seed, phones=False).rssi_dbm for survey in own]
            return _flat_figures(own, rssi, plan)

        yield Study(f"wifi/ble_lidar {'+'.join(runs)}", role, "radio-indoor", _BLE_TAG, real, simulated, _FLAT_REASONS)


_FLAT_REASONS = {
    "path-loss exponent": "over ways of 1 to 8 m the exponent is worth 2 dB, and the robot meets few of the anchors",
    "loss per wall": "walls and distance rise together in a small flat: the fit trades one for the other",
}


def _flat_figures(surveys: list[RadioSurvey], rssi_dbm: list[Array], plan: Floorplan) -> Figures:
    distances, strengths, walls = [], [], []
    for survey, table in zip(surveys, rssi_dbm, strict=True):
        transmitter_m = survey.transmitters[0]
        crossed = np.array([plan.wall_index.crossing(place, transmitter_m)[0] for place in survey.position_m])
        heard = np.isfinite(table)
        apart_m = np.linalg.norm(survey.position_m[:, None] - transmitter_m[None], axis=2)
        distances.append(apart_m[heard])
        strengths.append(table[heard])
        walls.append((crossed[heard] + 1) // _WALL_FACES)
    distance_m, strength, wall = (np.concatenate(parts) for parts in (distances, strengths, walls))
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


# --- similarity against distance: malls and a robot's floor -----------------------------------------------------------

_MALL_MARGIN_M = 15.0
_ADDRESSES_PER_BOX = 4.83
_MALLS = {"site1_B1": ("calibrated", 0.00693, 0.416), "site2_F6": ("reported", 0.0098, 0.513)}
"""Role, access points per m2 of the mall and its margin, and which share of their addresses is at 5 GHz. Fitted to
site1_B1; on site2_F6 more addresses are heard ten times or more (1,814 against 1,293), and more of them are at 5 GHz
(52 % against 43 %): its figures are scaled until the simulated walks hear as many in the same proportion."""


def mall_studies() -> Iterator[Study]:
    """Phones held by walkers, whose scans repeat old readings."""
    for floor, (role, boxes_per_m2, high_share) in _MALLS.items():

        def survey(folder: Path, quick: bool, floor: str = floor) -> RadioSurvey:
            return read_indoor20(folder / "indoor20" / floor, np.inf, traces_max=12 if quick else None)

        def real(folder: Path, quick: bool, survey=survey) -> Figures:
            return _mall_figures(survey(folder, quick))

        def simulated(
            folder: Path, config: RadioConfig, seed: int, quick: bool, survey=survey, floor=floor, density=boxes_per_m2
        ) -> Figures:
            true = survey(folder, quick)
            plan = read_geojson(folder / "indoor20" / floor / "geojson_map.json.gz", seed)
            around = plan.bounds_m + _MALL_MARGIN_M * np.array([-1, -1, 1, 1])
            boxes = round(density * float(np.prod(around[2:] - around[:2])))
            addresses = round(_ADDRESSES_PER_BOX * boxes)
            plan = places.with_spread_transmitters(plan, boxes, addresses, seed, around, floors=(0, 0, 1, -1))
            return _mall_figures(places.simulate(true, plan, config, seed))

        changes = {"high_band": {"share": high_share}}
        yield Study(f"indoor20 {floor}", role, "radio-mall", changes, real, simulated, _MALL_REASONS)


_PHONES_DIFFER = "phones differ: on site2_F6 a quarter of the walks hear 40 or fewer, another quarter 210 or more"
_MALL_REASONS = {
    "distance at cosine": "at high cosine a few walks over open floor give most pairs; the plan has no halls or crowds,"
    " and access points stand at random where a mall's stand in rows",
    "transmitters per scan": _PHONES_DIFFER,
    "rows per scan": _PHONES_DIFFER,
    "sd of transmitters per scan": _PHONES_DIFFER,
    "age of rows": "phones differ in how long a sweep takes them and in what they forget",
    "share of rows at 5 GHz": "phones differ in how well they hear 5 GHz",
}


def _mall_figures(survey: RadioSurvey) -> Figures:
    """Likeness of the fresh readings, and how old the others are."""
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


_ROBOT_REASONS = {"": "where the 30 access points of the floor and its neighbours stand is not known"}


def robot_floor_studies() -> Iterator[Study]:
    """A laptop on a robot: each scan is a whole sweep."""

    def survey(folder: Path, quick: bool) -> RadioSurvey:
        return thinned(read_uw_floor(folder / "wifi" / "uw_floor" / "uw-floor.txt"), quick)

    def real(folder: Path, quick: bool) -> Figures:
        true = survey(folder, quick)
        return similarity_figures(true, true.rssi_dbm, _apart_in_time(true))

    def simulated(folder: Path, config: RadioConfig, seed: int, quick: bool) -> Figures:
        true = survey(folder, quick)
        config = with_settings(config, {"detection_floor_dbm": faintest_dbm(true.rssi_dbm)})
        plan = places.office(true.name, extent(true.position_m, 3.0))
        around = extent(true.position_m, 20.0)
        plan = places.with_spread_transmitters(
            plan, len(true.addresses), len(true.addresses), seed, around, (0, 0, 1, -1)
        )
        rssi = places.simulate(true, plan, config, seed, phones=False).rssi_dbm
        return similarity_figures(true, rssi, _apart_in_time(true))

    yield Study(
        "wifi/uw_floor", "calibrated", "radio-indoor", {"high_band": {"share": 0.0}}, real, simulated, _ROBOT_REASONS
    )


def _apart_in_time(survey: RadioSurvey) -> Array:
    return np.abs(survey.time_s[:, None] - survey.time_s[None]) > _APART_S
