"""Radio SLAM on real logs: phone walks in two malls joined by WiFi alone, and a robot's floor with added drift.

Malls: every trace of an indoor20 floor is a robot that knows neither its own start nor the others'; its odometry is
step detection and compass. `uw_floor`: the surveyed path of one robot, as odometry with scale and heading errors
(stated below the rows); there `ours` solves the whole log at once, and `engine` is the SLAM engine, without camera and
laser, which processes one scan after the other. Errors are those of all scans in the common frame after one rigid
alignment; the similarity model never sees surveyed positions.

Three rows of a mall are not methods but show where the error comes from. `odometry` aligns every walk individually: the
quality of dead reckoning. `oracle: others' poses known` localises one walk at a time, with all others at their true
positions, on the map that they span (`real_radio_oracle`); with `own shape and heading` also known, only the walk's
position is estimated. They show that most of the error comes from what radio says about places, not from steps and
compass. Errors of the scans of one walk are correlated, so more scans hardly help.

Settings of `phone_hearing`, `trace_joining` and `real_radio_oracle` were chosen on these floors.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig, RadioSlamConfig, from_dict
from twc_env.datasets.logs.radio_frames import radio_frames
from twc_env.datasets.surveys.fingerprints import RadioSurvey
from twc_env.datasets.surveys.indoor20 import trace_paths
from twc_env.datasets.surveys.step_heading import WalkerTrace, read_walks
from twc_env.datasets.surveys.uw_floor import read_uw_floor
from twc_env.records.geometry import align_rigidly, between, transform_points, wrap_angle
from twc_env.records.messages import Fingerprint
from twc_env.records.random_streams import random_stream
from twc_env.reproduce.logs import real_radio_oracle
from twc_env.reproduce.logs.intel import place_frames
from twc_env.reproduce.runner import Runner, add_some, data_folder
from twc_env.running.options import count
from twc_env.slam.engine import CooperativeSlam
from twc_env.slam.radio import radio_slam, trace_joining

CHOOSES = ("floors",)
FLOORS, ROBOT_FLOOR = ("site1_B1", "site2_F6"), "uw_floor"
WEIGHTINGS = ("paper", "ours")
SCALE_STD, CURL_STD_RAD_M, HEADING_STD_RAD = 0.03, 0.01, 0.01
"""Drift put on the surveyed path of uw_floor: scale and curl of the whole run, heading noise over one metre."""
ENGINE: EnvConfig = from_dict(
    {"robots": 1, "lidar": {"beam_count": 8}, "slam": {"cues": {"text": False, "lidar": False}}}
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `twc-env reproduce real-radio`."""
    add_some(parser, "--floors", (*FLOORS, ROBOT_FLOOR), "floors")
    parser.add_argument("--draws", type=count, default=5, metavar="N", help="number of simulated drifts for uw_floor")
    parser.add_argument("--traces", type=count, metavar="N", help="only the first N walks of a mall")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """{floor, method, traces_joined, traces, error_mean_m, error_std_m}; `traces` are all that were recorded."""
    folder = data_folder()
    found = runner.each(options.floors, lambda floor: _floor(folder, floor, options.draws, options.traces))
    table = [dict(row) for part in found for row in part]
    for row in table:
        half_m = row.pop("error_median_m")
        runner.notes.append(f"{row['floor']}, {row['method']}: half of all scans within {half_m:.2f} m")
    if any(row["floor"] == ROBOT_FLOOR for row in table):
        runner.notes.append(
            f"{ROBOT_FLOOR}: drift put on the surveyed path (sd, {options.draws} draws): scale {SCALE_STD:g}, "
            f"curl {CURL_STD_RAD_M:g} rad/m, heading {HEADING_STD_RAD:g} rad over one metre"
        )
    return table


def _floor(folder: Path, floor: str, seeds: int, traces_max: int | None) -> list[dict]:
    if floor == ROBOT_FLOOR:
        return _robot_floor(read_uw_floor(folder / "wifi" / "uw_floor" / "uw-floor.txt"), seeds)
    place = folder / "indoor20" / floor
    recorded = len(trace_paths(place, traces_max))
    return _mall(floor, read_walks(place, traces_max=traces_max), recorded)


