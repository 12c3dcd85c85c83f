"""Accepted closures that hold a part of the map alone, and that chance explains better than truth.

Of many false closures some fit a map by chance: where a path has drifted far and no other closure checks them. Each
accepted closure is left out: if the map then lies elsewhere, and what is left predicts another pose than the closure
measured, its log odds are its evidence under that map plus those of accepted against rejected closures.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.slam.pose_graph.closure_prediction import KEYS_MAX, MapPrediction
from twc_env.slam.pose_graph.odometry_chains import Chains
from twc_env.slam.pose_graph.solver import Graph

TRIED_MAX = 10
"""Closures that are really left out: those whose absence moves the map most, to first order (which says too little of
large moves)."""
ROUNDS = 10
"""Iterations of the fit without one of them, which starts from the map with it."""


def chance_closures(graph: Graph, poses: Array, accepted: Array, away_m: float) -> list[tuple[int, float]]:
    """Edges of accepted (e,) closures by chance, and how far [m] the map moves without each: at least `away_m`."""
    closures = np.flatnonzero(graph.is_closure)
    used = np.flatnonzero(accepted[closures])
    if len(used) < 2 or len(used) == len(closures):
        return []
    prediction = MapPrediction(graph, Chains(graph, poses), closures, KEYS_MAX)
    prediction.update(poses, used)
    prediction.estimate_scale(used)
    prior = math.log((len(used) + 1) / (len(closures) - len(used) + 1))
    tried = np.argsort(-prediction.moves_without(used), kind="stable")[:TRIED_MAX]
    found = []
    for closure in used[tried]:
        rest = used[used != closure]
        weight = (~graph.is_closure).astype(float)
        weight[closures[rest]] = 1.0
        without = graph.fit(poses, weight, ROUNDS)
        moved_m = aligned_distance_m(without[:, :2], poses[:, :2])
        if moved_m < away_m:
            continue
        prediction.update(without, rest)
        evidence = prediction.evidence(*prediction.predicted(np.array([closure])))
        if float(evidence[0]) + prior < 0.0:
            found.append((int(closures[closure]), moved_m))
    return found


def aligned_distance_m(moved: Array, places: Array) -> float:
    """Root mean square distance of positions (n, 2) to others after the best rigid alignment (Umeyama 1991)."""
    a, b = moved - moved.mean(axis=0), places - places.mean(axis=0)
    along, across = float((a * b).sum()), float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum())
    total = float((a * a).sum() + (b * b).sum())
    return math.sqrt(max(total - 2.0 * math.hypot(along, across), 0.0) / len(a))
