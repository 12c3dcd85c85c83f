"""The radio model beside measurements: real and simulated figures by the same estimators.

For each survey the radio model is run at the survey's own places, in a plan that imitates its building, and both sets
of readings are judged by one function. `calibrated` rows are of sets whose figures the presets were fitted to;
`reported` rows are of sets looked at only afterwards, with the same settings. Preset `radio-indoor` serves the
offices, the library, the malls and the robot's floor; what belongs to a place (its plan, how many transmitters, how
strong a BLE tag sends) is set per place below.
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twc_env.config import RadioConfig, from_dict
from twc_env.datasets.ble_flat import read_ble_run, read_flat
from twc_env.datasets.fingerprints import RadioSurvey
from twc_env.datasets.geojson import read_geojson
from twc_env.datasets.indoor20 import read_indoor20
from twc_env.datasets.sod_indoor_loc import read_sod
from twc_env.datasets.uji_library import read_uji_library
from twc_env.datasets.uw_floor import read_uw_floor
from twc_env.errors import ConfigError
from twc_env.maps import load_map
from twc_env.metrics.radio import (
    cosine_similarity,
    detection_rates,
    distance_at_similarity,
    fit_path_loss,
    mean_rssi_by_walls,
    spread_at_points,
)
from twc_env.reproduce import radio_places as places
from twc_env.reproduce.runner import Runner, data_folder
from twc_env.world.floorplan import Floorplan

Array = NDArray
Figures = dict[str, float]

SUMMARY = "path loss, walls, detection, noise and similarity of the radio model beside real surveys"

SIMILARITIES = (0.7, 0.8, 0.9)
_DISTANCES_M = np.array([0.0, 10.0, 20.0, 30.0, 40.0, 50.0])
_FLOORS_AWAY = 2
_WALLS_MAX = 2
_DETECTED_MIN = 0.02
"""Detection rates below this are left out: a relative error of next to nothing says nothing."""
_WALL_FACES = 2
"""Lines of the flat's outline that one wall crossing meets."""
_HEARD_MIN = 8
_APART_S = 30.0
_PHONES = 5
_STROLL_M, _STROLL_SPEED_M_S, _STROLL_STEP_M = 1072.6, 0.42, 1.5
"""The robot of SPEC R14 at NTU: path and speed, and how far it came between two scans."""
_WINDOW_M = {"wifi": 60.0, "lte": 150.0}
"""Pairs closer than this along the path teach the similarity model (SPEC R5)."""
_OFFSET_DB = {"wifi": 100.0, "lte": 120.0}


