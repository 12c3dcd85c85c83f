"""Whether an optimised pose graph can be trusted, or is lost. It never sees the truth.

Five things are measured of a component. *Undecided*: closures that the back end can neither accept nor contradict,
because drift is too large. *Second hypothesis*: how many of the rejected closures agree with each other and odometry
without the accepted ones; for back ends other than `ours`, also whether the search of `ours` in all closures finds
another map, unless all closures agree. *Chance*: accepted closures without which the map lies elsewhere, and which
that map denies, unless hardly any is rejected (`chance_closures`). *Contradiction*: squared errors of what was
accepted, per degree of freedom. *Expected error*: odometry and accepted closures are drawn anew from their stated
noise, scaled by that ratio, and the graph is optimised again; how far its poses move, after alignment, is the error
that the closures leave (a parametric bootstrap of the inverse Fisher information, without its gauge).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import PoseGraphConfig
from twc_env.records.geometry import between, compose
from twc_env.slam.graph_optimisation.chance_closures import aligned_distance_m, chance_closures
from twc_env.slam.graph_optimisation.components import unchecked_poses
from twc_env.slam.pose_graph.consistent_set import UNPROVEN
from twc_env.slam.pose_graph.robust_back_end import BackendResult, solve
from twc_env.slam.pose_graph.solver import Graph, NormalEquations

FEW_REFUSED = 0.05
"""Where a fit of all closures rejects at most this share of them, `ours` does not search for a set; where so few are
rejected, accepted ones that fit by chance are not looked for."""
UNDECIDED_MAX = 0.5
"""Undecided closures as a share of the accepted ones."""
SECOND_MAX = 0.5
"""Closures of the second hypothesis as a share of the accepted ones."""
CONTRADICTION_MAX = 10.0
"""Squared error per degree of freedom."""
EXPECTED_MAX = 0.08
"""Expected error as a share of the map's diagonal."""
STANDS_OUT = 25.0
"""With a larger squared error, or a rejected closure, the map of another back end is compared with that of `ours`."""
DIFFERS_ERRORS, DIFFERS_SHARE = 1.0, 0.01
"""Two maps differ if they are apart by more than so many expected errors and such a share of the diagonal."""
REJECTED_MIN = 3
"""So few rejected closures are no hypothesis."""
DRAWS, ROUNDS = 6, 3
PRIOR_CLOSURES = 5
"""Weight, in closures, of the stated noise against that of the residuals."""


@dataclass(frozen=True, slots=True)
class Trust:
    """What speaks for and against a result; `reasons` is empty if nothing says that it is lost."""

    reasons: tuple[str, ...]
    closures: int
    accepted: int
    undecided: int
    second: int
    """Closures of the second hypothesis."""
    contradiction: float
    """Squared error per degree of freedom; about 1 if the stated noise is right."""
    expected_error_m: float
    diagonal_m: float
    """Of the box around all poses."""
    unchecked: float
    """Share of poses on no loop of accepted closures."""
    hanging: int = 0
    """Poses that single closures, which nothing else checks, hold to the largest part; with the loose ones."""
    loose: int = 0
    """Poses that nothing accepted joins to the largest part."""

    @property
    def is_lost(self) -> bool:
        """Whether the result is not to be used."""
        return bool(self.reasons)


