"""Localisation in one's own map: the first half of a laser log maps, the second half is localised in that map.

Five public CARMEN logs with corrected poses, which stand for truth. Odometry is made of them with errors added: a scale
error of 3 %, a curl of 0.5 degrees per metre, and noise. The engine maps the first half and saves its map; an engine of
`slam.mode = "localisation"` begins with the second half without any pose, knowing the saved map alone (`grid`: its grid
alone, as of a plain ROS map). Where the second half leaves the map, it must say that it is lost.

`found_s` is the time until it says that it knows where it is, `said_lost` the share of scans at which it says that it
is lost after that, `lost_inside` the same among scans taken within 1.5 m of one of the first half; `lost_right` is the
share after that at which it says that it is lost though its pose is right within 0.3 m and 10 degrees. `shared_m` is
the length of path within 1.5 m of a scan of the first half. Errors are over all scans at which it says that it knows.
`error_m` is in the frame of the map, which was aligned as a whole with the poses of the first half: it holds the bend
of that map, `map_error_m`. `in_map_error_m` is the error relative to the nearest scan of the first half, where the map
has that scan: the error of localisation alone. `unsaid_s` is the longest time in which that was more than 0.5 m or 10
degrees and it did not say that it was lost.
"""

from __future__ import annotations

import argparse
import dataclasses
import math

import numpy as np
from numpy.typing import NDArray as Array
from scipy.spatial import cKDTree

from twc_env.config import from_dict
from twc_env.datasets.logs.scan_log import RANGE_MAX_M, SETTINGS, apart, beam_count_of, sensor_frames
from twc_env.metrics import align_team
from twc_env.records.geometry import between, compose
from twc_env.records.lasting_map import LastingMap
from twc_env.records.random_streams import random_stream
from twc_env.reproduce.logs.intel import place_frames
from twc_env.reproduce.logs.laser_logs import LOGS, corrected_log
from twc_env.reproduce.runner import Runner, add_some
from twc_env.running.options import count, natural
from twc_env.slam.engine import CooperativeSlam
from twc_env.slam.map_localisation import MapLocalisation

