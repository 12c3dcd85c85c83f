"""Verification of one loop candidate: time and success rate of scan matching, with an initial guess and without.

Pairs of scans in generated buildings, taken at most 1.5 m apart, in sight of each other, with any rotation and 1 cm of
noise. An initial guess is off by up to 0.25 m and 0.12 rad along each axis, a `far` one by up to 1 m and 20 degrees;
without a guess, branch and bound searches all headings and all translations within 3 m. `verify` is the complete
verification: drawing the target's walls, matching, overlap, free space, covariance. `point-to-point` is ICP as in
TWC-SLAM. Times are CPU times, the median over pairs of the best of a few repetitions. The published time for a
600-point match is 13.04 ms with a guess.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig, override
from twc_env.maps import load_map
from twc_env.records.geometry import between, compose, wrap_angle
from twc_env.records.messages import Fingerprint, Keyframe, LoopCandidate
from twc_env.records.random_streams import random_stream
from twc_env.reproduce.runner import Runner
from twc_env.running.options import count
from twc_env.slam.matching.global_matching import match_globally
from twc_env.slam.matching.loop_verification import WIDE_WINDOW_M, LoopVerifier
from twc_env.slam.matching.point_matching import match_points
from twc_env.slam.matching.scan_matching import LineField, scan_points
from twc_env.slam.matching.target_walls import FIELD_CELL_M, REFINE_ITERATIONS, REFINE_REACH_M
from twc_env.world.motion.starts import start_places
from twc_env.world.sensors.lidar import Lidar

CHOOSES = ("buildings",)
APART_M = 1.5
GUESS_OFF = np.array([0.25, 0.25, 0.12])
FAR_OFF = np.array([1.0, 1.0, math.radians(20.0)])
LINE, POINT = "point-to-line", "point-to-point"
FOUND_M, FOUND_RAD = 0.05, 0.02
REPEATS, SPAN_S = 3, 0.02
"""Each repetition runs a task as often as takes at least so long: a clock of CPU time may tick every 10 ms."""
GOALS_MS = {"with": 0.5, "without": 12.0}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the table."""
    parser.add_argument("--buildings", type=count, default=20, help="number of test-split buildings")
    parser.add_argument("--pairs", type=count, default=5, help="pairs of scans per building")
    parser.add_argument("--points", type=count, default=600, help="beams of a scan")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """One row per task and method, with a guess, a far one and none."""
    names = [f"test/{k:04d}" for k in range(options.buildings)]
    found = [trial for part in runner.each(names, lambda name: trials(name, options)) for trial in part]
    table = []
    for kind in dict.fromkeys((trial["task"], trial["method"], trial["guess"]) for trial in found):
        mine = [trial for trial in found if (trial["task"], trial["method"], trial["guess"]) == kind]
        task, method, guess = kind
        times = np.array([trial["time_ms"] for trial in mine])
        right = [trial for trial in mine if trial["error_m"] <= FOUND_M and trial["error_rad"] <= FOUND_RAD]
        table.append(
            {
                "task": task,
                "method": method,
                "guess": guess,
                "points": options.points,
                "time_ms": round(float(np.median(times)), 3),
                "time_worst_ms": round(float(times.max()), 3),
                "goal_ms": GOALS_MS[guess] if task == "verify" else math.nan,
                "found": round(len(right) / len(mine), 3),
                "error_m": round(float(np.median([trial["error_m"] for trial in mine])), 4),
                "pairs": len(mine),
            }
        )
    return table


