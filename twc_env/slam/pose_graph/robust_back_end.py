"""Robust pose-graph optimisation: which closures to accept, with a reason for every rejected one.

Modes (`PoseGraphConfig.robust`): `plain` accepts all (TWC-SLAM), `dcs` and `cauchy` weight by residual, `gnc` anneals
truncated least squares (Yang 2020), `pcm` keeps the largest pairwise consistent set (Mangelson 2018), `ours` grows the
inlier set from the most certain closures (`consistent_set`); FILE.py:CLASS is a custom back end (docs/library.md).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import PoseGraphConfig
from twc_env.errors import DataError
from twc_env.kernels.compiled import borrowing_kernel, kernel
from twc_env.records.array_validation import validated_rows
from twc_env.records.class_file import is_in_file
from twc_env.records.geometry import between, compose
from twc_env.slam.pose_graph import solver as pose_graph
from twc_env.slam.pose_graph.closure_prediction import KEYS_MAX
from twc_env.slam.pose_graph.consistent_set import ConsistentSetSearch
from twc_env.slam.pose_graph.pairwise_consistency import pairwise_consistent
from twc_env.slam.pose_graph.solver import GATE, Graph, NormalEquations
from twc_env.slam.pose_graph.systematic_errors import SharedErrors
from twc_env.slam.pose_graph.user_back_end import OwnBackEnd

REVOKED_ABOVE, RETURNS_BELOW = 12.5, 5.5
"""Squared errors above which a closure is rejected and below which it is accepted again; the gap gives hysteresis."""
ROUNDS_MAX, ANNEALING_MAX = 3, 100
FEW_REFUSED = 2
"""Above this many rejected closures, `ours` selects all closures from scratch, which takes about twenty times as long.
"""
EPISODE_STEP_M, EPISODE_STEP_RAD = 0.03, 0.006
"""Inside an episode, an optimisation stops below this step: the next would be ten times smaller."""
EPISODE_KEYS_MAX = 80
"""Key poses of `ours` inside an episode, to bound the time of a step."""
FAR_M = 1000.0
"""A graph whose centre is further from the origin is moved there first: `pcm` and `ours` compare closures as twists
about the origin, whose covariances grow with the square of the distance and lose their digits ten kilometres away."""


@dataclass(frozen=True, slots=True)
class Rejection:
    """One rejected closure: its edge and the reason."""

    edge: int
    reason: str


@dataclass(frozen=True, slots=True)
class BackendResult:
    """Poses (n, 3), accepted edges (e,) bool (always true for odometry), and the rejected closures in edge order."""

    poses: Array
    accepted: Array
    rejections: tuple[Rejection, ...]


def revise(
    poses: Array, graph: Graph, is_used: Array, config: PoseGraphConfig, fixed: int = 0, is_thorough: bool = False,
    may_replace: Callable[[BackendResult, BackendResult], bool] = lambda before, after: True,
) -> BackendResult:  # fmt: skip
    """Incremental optimisation inside an episode: starts from `poses` and the closures used so far (e,).

    `ours` refits the used closures with dynamic covariance scaling, rejects those the fit contradicts and accepts
    rejected ones that now agree (`refit_closures`). When `is_thorough`, it also selects closures from scratch; that
    solution is returned if it accepts more of them, costs less (`_cost`) and `may_replace(running, new)` agrees. With
    at most FEW_REFUSED rejections the second solution starts from a fit of all closures instead. The other modes solve
    from scratch each time.
    """
    if config.robust != "ours":
        return solve(poses, *graph.parts, config, fixed, shared=graph.shared)
    result = refit_closures(poses, graph, is_used, config, fixed)
    if is_thorough and not result.accepted.all():
        if len(result.rejections) <= FEW_REFUSED:
            afresh = _refit_from_all(result, graph, config, fixed)
        else:
            afresh = solve(result.poses, *graph.parts, config, fixed, EPISODE_KEYS_MAX, graph.shared)
        is_fuller = afresh.accepted.sum() > result.accepted.sum()
        if is_fuller and _cost(graph, afresh) < _cost(graph, result) and may_replace(result, afresh):
            return afresh
    return result


def _cost(graph: Graph, result: BackendResult) -> float:
    """Truncated least squares cost (Yang 2020, Eq. 3): squared errors of accepted edges, and GATE for each rejected
    one.

    Odometry covariances allow for more than most paths err by. A map may therefore bend by metres to a single false
    closure, and accepts one more than before; odometry pays for it with more than that closure is worth.
    """
    squared = graph.squared_errors(result.poses)
    return float(squared[result.accepted].sum()) + GATE * int(np.count_nonzero(~result.accepted))


def _refit_from_all(result: BackendResult, graph: Graph, config: PoseGraphConfig, fixed: int) -> BackendResult:
    """Refit that starts from a least-squares fit of all closures and accepts rejected ones that agree with it."""
    equations = NormalEquations(graph.edges, graph.measured, graph.information, len(result.poses), fixed, graph.shared)
    poses = equations.minimise(result.poses, np.ones_like, config.iterations_max, EPISODE_STEP_M, EPISODE_STEP_RAD)
    fits = equations.squared_errors(poses) < RETURNS_BELOW
    return refit_closures(poses, graph, result.accepted | fits, config, fixed)


def refit_closures(
    poses: Array, graph: Graph, is_used: Array, config: PoseGraphConfig, fixed: int | Array
) -> BackendResult:
    """Refit the used closures, reject those the fit contradicts and accept those that agree with it again.

    fixed: index of the pose held fixed, or several (k,).
    """
    used = is_used | ~graph.is_closure
    equations = NormalEquations(graph.edges, graph.measured, graph.information, len(poses), fixed, graph.shared)
    for _ in range(ROUNDS_MAX):
        poses = equations.minimise(
            poses, lambda squared: _weights_of_used(squared, graph.is_closure, used, config.robust_scale),
            config.iterations_max, EPISODE_STEP_M, EPISODE_STEP_RAD,
        )  # fmt: skip
        squared = equations.squared_errors(poses)
        if not _reconsider(squared, graph.is_closure, used):
            break
    why = [(e, f"contradicts the map (squared error {squared[e]:.1f})") for e in np.flatnonzero(~used).tolist()]
    return BackendResult(poses, used, tuple(Rejection(*one) for one in why))


@kernel
def _weights_of_used(squared, is_closure, used, scale):
    """(edges,) dynamic covariance scaling weight of used closures; odometry always 1, unused closures 0."""
    weight = np.empty(squared.shape[0])
    for e in range(squared.shape[0]):
        root = min(1.0, 2 * scale / (scale + squared[e])) if is_closure[e] else 1.0
        weight[e] = root * root if used[e] else 0.0
    return weight


@borrowing_kernel
def _reconsider(squared, is_closure, used):
    """Reject used closures above REVOKED_ABOVE, accept unused ones below RETURNS_BELOW; returns whether any changed."""
    is_changed = False
    for e in range(squared.shape[0]):
        if is_closure[e] and (squared[e] > REVOKED_ABOVE if used[e] else squared[e] < RETURNS_BELOW):
            used[e] = not used[e]
            is_changed = True
    return is_changed


def solve(
    poses: Array, edges: Array, measured: Array, information: Array, is_closure: Array, config: PoseGraphConfig,
    fixed: int = 0, keys_max: int = KEYS_MAX, shared: SharedErrors | None = None,
) -> BackendResult:  # fmt: skip
    """Optimise in the mode `config.robust` and report which closures were accepted. Deterministic.

    Arguments as for `pose_graph.optimise`. `gnc`, `pcm` and `ours` treat odometry as outlier-free; `ours` computes the
    joint covariance of at most `keys_max` poses.
    """
    poses = np.array(poses, float)
    graph = Graph(
        validated_rows(edges, (2,), "edges of a graph", np.int64, "edges"),
        validated_rows(measured, (3,), "measurements of a graph", rows="edges"),
        validated_rows(information, (3, 3), "information of a graph", rows="edges"),
        validated_rows(is_closure, (), "is_closure of a graph", bool, "edges"),
        shared,
    )
    _check(poses, graph, fixed, is_inverted=config.robust in ("pcm", "ours"))
    reasons: dict[int, str] = {}
    held = poses[fixed].copy() if len(poses) else np.zeros(3)
    if config.robust in ("pcm", "ours"):
        poses = _near_origin(poses)
    if len(poses) < 2 or not graph.is_closure.any():
        out, accepted = pose_graph.optimise(poses, *graph.parts, config, fixed, shared), np.ones(len(graph.edges), bool)
    elif config.robust in ("plain", "dcs", "cauchy"):
        out, accepted = _weighed(graph, poses, config, fixed)
    elif config.robust == "gnc":
        out, accepted = _graduated(graph, poses)
    elif config.robust == "pcm":
        out, accepted = pairwise_consistent(graph, poses)
    elif is_in_file(config.robust):
        out, accepted = OwnBackEnd(config).solve(poses, graph, fixed)
    else:
        out, accepted, reasons = ConsistentSetSearch(graph, poses, config, keys_max).run()
    if len(out) and config.robust not in ("plain", "dcs", "cauchy"):
        out = compose(held, between(out[fixed], out))
        out[fixed] = held
    general = {
        "gnc": "truncated: its error stayed above the inlier bound",
        "pcm": "not in the largest pairwise consistent set",
        "dcs": "down-weighted below one half by its residual",
        "cauchy": "down-weighted below one half by its residual",
    }.get(config.robust, f"refused by {config.robust}")
    refused = np.flatnonzero(~accepted).tolist()
    return BackendResult(out, accepted, tuple(Rejection(edge, reasons.get(edge, general)) for edge in refused))


def _near_origin(poses: Array) -> Array:
    """The poses (n, 3), shifted to the origin if their centre is further than FAR_M from it."""
    centre_m = np.mean(poses[:, :2], axis=0) if len(poses) else np.zeros(2)
    return poses - np.array([*centre_m, 0.0]) if np.hypot(*centre_m) > FAR_M else poses


def _check(poses: Array, graph: Graph, fixed: int, is_inverted: bool) -> None:
    """Raise DataError for a graph that is invalid input to the kernels, which check nothing."""
    lengths = {len(part) for part in graph.parts}
    if poses.ndim != 2 or poses.shape[1] != 3 or len(lengths) != 1:
        raise DataError(f"a graph has poses (n, 3) and as many measurements as edges; got {poses.shape} and {lengths}")
    if graph.edges.size and not 0 <= graph.edges.min() <= graph.edges.max() < len(poses):
        raise DataError(f"edges join poses 0 to {len(poses) - 1}; got {graph.edges.min()} to {graph.edges.max()}")
    if not all(np.isfinite(values).all() for values in (poses, graph.measured, graph.information)):
        raise DataError("poses, measurements and information must be finite")
    if len(poses) and (not isinstance(fixed, (int, np.integer)) or not 0 <= fixed < len(poses)):
        raise DataError(f"the pose that is held must be one of 0 to {len(poses) - 1}; got {fixed}")
    _check_information(graph.information, is_inverted)


def _check_information(information: Array, is_inverted: bool) -> None:
    """Raise DataError unless information (e, 3, 3) is symmetric and positive semidefinite (definite if it is
    inverted)."""
    largest = np.abs(information).max(axis=(1, 2), initial=0.0)
    is_odd = np.abs(information - information.transpose(0, 2, 1)).max(axis=(1, 2), initial=0.0) > 1e-6 * largest
    least = np.linalg.eigvalsh(information).min(axis=1, initial=np.inf)
    is_odd |= least < -1e-9 * largest
    what = "symmetric and positive semidefinite"
    if is_inverted:
        is_odd, what = is_odd | (least <= 0.0), "symmetric and positive definite"
    if is_odd.any():
        edge = int(np.argmax(is_odd))
        raise DataError(
            f"information must be {what} (an inverse covariance); that of edge {edge} is {information[edge].tolist()}"
        )


def _weighed(graph: Graph, poses: Array, config: PoseGraphConfig, fixed: int) -> tuple[Array, Array]:
    out = pose_graph.optimise(poses, *graph.parts, config, fixed, graph.shared)
    weight = pose_graph.robust_weights(graph.squared_errors(out), graph.is_closure, config)
    return out, weight > 0.5


def _graduated(graph: Graph, poses: Array) -> tuple[Array, Array]:
    """Graduated non-convexity with truncated least squares, odometry assumed outlier-free (Yang 2020, Eq. 14-15)."""
    poses = graph.fit(poses, np.ones(len(graph.edges)), 30)
    largest = graph.squared_errors(poses)[graph.is_closure].max()
    weight = np.ones(len(graph.edges))
    if 2 * largest <= GATE:
        return poses, weight > 0.5
    mu = 1.0 / (2 * largest / GATE - 1)
    for _ in range(ANNEALING_MAX):
        squared = graph.squared_errors(poses)
        high, low = (mu + 1) / mu * GATE, mu / (mu + 1) * GATE
        middle = np.sqrt(GATE * mu * (mu + 1) / np.maximum(squared, 1e-12)) - mu
        truncated = np.where(squared >= high, 0.0, np.where(squared <= low, 1.0, middle))
        weight = np.where(graph.is_closure, truncated, 1.0)
        poses = graph.fit(poses, weight, 5)
        if np.all(np.minimum(weight, 1 - weight) < 1e-4):
            break
        mu *= 1.4
    accepted = weight > 0.5
    return graph.fit(poses, accepted.astype(float)), accepted
