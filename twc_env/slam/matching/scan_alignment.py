"""Final alignment of a finished trajectory: every scan is matched to its neighbours and all poses are optimised
jointly.

Closures match clouds of several scans and have large covariances, so that a few false ones do no harm in an episode.
Once poses are accurate to within the matching distance, mismatches are rare: two scans of one place determine their
relative pose to a millimetre and a fraction of a milliradian, and are weighted accordingly (Lu & Milios 1997, with
point-to-line matching). The accuracy of a long trajectory depends on its headings, above all the first one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import PoseGraphConfig
from twc_env.records.geometry import between, seen_from
from twc_env.records.messages import Keyframe
from twc_env.slam.matching.scan_matching import LineField, scan_points
from twc_env.slam.pose_graph import solver as pose_graph

STEPS_BACK = (1, 2, 4, 8)
"""Each scan is matched to those this many scans before ..."""
REACH_M, APART_M, VISITS, VISIT_APART_M = 3.0, 6.0, 8, 3.0
"""... and to the nearest of up to this many visits within reach, more than APART_M back along the path."""
CELL_M, MATCH_REACH_M, MATCH_ITERATIONS = 0.2, 0.3, 20
DEGENERATE_SHARE = 0.02
"""A direction constrained by less than this share of the beams is left open. Lower than for poor initial guesses: the
few beams that hit a corridor's end are correct once everything else fits."""
SHARE_MIN = 0.6
"""Pairs of scans with a smaller share of matched beams are skipped."""
BEAM_STD_M, CORRELATION = 0.015, 2.0
STD_MIN = (0.002, 0.002, 0.0004)
"""Minimum standard deviation of a pair [m, m, rad]."""
OPEN_INFORMATION = 1e-3
"""Information of a direction left open."""
FITS = tuple(PoseGraphConfig(robust="cauchy", robust_scale=scale, iterations_max=30) for scale in (9.0, 1.5))
"""Optimisations in sequence, each with new matches. Along a bare corridor every sixth match is a decimetre off with a
covariance of millimetres, so the second scale only keeps the consistent majority. Chosen in the semi-indoor twin of
radio SLAM, walks 0 to 3 and 100 to 105."""


def aligned(keyframes: Sequence[Keyframe], poses: Array, range_max_m: float) -> Array:
    """Poses (n, 3) of one robot's keyframes, in order, starting from approximate poses; the first is held."""
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
    """(k, 2) earlier and later keyframe of each pair to be matched, ordered by the earlier."""
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
    """The pairs (k, 2) whose scans match, the later pose relative to the earlier (k, 3), and its information."""
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
