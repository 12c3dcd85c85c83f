"""Scale and curl errors shared by all odometry of a robot: in the graph, along chains, and in consistency checks."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from twc_env.config import PoseGraphConfig
from twc_env.records.geometry import between, compose, inverse, poses_along, wrap_angle
from twc_env.records.twists import logarithm
from twc_env.slam.pose_graph import robust_back_end as robust_backend
from twc_env.slam.pose_graph import solver as pose_graph
from twc_env.slam.pose_graph.closure_prediction import MapPrediction
from twc_env.slam.pose_graph.odometry_chains import Chains
from twc_env.slam.pose_graph.pairwise_consistency import PairwiseConsistency
from twc_env.slam.pose_graph.solver import Graph
from twc_env.slam.pose_graph.systematic_errors import CURL_STD_RAD_M, UNOWNED, shared_errors

SCALE_STD, STEP_M, NOISE = 0.03, 0.4, np.array([0.02, 0.02, 0.005])
PLAIN = PoseGraphConfig(robust="plain", iterations_max=100)


def walk(turns, scale=0.0, curl_rad_m=0.0, noise=None):
    """True poses (n, 3) with these turns between steps, and the motions measured by odometry."""
    true = np.column_stack([np.full(len(turns), STEP_M), np.zeros(len(turns)), turns])
    read = true * (1.0 + scale, 1.0 + scale, 1.0) + (0.0, 0.0, curl_rad_m * STEP_M)
    return poses_along(true), read if noise is None else read + noise


def graph_of(paths, closures=(), truth=None):
    """Graph of robots with these motions (n - 1, 3) each, and true closures between poses (i, j) of all robots."""
    first = np.cumsum([0, *(len(motions) + 1 for motions in paths)])
    chain = np.concatenate(
        [
            np.column_stack([k + np.arange(len(m)), k + np.arange(1, len(m) + 1)])
            for k, m in zip(first, paths, strict=False)
        ]
    )
    ties = np.array(closures, np.int64).reshape(-1, 2)
    edges, measured = np.concatenate([chain, ties]), np.concatenate(paths)
    if len(ties):
        measured = np.concatenate([measured, between(truth[ties[:, 0]], truth[ties[:, 1]])])
    owner = np.concatenate([np.repeat(np.arange(len(paths)), [len(m) for m in paths]), np.full(len(ties), UNOWNED)])
    information = np.tile(np.diag(1.0 / np.square(NOISE)), (len(edges), 1, 1))
    length_m = np.hypot(measured[:, 0], measured[:, 1])
    return Graph(edges, measured, information, owner == UNOWNED, shared_errors(owner, measured, length_m, SCALE_STD))


def two_robots(turns, scale, curl_rad_m=0.0, noise=None):
    """True and dead-reckoned poses (2 n, 3) of two robots with known first poses, and their motions."""
    true, motions = walk(turns, scale, curl_rad_m, noise)
    half = len(turns) // 2
    paths = [motions[:half], motions[half + 1 :]]
    reckoned = np.concatenate([poses_along(paths[0]), compose(true[half + 1], poses_along(paths[1]))])
    return true, reckoned, paths


@pytest.mark.parametrize("seed", range(3))
def test_the_joint_optimum_of_poses_and_shared_errors_equals_scipy(seed):
    random = np.random.default_rng(seed)
    true, start, paths = two_robots(random.normal(0, 0.5, 25), 0.04, 0.01, random.normal(0, 1, (25, 3)) * NOISE)
    graph = graph_of(paths, [(0, 11), (3, 15), (9, 22)], true)
    root = np.linalg.cholesky(graph.information).transpose(0, 2, 1)

    def cost(unknown):
        poses = np.concatenate([start[:1], unknown[: 3 * len(start) - 3].reshape(-1, 3)])
        errors = unknown[3 * len(start) - 3 :].reshape(2, 3)
        residuals = pose_graph.residuals(poses, graph.edges, graph.measured)
        bent = (graph.shared.bends @ errors[graph.shared.owner][..., None])[..., 0]
        left = (root @ (residuals - bent)[..., None])[..., 0]
        return np.concatenate([left.ravel(), errors.ravel()])

    best = least_squares(cost, np.concatenate([start[1:].ravel(), np.zeros(6)]), x_scale="jac", xtol=1e-12, ftol=1e-12)
    found = pose_graph.optimise(start, *graph.parts, PLAIN, 0, graph.shared)
    expected = np.concatenate([start[:1], best.x[: 3 * len(start) - 3].reshape(-1, 3)])
    assert found[:, :2] == pytest.approx(expected[:, :2], abs=5e-3)
    assert wrap_angle(found[:, 2] - expected[:, 2]) == pytest.approx(0.0, abs=3e-3)
    assert graph.squared_errors(found).sum() == pytest.approx(2 * best.cost, rel=0.02)


def test_a_closure_corrects_the_scale_of_the_whole_path():
    true, motions = walk(np.zeros(100), scale=0.03)
    graph = graph_of([motions], [(0, 50)], true)
    start = poses_along(motions)
    found = pose_graph.optimise(start, *graph.parts, PLAIN, 0, graph.shared)
    alone = pose_graph.optimise(start, *graph.parts, PLAIN, 0)
    assert np.hypot(*(alone[-1] - true[-1])[:2]) > 0.5
    assert np.hypot(*(found[-1] - true[-1])[:2]) < 0.1


def test_shared_errors_are_estimated_per_robot():
    true, start, paths = two_robots(np.zeros(101), 0.03)
    graph = graph_of(paths, [(0, 50), (0, 51)], true)
    found = pose_graph.optimise(start, *graph.parts, PLAIN, 0, graph.shared)
    assert np.hypot(*(found[25] - true[25])[:2]) < 0.05
    assert between(found[51], found[-1]) == pytest.approx(between(start[51], start[-1]), abs=1e-6)


def test_the_error_of_a_straight_path_grows_with_its_length():
    _, motions = walk(np.zeros(200))
    graph, poses = graph_of([motions]), poses_along(motions)
    chains = Chains(graph, poses)
    grown, bent = chains.accumulated_covariance(poses), chains.shared_error_columns(poses)
    first, last = np.zeros(2, np.int64), np.array([50, 200])
    alone, shared = chains.stretch(grown, first, last), chains.stretch(grown, first, last, bent)
    length_m = STEP_M * last
    assert alone[:, 0, 0] == pytest.approx(last * NOISE[0] ** 2)
    assert shared[:, 0, 0] - alone[:, 0, 0] == pytest.approx((SCALE_STD * length_m) ** 2)
    assert shared[:, 2, 2] - alone[:, 2, 2] == pytest.approx((CURL_STD_RAD_M * length_m) ** 2)


@pytest.mark.parametrize("steps", [5, 20, 50, 100])
def test_the_errors_of_chains_match_their_covariance_at_any_length(steps):
    random, squared = np.random.default_rng(steps), []
    for _ in range(200):
        errors = random.normal(0, (SCALE_STD, CURL_STD_RAD_M))
        noise = random.normal(0, 1, (steps, 3)) * NOISE
        true, motions = walk(random.normal(0, 0.3, steps), *errors, noise)
        graph, poses = graph_of([motions]), poses_along(motions)
        chains = Chains(graph, poses)
        ends = np.array([0]), np.array([steps])
        covariance = chains.stretch(chains.accumulated_covariance(poses), *ends, chains.shared_error_columns(poses))[0]
        error = logarithm(compose(true[-1], inverse(poses[-1])))
        squared.append(error @ np.linalg.solve(covariance, error) / 3)
    assert 0.8 < np.mean(squared) < 1.25


def test_without_accepted_closures_predictions_follow_the_odometry():
    true, motions = walk(np.full(60, 0.05), 0.02, 0.004)
    graph, poses = graph_of([motions], [(5, 45)], true), poses_along(motions)
    chains = Chains(graph, poses)
    prediction = MapPrediction(graph, chains, np.array([60]), 100)
    prediction.update(poses, np.zeros(0, np.int64))
    ends = np.array([5]), np.array([45])
    expected = chains.stretch(chains.accumulated_covariance(poses), *ends, chains.shared_error_columns(poses))
    assert prediction.drift(np.array([0])) == pytest.approx(expected, rel=1e-4, abs=1e-7)


def test_closures_between_paths_with_opposite_scale_errors_agree():
    (true, long), (_, short) = walk(np.zeros(80), scale=0.04), walk(np.zeros(80), scale=-0.04)
    poses = np.concatenate([poses_along(long), poses_along(short)])
    graph = graph_of([long, short], [(5, 86), (75, 156)], np.concatenate([true, true]))
    closures = np.flatnonzero(graph.is_closure)

    def squared(graph):
        chains = Chains(graph, poses)
        return PairwiseConsistency(graph, poses, chains, closures).squared_distances(np.array([0]), np.array([1]))[0]

    assert squared(replace(graph, shared=None)) > pose_graph.GATE
    assert squared(graph) < pose_graph.GATE


@pytest.mark.parametrize("robust", ["plain", "dcs", "gnc", "pcm", "ours"])
def test_every_mode_closes_a_long_loop_with_a_scale_error(robust):
    turns = np.where(np.arange(200) % 50 == 49, np.pi / 2, 0.0)
    true, motions = walk(turns, scale=0.05)
    ties = [(0, 199), (0, 200), (2, 200)]
    graph = graph_of([motions], ties, true)
    result = robust_backend.solve(
        poses_along(motions), *graph.parts, PoseGraphConfig(robust=robust), shared=graph.shared
    )
    assert result.accepted.all()
