"""The last word on a finished trajectory: every scan laid on those around it, one to one, and all poses fitted at once.

Closures come from clouds of several scans and are doubted more than they deserve, as inside an episode a few false ones
must not win. Once poses are right to within a wall's reach nothing is left to be mistaken: two scans of one place fix
each other to a millimetre and a fraction of a milliradian, and are weighed so (Lu & Milios 1997, with points laid on
lines). What decides a long trajectory is its headings, the first one above all.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import PoseGraphConfig
from twc_env.geometry import between, seen_from
from twc_env.messages import Keyframe
from twc_env.slam import pose_graph
from twc_env.slam.scan_matching import LineField, scan_points

STEPS_BACK = (1, 2, 4, 8)
"""Each scan is laid on the one before it, that before this, and so on ..."""
REACH_M, APART_M, VISITS, VISIT_APART_M = 3.0, 6.0, 8, 3.0
"""... and on the nearest of up to this many visits within reach, further back than this along the path."""
CELL_M, MATCH_REACH_M, MATCH_ITERATIONS = 0.2, 0.3, 20
DEGENERATE_SHARE = 0.02
"""A direction that fewer than this share of the beams fix is left open. Lower than where guesses are poor: the few
beams that see a corridor's end are right when everything else already fits."""
SHARE_MIN = 0.6
"""Scans that share fewer of their beams tell nothing of each other."""
BEAM_STD_M, CORRELATION = 0.015, 2.0
STD_MIN = (0.002, 0.002, 0.0004)
"""No pair is known better than this [m, m, rad]."""
OPEN_INFORMATION = 1e-3
"""Of a direction that was left open."""
FITS = tuple(PoseGraphConfig(robust="cauchy", robust_scale=scale, iterations_max=30) for scale in (9.0, 1.5))
"""One after the other, each with new matches. Along a bare corridor every sixth match is a decimetre off and claims
millimetres: once the poses are near, only the many that agree count. Chosen in the semi-indoor twin of radio SLAM,
walks 0 to 3 and 100 to 105."""


def aligned(keyframes: Sequence[Keyframe], poses: Array, range_max_m: float) -> Array:
    """Poses (n, 3) of one robot's keyframes, in order, from poses that tell what lies near what; the first is held."""
    count = len(keyframes)
    if count < 2:
        return poses
    travel_m = np.array([k.travel_m for k in keyframes])
    scans = np.array([k.ranges_m for k in keyframes])
    chain = np.column_stack([np.arange(count - 1), np.arange(1, count)])
    motions = np.array([k.motion for k in keyframes[1:]])
    known = np.linalg.inv(np.array([k.motion_covariance for k in keyframes[1:]]))
    for fit in FITS:
        pairs, measured, information = _measured(scans, poses, _pairs(poses, travel_m), range_max_m)
        edges = np.concatenate([chain, pairs])
        poses = pose_graph.optimise(
            poses, edges, np.concatenate([motions, measured]), np.concatenate([known, information]),
            np.arange(len(edges)) >= count - 1, fit,
        )  # fmt: skip
    return poses


def _pairs(poses: Array, travel_m: Array) -> Array:
    """(k, 2) earlier and later keyframe of each pair to be laid on each other, in order of the earlier."""
    pairs = []
    for here in range(1, len(poses)):
        pairs += [(here - back, here) for back in STEPS_BACK if back <= here]
        before = int(np.searchsorted(travel_m, travel_m[here] - APART_M, side="right"))
        away_m = np.hypot(*(poses[:before, :2] - poses[here, :2]).T)
        near = np.flatnonzero(away_m < REACH_M)
        visits: list[int] = []
        for there in near[np.argsort(away_m[near], kind="stable")].tolist():
            if all(abs(travel_m[there] - travel_m[other]) > VISIT_APART_M for other in visits):
                visits.append(there)
        pairs += [(there, here) for there in visits[:VISITS]]
    return np.array(sorted(set(pairs)), np.int64)


def _measured(scans: Array, poses: Array, pairs: Array, range_max_m: float) -> tuple[Array, Array, Array]:
    """Of the pairs whose scans fit: pairs (k, 2), where the later lies from the earlier (k, 3), information."""
    field, drawn = LineField(2.0 * (range_max_m + 1.0), CELL_M, range_max_m), -1
    points = [scan_points(scan, range_max_m) for scan in scans]
    kept, measured, information = [], [], []
    for earlier, later in pairs.tolist():
        if earlier != drawn:
            field.reset(np.zeros(2))
            field.add(np.zeros((1, 3)), scans[earlier][None])
            drawn = earlier
        guess = between(poses[earlier], poses[later])
        match = field.refine(points[later], guess, MATCH_REACH_M, MATCH_ITERATIONS, DEGENERATE_SHARE)
        if match.weight < SHARE_MIN * max(len(points[later]), 1):
            continue
        kept.append((earlier, later))
        measured.append(match.pose)
        information.append(seen_from(match.information(BEAM_STD_M, CORRELATION), match.pose[2]))
    if not kept:
        return np.zeros((0, 2), np.int64), np.zeros((0, 3)), np.zeros((0, 3, 3))
    covariance = np.linalg.inv(np.array(information) + OPEN_INFORMATION * np.eye(3)) + np.diag(np.square(STD_MIN))
    return np.array(kept), np.array(measured), np.linalg.inv(covariance)
