"""Optimise a pose graph of any origin: each component by itself, robustly, with a decision on every closure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import PoseGraphConfig
from twc_env.errors import DataError
from twc_env.records.geometry import compose, inverse
from twc_env.records.planar_graph import PlanarGraph
from twc_env.slam.graph_optimisation.components import components_of, hanging_parts, placed_poses, poses_apart
from twc_env.slam.graph_optimisation.trust import FEW_REFUSED, Trust, trust_in
from twc_env.slam.pose_graph import solver as pose_graph
from twc_env.slam.pose_graph.odometry_chains import Chains
from twc_env.slam.pose_graph.pairwise_consistency import PairwiseConsistency
from twc_env.slam.pose_graph.robust_back_end import BackendResult, refit_closures, solve
from twc_env.slam.pose_graph.solver import GATE, Graph, NormalEquations

METHODS = ("ours", "dcs", "cauchy", "gnc", "pcm", "none")
ITERATIONS_MAX = 100
LANDMARK_GATE = 9.21
"""99 % quantile of chi squared with two degrees of freedom: observations beyond it are weighed down."""
LANDMARKS_MIN = 2
"""So many held landmarks say where the map lies."""
HEADING_INFORMATION = 1e-6
"""Landmarks have no heading; the first observation of each fixes one."""


@dataclass(frozen=True, slots=True, eq=False)
class OptimisedGraph:
    """The result for the vertices and edges of a `PlanarGraph`."""

    poses: Array
    """(n, 3)."""
    start: Array
    """(n, 3) before: of the file, or laid along the edges."""
    landmarks_m: Array
    """(m, 2)."""
    component: Array
    """(n,) component of each vertex."""
    accepted: Array
    """(e,) bool; always true for odometry."""
    squared_errors: Array
    """(e,) chi squared of each edge at the result."""
    landmark_errors: Array
    """(s,) chi squared of each observation of a landmark."""
    reasons: dict[int, str]
    """Why each rejected edge is rejected."""
    opponents: dict[int, tuple[int, float]]
    """Of rejected edges: the nearest accepted closure that contradicts it, and chi squared of both by odometry."""
    hanging: dict[int, int]
    """Accepted closures that alone hold a part of their component, unchecked, and the poses of that part."""
    trust: tuple[Trust, ...]
    """Of each component."""

    @property
    def is_lost(self) -> bool:
        """Whether any component of two vertices or more is lost."""
        return any(trust.is_lost for trust in self.trust)


def optimise_graph(graph: PlanarGraph, robust: str = "ours") -> OptimisedGraph:
    """Optimise each component of a graph by one of METHODS, or a back end FILE.py:CLASS of one's own.

    Vertices and landmarks of FIX lines stay; a component with neither such a vertex nor two such landmarks holds its
    first vertex. Raises DataError where the equations have no finite solution.
    """
    start = placed_poses(graph)
    component = components_of(graph)
    poses, accepted = start.copy(), np.ones(len(graph.edges), bool)
    landmarks_m = graph.landmarks_m.copy()
    reasons: dict[int, str] = {}
    opponents: dict[int, tuple[int, float]] = {}
    hanging: dict[int, int] = {}
    trust = []
    config = PoseGraphConfig(robust="plain" if robust == "none" else robust, iterations_max=ITERATIONS_MAX)
    for number in range(int(component.max(initial=-1)) + 1):
        members = np.flatnonzero(component == number)
        place = np.full(len(start), -1)
        place[members] = np.arange(len(members))
        edges = np.flatnonzero(place[graph.edges[:, 0]] >= 0)
        part = Graph(place[graph.edges[edges]], graph.measured[edges], graph.information[edges],
                     ~graph.is_odometry[edges])  # fmt: skip
        held = place[graph.held[component[graph.held] == number]]
        observations = np.flatnonzero(component[graph.landmark_observations[:, 0]] == number)
        fixed = np.intersect1d(graph.held_landmarks, graph.landmark_observations[observations, 1])
        if not len(held) and len(fixed) < LANDMARKS_MIN:
            held = np.zeros(1, np.int64)
        result = _solve(part, start[members], config, int(held[0]) if len(held) else 0)
        if len(observations) or len(held) > 1:
            fitted, seen = _with_landmarks(
                graph, part, start[members], result, held, place, observations, robust == "none"
            )
            result = BackendResult(fitted, result.accepted, result.rejections)
            for landmark, where in seen.items():
                landmarks_m[landmark] = where
        if not np.isfinite(result.poses).all():
            raise DataError(
                f"the part of the graph with vertex {graph.vertex_ids[members[0]]} has no finite solution; check its "
                "measurements and information"
            )
        poses[members], accepted[edges] = result.poses, result.accepted
        reasons |= {int(edges[one.edge]): one.reason for one in result.rejections}
        opponents |= {int(edges[e]): (int(edges[by]), chi) for e, (by, chi) in _opponents(part, start[members], result)}
        used = np.flatnonzero(result.accepted)
        is_told = _landmark_errors(graph, observations, poses, landmarks_m) <= LANDMARK_GATE
        witnesses = _witnesses(graph, place, observations[is_told], held)
        alone = hanging_parts(len(members), part.edges[used], part.is_closure[used], witnesses)
        hanging |= {int(edges[used[e]]): behind for e, behind in alone.items()}
        joined = np.concatenate([part.edges[used], witnesses])
        checked = np.delete(joined, list(alone), axis=0)
        apart = [poses_apart(len(members), pairs) for pairs in (checked, joined)]
        trust.append(trust_in(part, result, robust, *apart))
    return OptimisedGraph(
        poses=poses,
        start=start,
        landmarks_m=landmarks_m,
        component=component,
        accepted=accepted,
        squared_errors=pose_graph.squared_errors(poses, graph.edges, graph.measured, graph.information),
        landmark_errors=_landmark_errors(graph, np.arange(len(graph.landmark_observations)), poses, landmarks_m),
        reasons=reasons,
        opponents=opponents,
        hanging=hanging,
        trust=tuple(trust),
    )


def _solve(graph: Graph, start: Array, config: PoseGraphConfig, held: int) -> BackendResult:
    """One component. Where all closures nearly agree, `ours` needs no search."""
    if len(start) < 2 or not len(graph.edges):
        return BackendResult(start.copy(), np.ones(len(graph.edges), bool), ())
    begin = _better_start(graph, start, held)
    if config.robust != "ours":
        return solve(begin, *graph.parts, config, held)
    fitted = NormalEquations(graph.edges, graph.measured, graph.information, len(begin), held).minimise(
        begin, np.ones_like, config.iterations_max
    )
    is_used = np.ones(len(graph.edges), bool)
    quick = refit_closures(fitted, graph, is_used, config, held)
    if len(quick.rejections) <= FEW_REFUSED * np.count_nonzero(graph.is_closure):
        squared = graph.squared_errors(quick.poses)
        if squared[quick.accepted].mean() < 3.0:  # no more than the stated noise
            return quick
    return solve(begin, *graph.parts, config, held)


def _better_start(graph: Graph, start: Array, held: int) -> Array:
    """The poses given, or those along odometry if these have a smaller error."""
    if graph.is_closure.all():
        return start
    along = Chains(graph, start).dead_reckoning(start)
    along = compose(compose(start[held], inverse(along[held])), along)
    errors = [float(np.minimum(graph.squared_errors(poses), 1e12).sum()) for poses in (start, along)]
    return start if errors[0] <= errors[1] else along


def _with_landmarks(
    graph: PlanarGraph, part: Graph, start: Array, result: BackendResult, held: Array, place: Array,
    observations: Array, is_plain: bool,
) -> tuple[Array, dict[int, Array]]:  # fmt: skip
    """Poses of a component and its landmarks, fitted jointly to what was accepted and the observations."""
    landmarks, number = np.unique(graph.landmark_observations[observations, 1], return_inverse=True)
    count = len(start)
    by, seen_m = place[graph.landmark_observations[observations, 0]], graph.seen_m[observations]
    first = np.unique(number, return_index=True)[1] if len(number) else np.zeros(0, np.int64)
    information = np.zeros((len(observations), 3, 3))
    information[:, :2, :2] = graph.seen_information[observations]
    information[first, 2, 2] = HEADING_INFORMATION
    used = part.of(result.accepted)
    edges = np.concatenate([used.edges, np.column_stack([by, count + number.ravel()])])
    measured = np.concatenate([used.measured, np.column_stack([seen_m, np.zeros(len(seen_m))])])
    weights = np.concatenate([used.information, information])
    fixed = np.concatenate([held, count + np.flatnonzero(np.isin(landmarks, graph.held_landmarks))])
    equations = NormalEquations(edges, measured, weights, count + len(landmarks), fixed)
    is_landmark = np.arange(len(edges)) >= len(used.edges)

    def whole(poses: Array) -> Array:
        places = np.column_stack([graph.landmarks_m[landmarks], np.zeros(len(landmarks))])
        unknown = np.isnan(places[:, 0])
        seen_at = compose(poses[by[first]], np.column_stack([seen_m[first], np.zeros(len(first))]))
        places[unknown] = seen_at[unknown]
        return np.concatenate([poses, places])

    candidates = [whole(np.where(np.isin(np.arange(count), held)[:, None], start, poses)) for poses in
                  (result.poses, start)]  # fmt: skip
    begin = min(candidates, key=lambda poses: float(np.minimum(equations.squared_errors(poses), 1e12).sum()))
    fitted = equations.minimise(begin, np.ones_like, ITERATIONS_MAX)
    if not is_plain and (equations.squared_errors(fitted)[is_landmark] > LANDMARK_GATE).any():

        def scaled(squared: Array) -> Array:
            root = np.minimum(1.0, 2 * LANDMARK_GATE / (LANDMARK_GATE + squared))
            return np.where(is_landmark, root**2, 1.0)

        fitted = equations.minimise(fitted, scaled, ITERATIONS_MAX)
    return fitted[:count], {int(k): fitted[count + m, :2] for m, k in enumerate(landmarks)}


def _witnesses(graph: PlanarGraph, place: Array, observations: Array, held: Array) -> Array:
    """(w, 2) poses of a component, one after the other, that see the same landmark or are held; all held landmarks
    count as one with the held poses."""
    of = graph.landmark_observations[observations, 1]
    mark = np.concatenate([np.where(np.isin(of, graph.held_landmarks), -1, of), np.full(len(held), -1)])
    pose = np.concatenate([place[graph.landmark_observations[observations, 0]], held])
    order = np.lexsort((pose, mark))
    is_same = mark[order][1:] == mark[order][:-1]
    return np.column_stack([pose[order][:-1], pose[order][1:]])[is_same]


def _landmark_errors(graph: PlanarGraph, chosen: Array, poses: Array, landmarks_m: Array) -> Array:
    """Squared errors of the chosen observations (k,)."""
    if not len(chosen):
        return np.zeros(0)
    (by, of), seen_m, information = (
        graph.landmark_observations[chosen].T,
        graph.seen_m[chosen],
        graph.seen_information[chosen],
    )
    pose = poses[by]
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    away = landmarks_m[of] - pose[:, :2]
    error = np.column_stack([c * away[:, 0] + s * away[:, 1], -s * away[:, 0] + c * away[:, 1]]) - seen_m
    return np.asarray(np.einsum("si,sij,sj->s", error, information, error))


def _opponents(graph: Graph, start: Array, result: BackendResult) -> list[tuple[int, tuple[int, float]]]:
    """Of each rejected closure the nearest accepted one on the same paths, if odometry between them says that not both
    are true; and chi squared of that."""
    accepted = np.flatnonzero(result.accepted & graph.is_closure)
    rejected = np.array([one.edge for one in result.rejections if graph.is_closure[one.edge]], np.int64)
    if not len(accepted) or not len(rejected):
        return []
    chains = Chains(graph, start)
    closures = np.flatnonzero(graph.is_closure)
    pairs = PairwiseConsistency(graph, chains.dead_reckoning(start), chains, closures)
    row_of = np.full(len(graph.edges), -1)
    row_of[closures] = np.arange(len(closures))
    chain, step = chains.chain[graph.edges], chains.step[graph.edges]
    nearest = np.full(len(rejected), -1)
    for k, e in enumerate(rejected.tolist()):
        same = (chain[accepted] == chain[e]).all(axis=1)
        if same.any():
            away = np.abs(step[accepted] - step[e]).sum(axis=1)
            nearest[k] = accepted[np.argmin(np.where(same, away, np.iinfo(np.int64).max))]
    known = nearest >= 0
    chi = pairs.squared_distances(row_of[rejected[known]], row_of[nearest[known]])
    triples = zip(rejected[known].tolist(), nearest[known].tolist(), chi.tolist(), strict=True)
    return [(e, (by, value)) for e, by, value in triples if value > GATE]