def _mall(floor: str, walks: list[WalkerTrace], recorded: int) -> list[dict]:
    own = [positions_apart_m([walk.reckoned[:, :2]], [walk.surveyed_m]) for walk in walks]
    table = [_row(floor, "odometry, each walk aligned", 0, recorded, np.concatenate(own))]
    traces = [trace_joining.Trace(walk.reckoned, walk.fingerprints) for walk in walks]
    for known, is_shape_known in (("others' poses", False), ("others' poses, own shape and heading", True)):
        table.append(
            _row(
                floor,
                f"oracle: {known} known",
                0,
                recorded,
                real_radio_oracle.localisation_errors_m(walks, is_shape_known),
            )
        )
    for weighting in WEIGHTINGS:
        joined = trace_joining.join(traces, RadioSlamConfig(weighting=weighting))
        chosen = np.flatnonzero(joined.is_joined)
        away = positions_apart_m([joined.positions_m[k] for k in chosen], [walks[k].surveyed_m for k in chosen])
        table.append(_row(floor, weighting, len(chosen), recorded, away))
    return table


def _robot_floor(survey: RadioSurvey, seeds: int) -> list[dict]:
    names = ("odometry", *WEIGHTINGS, "engine")
    away: dict[str, list[Array]] = {name: [] for name in names}
    for seed in range(seeds):
        log = drifted(survey, seed)
        results = {"odometry": log.odometry}
        for weighting in WEIGHTINGS:
            results[weighting] = radio_slam.solve(log, RadioSlamConfig(weighting=weighting)).poses
        frames = radio_frames(survey.time_s, log.odometry, log.turned_rad, log.fingerprints, ENGINE.lidar.beam_count)
        results["engine"] = place_frames(CooperativeSlam(ENGINE, 1), [frames])[0]
        for name, poses in results.items():
            away[name].append(positions_apart_m([poses[:, :2]], [survey.position_m]))
    return [_row(ROBOT_FLOOR, name, 1, 1, np.concatenate(away[name])) for name in names]


def drifted(survey: RadioSurvey, seed: int) -> radio_slam.RadioLog:
    """The surveyed path as drifting odometry, with its scans."""
    step = np.diff(survey.position_m, axis=0)
    moved = np.linalg.norm(step, axis=1) > 0.02
    heading = np.zeros(len(survey.position_m))
    last = 0.0
    for k, is_moving in enumerate(moved):
        last = float(np.arctan2(step[k, 1], step[k, 0])) if is_moving else last
        heading[k] = last
    heading[-1] = last
    truth = np.column_stack([survey.position_m, heading])
    random = random_stream(seed, "uw_floor drift")
    motion = between(truth[:-1], truth[1:])
    length = np.hypot(motion[:, 0], motion[:, 1])
    motion[:, :2] *= 1.0 + SCALE_STD * random.standard_normal()
    wrong = CURL_STD_RAD_M * random.standard_normal() * length
    wrong += HEADING_STD_RAD * np.sqrt(length) * random.standard_normal(len(length))
    turned = motion[:, 2] + wrong
    motion[:, 2] = wrap_angle(turned)
    return radio_slam.RadioLog(motion, turned, _fingerprints(survey))


def _fingerprints(survey: RadioSurvey) -> list[Fingerprint]:
    macs = np.arange(len(survey.addresses), dtype=np.int64)
    heard = np.isfinite(survey.rssi_dbm)
    return [
        Fingerprint(macs[is_heard], row[is_heard].astype(float))
        for row, is_heard in zip(survey.rssi_dbm, heard, strict=True)
    ]


def positions_apart_m(estimated: list[Array], true: list[Array]) -> Array:
    """Distance of every position to the truth after one rigid alignment of all."""
    together, truth = np.concatenate(estimated), np.concatenate(true)
    return np.linalg.norm(transform_points(align_rigidly(together, truth), together) - truth, axis=1)


def _row(floor: str, method: str, joined: int, recorded: int, away: Array) -> dict:
    return {
        "floor": floor,
        "method": method,
        "traces_joined": joined,
        "traces": recorded,
        "error_mean_m": float(away.mean()),
        "error_std_m": float(away.std()),
        "error_median_m": float(np.median(away)),
    }
