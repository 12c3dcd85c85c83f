"""Real radio logs through radio SLAM: phone walks of two malls joined by WiFi alone, and a robot's floor with drift.

Rows of a mall: every trace of a floor of indoor20 is a robot that knows neither where it starts nor where the others
are; its odometry is steps and compass. `uw_floor`: the surveyed path of one robot, as odometry that reads scale and
heading wrong (stated below the rows). Errors are those of all scans that are in the common frame, after one rigid
alignment of the whole; the similarity model never sees a surveyed position. There `ours` solves the whole log at once,
and `engine` is the SLAM engine, without camera and laser, that takes the scans one after the other.

Three rows of a mall are no methods but say where its error comes from. `odometry` aligns every walk by itself: how good
dead reckoning is. `oracle: others told` looks for one walk at a time while all others lie where they truly are, on the
map that they span (`real_radio_oracle`); in `oracle: others, shape and heading told` only the walk's place is unknown.
So most of the error is what radio tells of places, not steps and compass. Errors of the scans of one walk go the same
way, so more scans hardly help.

These were tried once and are no part of the table:

- A likelihood of distance learnt from measures of a pair of scans by a small network, on the surveyed positions of one
  floor and used on the other: added up over pairs it misleads, since pairs repeat each other. Learnt without surveyed
  positions, within walks and against scans of other walks, it finds nothing: scans of one walk are alike for reasons
  that two walks never share. Learnt within walks alone, from scans some seconds apart, and only for what it says of
  short distances, it finds one walk of site1_B1 about as well as the oracle's cosine. Walks matched by it lie no nearer
  to the truth.
- A network that learns places from the surveyed positions of most walks of site1_B1: it places the other walks no
  better than the oracle does.
- The likeness of a scan to the map in many measures, weighed by a network that surveyed positions of the other floor
  trained: little better than the oracle's one cosine, and it needs the truth. Nor are likelihoods of levels and
  silences better on both floors, alone or added to the cosine.
- On site1_B1, groups of walks moved as one on the map of the rest: they swell it. Walks moved in turns by cosine and
  levels together, the spread held, leave the truth too. Layouts from half of the radios differ by more than such
  changes do, and their mean is no nearer.
- Walks laid at the mean of all places they could have on the map of the others, in turns: nearer at first, then
  further, as that swells the map. It also leaves the truth where it starts there.
- Scans moved ahead of where they were taken, or only compared with those of like heading: no better. Errors have hardly
  a part that points outwards.
- Started where the walks truly lie, the fit of `trace_joining` leaves them. So do, by more, likelihoods by likeness
  over all pairs, Gaussian processes, transmitters as landmarks with path loss, and levels told from the other walks.
  Their valleys are flat: a descent that is stopped early flatters.
- Links from each walk's end to where the same phone's next one begins do not help, nor those where the scans of two
  walks repeat the very same readings.

Settings of `phone_hearing`, `trace_joining` and `real_radio_oracle` were chosen on these floors.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.command_line import count
from twc_env.config import EnvConfig, RadioSlamConfig, from_dict
from twc_env.datasets.fingerprints import RadioSurvey
from twc_env.datasets.radio_frames import radio_frames
from twc_env.datasets.step_heading import WalkerTrace, read_walks
from twc_env.datasets.uw_floor import read_uw_floor
from twc_env.geometry import align_rigidly, between, transform_points, wrap_angle
from twc_env.messages import Fingerprint
from twc_env.random_streams import random_stream
from twc_env.reproduce import real_radio_oracle
from twc_env.reproduce.intel import place_frames
from twc_env.reproduce.runner import Runner, chosen, data_folder
from twc_env.slam import radio_slam, trace_joining
from twc_env.slam.engine import CooperativeSlam

SUMMARY = "real phone walks joined by WiFi alone, and a robot's floor with drift"
CHOOSES = ("floors",)
FLOORS, ROBOT_FLOOR = ("site1_B1", "site2_F6"), "uw_floor"
WEIGHTINGS = ("paper", "ours")
SCALE_STD, CURL_STD_RAD_M, HEADING_STD_RAD = 0.03, 0.01, 0.01
"""Drift put on the surveyed path of uw_floor: scale and curl of the whole run, heading noise over one metre."""
ENGINE: EnvConfig = from_dict(
    {"robots": 1, "lidar": {"beam_count": 8}, "slam": {"cues": {"text": False, "lidar": False}}}
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `python -m twc_env reproduce real-radio`."""
    parser.add_argument("--floors", default=",".join((*FLOORS, ROBOT_FLOOR)), help="default: %(default)s")
    parser.add_argument("--seeds", type=count, default=5, help="drifts put on uw_floor (default: %(default)s)")
    parser.add_argument("--traces", type=count, metavar="N", help="only the first N walks of a mall")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """{floor, method, traces_joined, traces, error_mean_m, error_std_m}; `traces` are all that were recorded."""
    folder = data_folder()
    found = runner.each(
        chosen(options.floors, (*FLOORS, ROBOT_FLOOR)),
        lambda floor: _floor(folder, floor, options.seeds, options.traces),
    )
    table = [dict(row) for part in found for row in part]
    for row in table:
        half_m = row.pop("error_median_m")
        runner.notes.append(f"{row['floor']}, {row['method']}: half of all scans within {half_m:.2f} m")
    if any(row["floor"] == ROBOT_FLOOR for row in table):
        runner.notes.append(
            f"{ROBOT_FLOOR}: drift put on the surveyed path (sd, {options.seeds} draws): scale {SCALE_STD:g}, "
            f"curl {CURL_STD_RAD_M:g} rad/m, heading {HEADING_STD_RAD:g} rad over one metre"
        )
    return table


def _floor(folder: Path, floor: str, seeds: int, traces_max: int | None) -> list[dict]:
    if floor == ROBOT_FLOOR:
        return _robot_floor(read_uw_floor(folder / "wifi" / "uw_floor" / "uw-floor.txt"), seeds)
    place = folder / "indoor20" / floor
    recorded = len(sorted((place / "traces").glob("*.txt*"))[:traces_max])
    return _mall(floor, read_walks(place, traces_max=traces_max), recorded)


def _mall(floor: str, walks: list[WalkerTrace], recorded: int) -> list[dict]:
    own = [_apart_m([walk.reckoned[:, :2]], [walk.surveyed_m]) for walk in walks]
    table = [_row(floor, "odometry, each walk aligned", 0, recorded, np.concatenate(own))]
    traces = [trace_joining.Trace(walk.reckoned, walk.fingerprints) for walk in walks]
    for known, is_shape_told in (("others' poses", False), ("others' poses, own shape and heading", True)):
        table.append(_row(floor, f"oracle: {known} known", 0, recorded, real_radio_oracle.sought(walks, is_shape_told)))
    for weighting in WEIGHTINGS:
        joined = trace_joining.join(traces, RadioSlamConfig(weighting=weighting))
        chosen = np.flatnonzero(joined.is_joined)
        away = _apart_m([joined.positions_m[k] for k in chosen], [walks[k].surveyed_m for k in chosen])
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
            away[name].append(_apart_m([poses[:, :2]], [survey.position_m]))
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


def _apart_m(estimated: list[Array], true: list[Array]) -> Array:
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