@dataclass(frozen=True, slots=True)
class Study:
    """One set: what it measured, and what the model gives in its place."""

    name: str
    role: str
    """calibrated or reported."""
    preset: str
    changes: dict
    """Settings of the place that differ from the preset."""
    real: Callable[[Path, bool], Figures]
    simulated: Callable[[Path, RadioConfig, int, bool], Figures]

    @property
    def config(self) -> RadioConfig:
        """The radio settings of the simulation."""
        return from_dict({"preset": self.preset, **self.changes}, RadioConfig, "radio")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the table."""
    parser.add_argument("--seeds", type=int, default=3, metavar="N", help="simulated runs (default: %(default)s)")
    parser.add_argument("--only", default="", metavar="TEXT", help="only sets whose name holds this text")
    parser.add_argument("--quick", action="store_true", help="a small part of each set: shows that it runs")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """{quantity, dataset, role, real, simulated, ratio, preset} for each figure; simulated is the mean over seeds."""
    chosen = [study for study in STUDIES if options.only in study.name]
    if not chosen:
        raise ConfigError(f"no set is named {options.only!r}; known are {', '.join(s.name for s in STUDIES)}")
    folder = data_folder()
    parts = [(study, seed) for study in chosen for seed in range(-1, options.seeds)]
    found = runner.each(parts, lambda part: _measure(part, folder, options.quick), _label)
    table = []
    for study in chosen:
        real, *runs = [figures for (other, _), figures in zip(parts, found, strict=True) if other is study]
        for quantity, value in real.items():
            if quantity.startswith("detection rate") and (value is None or value < _DETECTED_MIN):
                continue
            simulated = float(np.mean([np.nan if run[quantity] is None else run[quantity] for run in runs]))
            is_known = value is not None and bool(value) and np.isfinite(simulated)
            table.append(
                {
                    "quantity": quantity,
                    "dataset": study.name,
                    "role": study.role,
                    "real": value,
                    "simulated": simulated,
                    "ratio": simulated / value if is_known else None,
                    "preset": study.preset,
                }
            )
    return table


def _measure(part: tuple[Study, int], folder: Path, quick: bool) -> Figures:
    study, seed = part
    return study.real(folder, quick) if seed < 0 else study.simulated(folder, study.config, seed, quick)


def _label(part: tuple[Study, int]) -> str:
    """Names a part by the settings too, so that other presets are computed anew."""
    study, seed = part
    settings = hashlib.sha256(repr(dataclasses.asdict(study.config)).encode()).hexdigest()[:8]
    return f"{study.name} {'real' if seed < 0 else f'simulated {seed}'} {settings if seed >= 0 else ''}"


# --- offices with known access points (SODIndoorLoc) ------------------------------------------------------------------


def _office_studies() -> Iterator[Study]:
    for building, role in (("CETC331", "calibrated"), ("SYL", "reported")):

        def survey(folder: Path, quick: bool, building: str = building) -> RadioSurvey:
            return _thinned(read_sod(folder / "wifi" / "sod", building), quick)

        def real(folder: Path, quick: bool, survey=survey) -> Figures:
            return _office_figures(survey(folder, quick), survey(folder, quick).rssi_dbm)

        def simulated(folder: Path, config: RadioConfig, seed: int, quick: bool, survey=survey) -> Figures:
            true = survey(folder, quick)
            plan = places.office(true.name, _extent(true.position_m, 2.0))
            rssi = np.full(true.rssi_dbm.shape, np.nan, np.float32)
            for floor in np.unique(true.floor).tolist():
                here = true.floor == floor
                part = dataclasses.replace(
                    true, position_m=true.position_m[here], time_s=true.time_s[here], walk=true.walk[here]
                )
                equipped = places.with_known_transmitters(plan, true, floor)
                rssi[here] = places.simulate(part, equipped, config, seed, phones=False).rssi_dbm
            return _office_figures(true, rssi)

        yield Study(f"wifi/sod {building}", role, "radio-indoor", {"high_band": {"share": 0.5}}, real, simulated)


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


def _library_studies() -> Iterator[Study]:
    for month, role in (("01", "calibrated"), ("13", "reported")):

        def survey(folder: Path, month: str = month) -> RadioSurvey:
            return read_uji_library(folder / "wifi" / "uji_lib", month)

        def real(folder: Path, quick: bool, survey=survey) -> Figures:
            return _library_figures(survey(folder), survey(folder).rssi_dbm)

        def simulated(folder: Path, config: RadioConfig, seed: int, quick: bool, survey=survey) -> Figures:
            true = survey(folder)
            around = _extent(true.position_m, 15.0)
            plan = places.office(true.name, around)
            plan = places.with_spread_transmitters(plan, 40, len(true.addresses), seed, floors=(0, 0, 1, -1))
            return _library_figures(true, places.simulate(true, plan, config, seed, phones=False).rssi_dbm)

        changes = {"bssids_per_access_point": 0, "high_band": {"share": 0.5}}
        yield Study(f"wifi/uji_lib {month}", role, "radio-indoor", changes, real, simulated)


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


def _flat_studies() -> Iterator[Study]:
    for runs, role in ((("calibration",), "calibrated"), (("calib3", "calib4"), "reported")):

        def surveys(folder: Path, quick: bool, runs=runs) -> list[RadioSurvey]:
            return [_thinned(read_ble_run(folder / "wifi" / "ble_lidar", run), quick) for run in runs]

        def real(folder: Path, quick: bool, surveys=surveys) -> Figures:
            own = surveys(folder, quick)
            plan = places.flat(read_flat(folder / "wifi" / "ble_lidar"), _FLAT_WALL_DB)
            return _flat_figures(own, [survey.rssi_dbm for survey in own], plan)

        def simulated(folder: Path, config: RadioConfig, seed: int, quick: bool, surveys=surveys) -> Figures:
            own = surveys(folder, quick)
            plan = places.flat(read_flat(folder / "wifi" / "ble_lidar"), _FLAT_WALL_DB)
            rssi = [places.simulate(survey, plan, config, seed, phones=False).rssi_dbm for survey in own]
            return _flat_figures(own, rssi, plan)

        yield Study(f"wifi/ble_lidar {'+'.join(runs)}", role, "radio-indoor", _BLE_TAG, real, simulated)


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

_MALL_MARGIN_M = 20.0
"""Boxes and addresses: 231 and 1,320 were fitted to B1, where 671 boxes and 1,363 addresses were heard in all; the
other floor takes the same shares of the 1,864 and 1,901 heard there."""


def _mall_studies() -> Iterator[Study]:
    for floor, role, boxes, addresses in (("site1_B1", "calibrated", 231, 1320), ("site2_F6", "reported", 642, 1841)):

        def survey(folder: Path, quick: bool, floor: str = floor) -> RadioSurvey:
            return read_indoor20(folder / "indoor20" / floor, traces_max=12 if quick else None)

        def real(folder: Path, quick: bool, survey=survey) -> Figures:
            true = survey(folder, quick)
            return _similarity_figures(true, true.rssi_dbm, _other_walks(true))

        def simulated(
            folder: Path, config: RadioConfig, seed: int, quick: bool, survey=survey, floor=floor, boxes=boxes,
            addresses=addresses,
        ) -> Figures:  # fmt: skip
            true = survey(folder, quick)
            plan = read_geojson(folder / "indoor20" / floor / "geojson_map.json.gz", seed)
            around = plan.bounds_m + _MALL_MARGIN_M * np.array([-1, -1, 1, 1])
            plan = places.with_spread_transmitters(plan, boxes, addresses, seed, around, floors=(0, 0, 1, -1))
            return _similarity_figures(true, places.simulate(true, plan, config, seed).rssi_dbm, _other_walks(true))

        yield Study(f"indoor20 {floor}", role, "radio-indoor", {"high_band": {"share": 0.5}}, real, simulated)


def _robot_floor_studies() -> Iterator[Study]:
    def survey(folder: Path, quick: bool) -> RadioSurvey:
        return _thinned(read_uw_floor(folder / "wifi" / "uw_floor" / "uw-floor.txt"), quick)

    def real(folder: Path, quick: bool) -> Figures:
        true = survey(folder, quick)
        return _similarity_figures(true, true.rssi_dbm, _apart_in_time(true))

    def simulated(folder: Path, config: RadioConfig, seed: int, quick: bool) -> Figures:
        true = survey(folder, quick)
        plan = places.office(true.name, _extent(true.position_m, 3.0))
        around = _extent(true.position_m, 15.0)
        plan = places.with_spread_transmitters(
            plan, len(true.addresses), len(true.addresses), seed, around, (0, 0, 1, -1)
        )
        rssi = places.simulate(true, plan, config, seed, phones=False).rssi_dbm
        return _similarity_figures(true, rssi, _apart_in_time(true))

    yield Study("wifi/uw_floor", "calibrated", "radio-indoor", {"high_band": {"share": 0.0}}, real, simulated)


def _similarity_figures(survey: RadioSurvey, rssi_dbm: Array, is_pair: Array, offset_db: float = 100.0) -> Figures:
    similarity = cosine_similarity(rssi_dbm, offset_db)
    figures = {"transmitters per scan": float(np.isfinite(rssi_dbm).sum(axis=1).mean())}
    for at in SIMILARITIES:
        mean, std = distance_at_similarity(survey.position_m, similarity, is_pair, at)
        figures[f"distance at cosine {at}: mean [m]"] = mean
        figures[f"distance at cosine {at}: sd [m]"] = std
    return figures


def _other_walks(survey: RadioSurvey) -> Array:
    return survey.walk[:, None] != survey.walk[None]


def _apart_in_time(survey: RadioSurvey) -> Array:
    return np.abs(survey.time_s[:, None] - survey.time_s[None]) > _APART_S


# --- the radio SLAM paper (SPEC R14-R15) ------------------------------------------------------------------------------

_PRINTED = {
    ("radio-ntu", "wifi"): (48.88, 3.79, 2.70),
    ("radio-ntu", "lte"): (16.59, 30.25, 22.13),
    ("radio-sutd-indoor", "wifi"): (118.34, None, None),
    ("radio-sutd-indoor", "lte"): (19.49, None, None),
    ("radio-sutd-outdoor", "wifi"): (88.23, None, None),
    ("radio-sutd-outdoor", "lte"): (18.74, None, None),
}
"""Transmitters per scan, and mean and deviation of the distance at cosine 0.8, where printed."""
_WIFI_PRESET = {
    "radio-ntu": "radio-semi-indoor",
    "radio-sutd-indoor": "radio-indoor",
    "radio-sutd-outdoor": "radio-outdoor",
}

_STOREYS = {"radio-sutd-indoor": (0, 1, -1, 2, -2, 3, -3)}
"""1,921 addresses are too many for one floor of 5,000 m2: the building has more storeys, and all hold access points."""


@lru_cache(maxsize=16)
def _stroll(name: str, length_m: float, seed: int) -> RadioSurvey:
    """The same walk for both radios."""
    return places.stroll(load_map(name), length_m, _STROLL_STEP_M, _STROLL_SPEED_M_S, seed)


def _paper_studies() -> Iterator[Study]:
    for (name, kind), printed in _PRINTED.items():

        def real(folder: Path, quick: bool, printed=printed) -> Figures:
            figures = {"transmitters per scan": printed[0]}
            if printed[1] is not None:
                figures["distance at cosine 0.8: mean [m]"] = printed[1]
                figures["distance at cosine 0.8: sd [m]"] = printed[2]
            return figures

        def simulated(folder: Path, config: RadioConfig, seed: int, quick: bool, name=name, kind=kind) -> Figures:
            plan = places.over_storeys(load_map(name), _STOREYS.get(name, (0,)))
            walk = _stroll(name, 100.0 if quick else _STROLL_M, seed)
            model = places.RememberingModel(config, plan)
            phones = [places.simulate(walk, plan, config, _PHONES * seed + k, model=model) for k in range(_PHONES)]
            travel_m = walk.time_s * _STROLL_SPEED_M_S
            is_pair = np.abs(travel_m[:, None] - travel_m[None]) < _WINDOW_M[kind]
            return _similarity_figures(walk, places.merged(phones).rssi_dbm, is_pair, _OFFSET_DB[kind])

        is_fitted = name == "radio-ntu" or (name, kind) == ("radio-sutd-outdoor", "wifi")
        yield Study(
            f"paper {name} {kind}",
            "calibrated" if is_fitted else "reported",
            "lte" if kind == "lte" else _WIFI_PRESET[name],
            {"high_band": {"share": 0.5}} if kind == "wifi" else {},
            real,
            simulated,
        )


def _thinned(survey: RadioSurvey, quick: bool) -> RadioSurvey:
    """Every tenth scan, for a quick look."""
    if not quick:
        return survey
    keep = slice(None, None, 10)
    per_scan = ("position_m", "floor", "time_s", "walk", "rssi_dbm")
    return dataclasses.replace(survey, **{key: getattr(survey, key)[keep] for key in per_scan})


def _extent(position_m: Array, margin_m: float) -> Array:
    return np.concatenate([position_m.min(axis=0) - margin_m, position_m.max(axis=0) + margin_m])


STUDIES: tuple[Study, ...] = tuple(
    study
    for group in (
        _office_studies, _library_studies, _flat_studies, _mall_studies, _robot_floor_studies, _paper_studies,
    )
    for study in group()
)  # fmt: skip
"""All sets, in the order of the rows."""