def trials(name: str, options: argparse.Namespace) -> list[dict]:
    """All tasks on the pairs of one building."""
    config = override(EnvConfig(map=name, robots=1), {"lidar.beam_count": options.points})
    plan = load_map(name)
    random = random_stream(0, "pairs " + name)
    lidar = Lidar(config.lidar, plan.wall_index, config.dynamics.robot_radius_m, 1, 0)
    places = start_places(plan)
    done: list[dict] = []
    pairs = 0
    while pairs < options.pairs:
        ends = places[random.integers(len(places), size=2)]
        if np.hypot(*(ends[1] - ends[0])) > APART_M or plan.wall_index.crossing(ends[0], ends[1:])[0][0]:
            continue
        poses = np.column_stack([ends, random.uniform(-math.pi, math.pi, 2)])
        scans = [lidar.scan(pose[None])[0] for pose in poses]
        true = between(poses[0], poses[1])
        guess, far_guess = (compose(true, random.uniform(-off, off)) for off in (GUESS_OFF, FAR_OFF))
        pairs += 1
        for task, method, kind, work in _tasks(config, scans, guess, far_guess):
            time_ms, found = _timed(work)
            error = between(true, found)
            done.append(
                {
                    "task": task,
                    "method": method,
                    "guess": kind,
                    "time_ms": time_ms,
                    "error_m": float(np.hypot(*error[:2])),
                    "error_rad": abs(float(wrap_angle(error[2]))),
                }
            )
    return done


def _tasks(
    config: EnvConfig, scans: list[Array], guess: Array, far_guess: Array
) -> list[tuple[str, str, str, Callable[[], Array]]]:
    """(task, method, kind of guess, function that returns the found pose)."""
    slam, range_max_m = config.slam, config.lidar.range_max_m
    verifier = LoopVerifier(slam.verification, slam.odometry_filter, config.lidar)
    field = LineField(2 * range_max_m + 2.0, FIELD_CELL_M, range_max_m)
    paths = [[_keyframe(robot, scan)] for robot, scan in enumerate(scans)]

    def refine(start: Array) -> Array:
        field.reset(np.zeros(2))
        field.add(np.zeros((1, 3)), scans[0][None])
        share = slam.local_map.degenerate_share
        return field.refine(scan_points(scans[1], range_max_m), start, REFINE_REACH_M, REFINE_ITERATIONS, share).pose

    def search() -> Array:
        target, source = (scan_points(scan, range_max_m) for scan in scans)
        found = match_globally(target, source, WIDE_WINDOW_M)
        return np.zeros(3) if found is None else refine(found.pose)

    def verify(recogniser: str, start: Array) -> Array:
        verifier.clear()
        return verifier.verify(LoopCandidate((0, 0), (1, 0), start, recogniser), *paths).pose_target_source

    def pair_points(start: Array) -> Array:
        target, source = (scan_points(scan, range_max_m) for scan in scans)
        return match_points(target, source, start).pose

    return [
        ("match", LINE, "with", lambda: refine(guess)),
        ("match", LINE, "without", search),
        ("match", LINE, "far", lambda: refine(far_guess)),
        ("match", POINT, "with", lambda: pair_points(guess)),
        ("match", POINT, "far", lambda: pair_points(far_guess)),
        ("verify", LINE, "with", lambda: verify("fused", guess)),
        ("verify", LINE, "without", lambda: verify("wifi", np.zeros(3))),
    ]


def _keyframe(robot: int, scan: Array) -> Keyframe:
    nothing = Fingerprint(np.zeros(0, np.int64), np.zeros(0))
    return Keyframe(robot, 0, 0, 0.0, np.zeros(3), np.zeros(3), np.zeros((3, 3)), 0.0, scan, (), nothing)


def _timed(work: Callable[[], Array]) -> tuple[float, Array]:
    """The best time [ms] of a few repetitions, after one that compiles, and the result."""
    found, times = work(), 1
    while (spent_s := _spent_s(work, times)) < SPAN_S:
        times *= 4
    return 1e3 * min(spent_s, *(_spent_s(work, times) for _ in range(REPEATS - 1))) / times, found


def _spent_s(work: Callable[[], Array], times: int) -> float:
    began = time.process_time()
    for _ in range(times):
        work()
    return time.process_time() - began
