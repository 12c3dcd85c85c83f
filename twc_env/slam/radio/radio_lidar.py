"""Trajectory from radio and laser: the radio trajectory proposes scan pairs, scan matching measures their relative
pose.

The front end has already registered each scan to the previous ones (radio SLAM, "registration of LiDAR scans in
proximity"). Here, keyframes near each other in the radio trajectory are matched, the accepted closures are optimised
robustly together with the front end's motions, and keyframes near each other in the result are matched again. A
corridor does not constrain its own axis; the matcher leaves that direction to odometry. Radio is not used in the
optimisation once laser closures exist. Finally every scan is aligned to its neighbours (`scan_alignment`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig
from twc_env.records.geometry import between
from twc_env.records.messages import GridMap, Keyframe, LoopCandidate, LoopClosure
from twc_env.slam.matching import scan_alignment
from twc_env.slam.matching.loop_verification import LoopVerifier
from twc_env.slam.pose_graph import robust_back_end as robust_backend
from twc_env.slam.radio import radio_cue, radio_slam
from twc_env.slam.scans.occupancy_grid import OccupancyGrid

ROUNDS = ((5.0, "wifi"), (2.5, "proximity"))
"""Per round: maximum distance of two keyframes to be matched, and the recogniser name that selects the search
window."""
SPACING_M = 1.5
"""Path length between keyframes that are matched."""
APART_M = 15.0
VISITS = 2
"""Each keyframe is matched to the nearest keyframe of this many other visits."""


@dataclass(frozen=True, slots=True, eq=False)
class RadioLidarResult:
    """Trajectory and map of one robot."""

    poses: Array
    """(keyframes, 3), the first at (0, 0, 0)."""
    closures: tuple[LoopClosure, ...]
    """Closures accepted by scan matching and by the robust optimisation."""
    grid: GridMap
    radio: radio_slam.RadioResult


def solve(keyframes: Sequence[Keyframe], config: EnvConfig, cues: Sequence[str] = radio_cue.CUES) -> RadioLidarResult:
    """Trajectory and occupancy grid from one robot's keyframes, in order."""
    radio = radio_slam.solve(radio_slam.log_of(keyframes), config.slam.radio_slam, cues)
    poses = radio.poses
    closures: tuple[LoopClosure, ...] = ()
    for reach_m, source in ROUNDS:
        found = _matched(keyframes, poses, reach_m, source, config)
        poses, closures = _optimised(keyframes, poses, found, config)
    poses = scan_alignment.aligned(keyframes, poses, config.lidar.range_max_m)
    grid = OccupancyGrid(config.slam.resolution_m, config.lidar.range_max_m, config.lidar.circle_beam_count)
    grid.integrate(poses, np.array([k.ranges_m for k in keyframes]))
    return RadioLidarResult(poses, closures, grid.snapshot(), radio)


def _matched(
    keyframes: Sequence[Keyframe], poses: Array, reach_m: float, source: str, config: EnvConfig
) -> list[LoopClosure]:
    """Verified closures between keyframes within reach_m of each other but far apart along the path."""
    verifier = LoopVerifier(config.slam.verification, config.slam.odometry_filter, config.lidar)
    travel_m = np.array([k.travel_m for k in keyframes])
    accepted, last_m = [], -np.inf
    for here, keyframe in enumerate(keyframes):
        if travel_m[here] - last_m < SPACING_M:
            continue
        last_m = travel_m[here]
        for there in _nearest_visits(poses, travel_m, here, reach_m):
            guess = between(poses[there], poses[here])
            candidate = LoopCandidate((keyframe.robot, int(there)), (keyframe.robot, here), guess, source)
            closure = verifier.verify(candidate, keyframes, keyframes)
            if closure.status == "accepted":
                accepted.append(closure)
    return accepted


def _nearest_visits(poses: Array, travel_m: Array, here: int, reach_m: float) -> list[int]:
    """Earlier keyframes of other visits, nearest first."""
    count = int(np.searchsorted(travel_m, travel_m[here] - APART_M))
    away = np.linalg.norm(poses[:count, :2] - poses[here, :2], axis=1)
    chosen: list[int] = []
    for there in np.argsort(away, kind="stable").tolist():
        if away[there] > reach_m or len(chosen) == VISITS:
            break
        if all(abs(travel_m[there] - travel_m[other]) > APART_M for other in chosen):
            chosen.append(there)
    return chosen


def _optimised(
    keyframes: Sequence[Keyframe], poses: Array, closures: list[LoopClosure], config: EnvConfig
) -> tuple[Array, tuple[LoopClosure, ...]]:
    """Robust optimisation of motions and laser closures."""
    count = len(keyframes)
    chain = np.column_stack([np.arange(count - 1), np.arange(1, count)])
    pairs = np.array([(c.candidate.target[1], c.candidate.source[1]) for c in closures], np.int64).reshape(-1, 2)
    measured = [k.motion for k in keyframes[1:]] + [c.pose_target_source for c in closures]
    covariance = [k.motion_covariance for k in keyframes[1:]] + [c.covariance for c in closures]
    result = robust_backend.solve(
        poses, np.concatenate([chain, pairs]), np.array(measured), np.linalg.inv(np.array(covariance)),
        np.arange(len(measured)) >= count - 1, replace(config.slam.pose_graph, robust="ours", iterations_max=50),
    )  # fmt: skip
    believed = tuple(c for c, is_good in zip(closures, result.accepted[count - 1 :], strict=True) if is_good)
    return result.poses, believed
