"""Which closures to believe: the robust modes of the pose graph, and a report of every closure that was refused.

Modes (`PoseGraphConfig.robust`): `none` believes all (TWC-SLAM), `dcs` and `cauchy` weigh by residual, `gnc` anneals
truncated least squares (Yang 2020), `pcm` keeps the largest pairwise consistent set (Mangelson 2018), `ours` grows the
map from the surest closures outwards (`closure_growth`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twc_env.config import PoseGraphConfig
from twc_env.geometry import between, compose
from twc_env.slam import pose_graph
from twc_env.slam.closure_agreement import pairwise_consistent
from twc_env.slam.closure_growth import ClosureGrowth
from twc_env.slam.graduated_non_convexity import graduated
from twc_env.slam.pose_graph import Graph

Array = NDArray


@dataclass(frozen=True, slots=True)
class Rejection:
    """One refused closure: its edge, why, and how far from the final map it lies."""

    edge: int
    reason: str
    squared_error: float
    away_m: float
    away_rad: float
    group: int = -1
    """Closures of one number agree with each other; -1 where the mode forms no groups."""


@dataclass(frozen=True, slots=True)
class BackendResult:
    """Poses (n, 3), accepted (e,) bool with odometry always true, and the refused closures in order of their edges."""

    poses: Array
    accepted: Array
    rejections: tuple[Rejection, ...]


def optimise(poses, edges, measured, information, is_closure, config: PoseGraphConfig, fixed: int = 0) -> Array:
    """The poses of `solve`; signature and meaning of `pose_graph.optimise`, for every mode."""
    if config.robust in ("none", "dcs", "cauchy"):
        return pose_graph.optimise(poses, edges, measured, information, is_closure, config, fixed)
    return solve(poses, edges, measured, information, is_closure, config, fixed).poses


def solve(
    poses: Array,
    edges: Array,
    measured: Array,
    information: Array,
    is_closure: Array,
    config: PoseGraphConfig,
    fixed: int = 0,
) -> BackendResult:
    """Optimise in the mode `config.robust` and say which closures were believed. Deterministic.

    Arguments as for `pose_graph.optimise`. `gnc`, `pcm` and `ours` take odometry as known good.
    """
    poses = np.array(poses, float)
    graph = Graph(
        np.ascontiguousarray(edges, np.int64).reshape(-1, 2),
        np.ascontiguousarray(measured, float).reshape(-1, 3),
        np.ascontiguousarray(information, float).reshape(-1, 3, 3),
        np.ascontiguousarray(is_closure, bool),
    )
    group = np.full(len(graph.edges), -1)
    reasons: dict[int, str] = {}
    held = poses[fixed].copy() if len(poses) else np.zeros(3)
    if len(poses) < 2 or not graph.is_closure.any():
        out, accepted = pose_graph.optimise(poses, *graph.parts, config, fixed), np.ones(len(graph.edges), bool)
    elif config.robust in ("none", "dcs", "cauchy"):
        out, accepted = _weighed(graph, poses, config, fixed)
    elif config.robust == "gnc":
        out, accepted = graduated(graph, poses)
    elif config.robust == "pcm":
        out, accepted = pairwise_consistent(graph, poses)
    else:
        out, accepted, group, reasons = ClosureGrowth(graph, poses, config).run()
    if len(out) and config.robust not in ("none", "dcs", "cauchy"):
        out = compose(held, between(out[fixed], out))
        out[fixed] = held
    return BackendResult(out, accepted, _rejections(graph, out, accepted, group, reasons, config.robust))


def _rejections(graph: Graph, poses, accepted, group, reasons, mode) -> tuple[Rejection, ...]:
    refused = np.flatnonzero(~accepted)
    if not len(refused):
        return ()
    squared = graph.squared_errors(poses)
    away = pose_graph.residuals(poses, graph.edges[refused], graph.measured[refused])
    general = {
        "gnc": "truncated: its error stayed above the inlier bound",
        "pcm": "not in the largest pairwise consistent set",
    }.get(mode, "down-weighted below one half by its residual")
    return tuple(
        Rejection(int(e), reasons.get(int(e), general), float(squared[e]), math.hypot(x, y), abs(turn), int(group[e]))
        for e, (x, y, turn) in zip(refused, away.tolist(), strict=True)
    )


def _weighed(graph: Graph, poses: Array, config: PoseGraphConfig, fixed: int) -> tuple[Array, Array]:
    out = pose_graph.optimise(poses, *graph.parts, config, fixed)
    weight = pose_graph.robust_weights(graph.squared_errors(out), graph.is_closure, config)
    return out, weight > 0.5