def trust_in(graph: Graph, result: BackendResult, robust: str = "ours", hanging: int = 0, loose: int = 0) -> Trust:
    """How far the result of the back end `robust` on this graph, one component, can be trusted.

    hanging, loose: as `Trust` has them.
    """
    poses, accepted = result.poses, result.accepted & graph.is_closure
    used = graph.of(result.accepted | ~graph.is_closure)
    count, closures = int(accepted.sum()), int(graph.is_closure.sum())
    undecided = sum(UNPROVEN in rejection.reason for rejection in result.rejections)
    second = _second_hypothesis(graph, poses, accepted)
    errors = used.squared_errors(poses)
    loops = max(len(used.edges) - len(poses) + 1, 0)
    contradiction = (float(errors.sum()) + 3 * PRIOR_CLOSURES) / (3 * loops + 3 * PRIOR_CLOSURES)
    expected_m = _expected_error_m(used, poses) * np.sqrt(contradiction)
    diagonal_m = float(np.hypot(*np.ptp(poses[:, :2], axis=0))) if len(poses) else 0.0
    reasons = []
    if closures and not count:
        reasons.append(f"none of {closures} closures is accepted: odometry alone carries the map")
    elif undecided > UNDECIDED_MAX * count:
        reasons.append(
            f"{undecided} closures are undecided, {count} accepted: drift is too large to tell true from false"
        )
    if count and second > SECOND_MAX * count:
        reasons.append(
            f"{second} rejected closures agree with each other as {count} accepted ones do: a second hypothesis"
        )
    if contradiction > CONTRADICTION_MAX:
        reasons.append(f"what is accepted contradicts itself: squared error {contradiction:.3g} per degree of freedom")
    if closures and expected_m > EXPECTED_MAX * diagonal_m:
        reasons.append(
            f"the closures hold too little: expected error {expected_m:.3g} m on a map of {diagonal_m:.3g} m"
        )
    away_max_m = max(DIFFERS_ERRORS * expected_m, DIFFERS_SHARE * diagonal_m)
    is_mixed = closures - count > FEW_REFUSED * closures
    if is_mixed and (chance := chance_closures(graph, poses, accepted, away_max_m)):
        moved_m = max(moved_m for _, moved_m in chance)
        reasons.append(
            f"{len(chance)} of {count} accepted closures may fit by chance, as {closures - count} are rejected: "
            f"without it the map lies {moved_m:.3g} m elsewhere and denies it"
        )
    if robust != "ours" and count and (result.rejections or errors.max(initial=0.0) > STANDS_OUT):
        other = solve(poses, *graph.parts, PoseGraphConfig(robust="ours")).poses
        away_m = aligned_distance_m(other[:, :2], poses[:, :2])
        if away_m > away_max_m:
            reasons.append(f"the search of `ours` finds another map, {away_m:.3g} m away: use it, or compare both")
    return Trust(
        reasons=tuple(reasons),
        closures=closures,
        accepted=count,
        undecided=undecided,
        second=second,
        contradiction=contradiction,
        expected_error_m=expected_m,
        diagonal_m=diagonal_m,
        unchecked=float(unchecked_poses(len(poses), used.edges).mean()) if len(poses) > 1 else 0.0,
        hanging=hanging,
        loose=loose,
    )


def _second_hypothesis(graph: Graph, poses: Array, accepted: Array) -> int:
    """How many closures the incremental search accepts where those accepted are left out."""
    rejected = graph.is_closure & ~accepted
    if np.count_nonzero(rejected) < max(REJECTED_MIN, SECOND_MAX * np.count_nonzero(accepted)):
        return 0
    rest = graph.of(~accepted)
    found = solve(poses, *rest.parts, PoseGraphConfig(robust="ours"))
    return int(np.count_nonzero(found.accepted & rest.is_closure))


def _expected_error_m(used: Graph, poses: Array) -> float:
    """Root mean square distance [m] between the poses and those of redrawn measurements, after alignment."""
    if len(poses) < 3 or not len(used.edges):
        return 0.0
    equations = NormalEquations(used.edges, used.measured, used.information, len(poses), 0, used.shared)
    spread = np.linalg.cholesky(np.linalg.inv(used.information))
    fitted = between(poses[used.edges[:, 0]], poses[used.edges[:, 1]])
    random = np.random.default_rng(0)
    weight = np.ones(len(used.edges))
    squares = []
    for _ in range(DRAWS):
        noise = np.einsum("eij,ej->ei", spread, random.normal(size=(len(spread), 3)))
        equations.measured = np.ascontiguousarray(compose(fitted, noise))
        moved = equations.minimise(poses, lambda squared: weight, ROUNDS)
        squares.append(aligned_distance_m(moved[:, :2], poses[:, :2]) ** 2)
    return float(np.sqrt(np.mean(squares)))
