"""Survey effort (papers.md R19): how long a robot drives for GMapping, which needs small loops, and for radio SLAM.

Both surveys see the same corridors of the indoor twin at the same speed and with the same odometry. `large loops` is
the walk of Table 1. In `small loops` each stretch of `STRETCH_M` is driven there, back, and there again before the next
one, so that the particle filter meets its own map at once; the paper does not say how its loops went.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.metrics import path_length_m
from twc_env.records.geometry import points_along
from twc_env.records.random_streams import random_stream
from twc_env.reproduce.radio import radio_methods, radio_walks
from twc_env.reproduce.radio.radio_twins import PLACES, Place, record
from twc_env.reproduce.radio.radio_walks import RecordedWalk
from twc_env.reproduce.runner import Runner

LARGE, SMALL = "large loops", "small loops"
PRINTED_S = {(SMALL, "gmapping"): 8619.2}
"""Published duration (Fig. 5); that of the survey by radio is not printed."""
STRETCH_M = 40.0
_POINTS_APART_M = 0.5


def rows(seeds: Sequence[int], runner: Runner, share: float, processes: int) -> list[dict]:
    """One row per survey and method; means over seeds."""
    place = PLACES["indoor"].shortened(share)
    found = runner.grid(["indoor"], seeds, partial(_measured, place), processes)["indoor"]
    table = []
    for (survey, method), *_ in found[0]:
        mine = [row for walk in found for (s, m), *row in walk if (s, m) == (survey, method)]
        table.append(
            {
                "survey": survey,
                "method": method,
                "duration_s": float(np.mean([duration_s for duration_s, _ in mine])),
                **radio_methods.means([errors for _, errors in mine]),
                "paper_duration_s": PRINTED_S.get((survey, method)),
                "seeds": len(mine),
            }
        )
    longer = table[-1]["duration_s"] / table[0]["duration_s"]
    runner.notes.append(f"the survey in small loops takes {longer:.2f} times as long as the one in large loops")
    return table


def small_loops(way: Array) -> Array:
    """(points, 2) a path on which each stretch of another one (points, 2) is driven there, back, and there again."""
    even = points_along(way, np.arange(0.0, path_length_m(way), _POINTS_APART_M))
    per_stretch = round(STRETCH_M / _POINTS_APART_M)
    stretches = [even[k : k + per_stretch + 1] for k in range(0, len(even), per_stretch)]
    return np.concatenate([part for stretch in stretches for part in (stretch, stretch[-2::-1], stretch[1:])])


def _measured(place: Place, _: str, seed: int) -> list[tuple[tuple[str, str], float, dict]]:
    """Survey and method, duration [s], and errors."""
    large = record(place, "wifi", seed)
    small = _driven_in_small_loops(place, large, seed)
    found = []
    for survey, walk, methods in ((LARGE, large, ("odometry", "wifi", "gmapping")), (SMALL, small, ("gmapping",))):
        duration_s = (len(walk.true_poses) - 1) * radio_walks.SCAN_PERIOD_S
        for method in methods:
            outcome = radio_methods.METHODS[method][1](place, walk, seed)
            found.append(((survey, method), duration_s, outcome.errors()))
    return found


def _driven_in_small_loops(place: Place, large: RecordedWalk, seed: int) -> RecordedWalk:
    """The walk's path in small loops, with the odometry of the walk; without radio scans."""
    planner = radio_walks.planner(place.twin, place.resolution_m)
    way = planner.wander(place.length_m + 1.0, random_stream(seed, f"radio walk {place.twin}"))
    way = points_along(way, np.arange(0.0, place.length_m, _POINTS_APART_M))
    looped = small_loops(way)
    true_poses = radio_walks.poses_along_way(looped, path_length_m(looped), place.speed_m_s)
    at = np.arange(0, len(true_poses), radio_walks.STEPS_PER_SCAN)
    motions, turned_rad = radio_walks.measured_odometry(true_poses, at, large.drift, large.odometry_stream)
    return RecordedWalk(true_poses[at], motions, turned_rad, (), large.drift, large.odometry_stream)