CHOOSES = ("logs",)
SCALE, CURL_RAD_PER_M, NOISE_PER_M, NOISE_RAD = 0.03, math.radians(0.5), 0.02, 0.005
"""Errors of odometry: of length, turn per metre, standard deviations of length per metre and of turn per step."""
SPACING_M, SPACING_RAD = 0.3, 0.3
"""Scans nearer to the one before are left out."""
WRONG_M, WRONG_RAD, INSIDE_M = 0.5, math.radians(10), 1.5
RIGHT_M = 0.3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the table."""
    add_some(parser, "--logs", LOGS, "logs")
    parser.add_argument("--scans", type=count, default=100_000, help="most scans of each log, from its begin")
    parser.add_argument("--seed", type=natural, default=0, help="of the odometry's noise")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """Two rows per log: in the saved map, and in its grid alone."""
    found = runner.each(options.logs, lambda name: localised(name, options.scans, options.seed))
    return [row for own in found for row in own]


def localised(name: str, scans: int, seed: int) -> list[dict]:
    """One log."""
    whole = corrected_log(name)
    log = whole.at(apart(whole.poses[:scans], SPACING_M, SPACING_RAD))
    half, beams = len(log.times_s) // 2, beam_count_of([log])
    drifting = dataclasses.replace(log, poses=drifted(log.poses, random_stream(seed, f"odometry {name}")))
    lidar = SETTINGS["lidar"] | {"beam_count": beams}
    config = from_dict(SETTINGS | {"lidar": lidar, "robots": 1})
    engine = CooperativeSlam(config, 1)
    (mapped,) = place_frames(engine, [sensor_frames(drifting, beams, RANGE_MAX_M, np.arange(half))])
    aligned, lasting = align_team(mapped, log.poses[:half]), engine.lasting_map()
    frames = sensor_frames(drifting, beams, RANGE_MAX_M, np.arange(half, len(log.times_s)))
    row = {
        "log": name,
        "scans": len(frames),
        "map_error_m": _median_m(between(log.poses[:half], compose(aligned, mapped))),
    }
    return [
        {**row, "map": kind, **_scored(MapLocalisation(config, 1, known), frames, (aligned, mapped, log.poses))}
        for kind, known in (("saved", lasting), ("grid", LastingMap.of_grid(lasting.grid, beams, RANGE_MAX_M)))
    ]


def _median_m(apart: Array) -> float | None:
    return float(np.median(np.hypot(apart[:, 0], apart[:, 1]))) if len(apart) else None


def _scored(engine: MapLocalisation, frames: list, truth: tuple[Array, Array, Array]) -> dict:
    """truth: alignment of the map (3,), its poses of the first half (half, 3), true poses of the whole log (n, 3)."""
    aligned, mapped, poses = truth
    (localiser,), found, is_lost = engine.localisers, [], np.ones(len(frames), bool)
    for k, frame in enumerate(frames):
        engine.update([frame])
        found.append(engine.pose_map_robot(0).copy())
        is_lost[k] = localiser.is_lost
    times_s, estimated, true = np.array([frame.time_s for frame in frames]), np.array(found), poses[len(mapped) :]
    away_m, nearest = cKDTree(poses[: len(mapped), :2]).query(true[:, :2])
    in_map = between(between(poses[nearest], true), between(mapped[nearest], estimated))
    is_wrong = (np.hypot(in_map[:, 0], in_map[:, 1]) > WRONG_M) | (np.abs(in_map[:, 2]) > WRONG_RAD)
    begun = int(np.argmin(is_lost)) if not is_lost.all() else len(frames)
    is_inside = away_m < INSIDE_M
    inside = is_lost[begun:][is_inside[begun:]]
    is_right = (np.hypot(in_map[:, 0], in_map[:, 1]) <= RIGHT_M) & ~is_wrong
    return {
        "found_s": float(times_s[begun] - times_s[0]) if begun < len(frames) else None,
        "said_lost": float(is_lost[begun:].mean()) if begun < len(frames) else 1.0,
        "lost_inside": float(inside.mean()) if len(inside) else None,
        "lost_right": float((is_lost & is_right)[begun:].mean()) if begun < len(frames) else None,
        "shared_m": float(np.hypot(*np.diff(true[:, :2], axis=0).T)[is_inside[1:] & is_inside[:-1]].sum()),
        "error_m": _median_m(between(true, compose(aligned, estimated))[~is_lost]),
        "in_map_error_m": _median_m(in_map[~is_lost]),
        "wrong": int((is_wrong & ~is_lost).sum()),
        "unsaid_s": _longest_s(is_wrong & ~is_lost, times_s),
    }


def _longest_s(is_so: Array, times_s: Array) -> float:
    """The longest time between the first and last of successive scans that are so."""
    longest, begun = 0.0, None
    for so, time_s in zip(is_so.tolist(), times_s.tolist(), strict=True):
        begun = (time_s if begun is None else begun) if so else None
        longest = max(longest, 0.0 if begun is None else time_s - begun)
    return longest


def drifted(poses: Array, random: np.random.Generator) -> Array:
    """The poses (n, 3) as odometry with errors would tell them."""
    motions = between(poses[:-1], poses[1:])
    length_m = np.hypot(motions[:, 0], motions[:, 1])
    motions[:, :2] *= 1.0 + SCALE + random.normal(0.0, NOISE_PER_M, (len(motions), 1))
    motions[:, 2] += CURL_RAD_PER_M * length_m + random.normal(0.0, NOISE_RAD, len(motions))
    out = [poses[0]]
    for motion in motions:
        out.append(compose(out[-1], motion))
    return np.array(out)
