"""Covariance of the relative frames of robots, compared with the errors of many random draws."""

import numpy as np
import pytest

from twc_env.config import PoseGraphConfig
from twc_env.metrics import implied_frames
from twc_env.records.geometry import between, compose, poses_along
from twc_env.slam.pose_graph import solver as pose_graph
from twc_env.slam.pose_graph.frame_covariance import frame_covariances, frame_stds
from twc_env.slam.pose_graph.solver import Graph
from twc_env.slam.pose_graph.systematic_errors import UNOWNED, shared_errors

PLAIN = PoseGraphConfig(robust="plain", iterations_max=100)
STEPS, STEP_M, SCALE_STD, CURL_STD = 40, 0.4, 0.03, 0.006
NOISE, CLOSURE_NOISE = np.array([0.02, 0.02, 0.005]), np.array([0.1, 0.1, 0.05])
SECOND_BEGINS = np.array([3.0, 2.0, 1.0])
ROBOT_OF = np.repeat([0, 1], STEPS + 1)


def draw(random, ties):
    """True poses, initial poses and graph of two robots on curved paths with closures between some poses (i, j)."""
    turns = 0.2 * np.sin(np.arange(STEPS) / 5)
    motions = np.column_stack([np.full(STEPS, STEP_M), np.zeros(STEPS), turns])
    true = np.concatenate([poses_along(motions), compose(SECOND_BEGINS, poses_along(motions))])
    read = []
    for _ in range(2):
        scale, curl = random.normal(0, (SCALE_STD, CURL_STD))
        off = np.column_stack([-scale * motions[:, 0], np.zeros(STEPS), np.full(STEPS, -curl * STEP_M)])
        read.append(motions + off + random.normal(0, 1, (STEPS, 3)) * NOISE)
    first = np.arange(STEPS)
    chains = np.concatenate([first, STEPS + 1 + first])
    ends = np.array(ties) + (0, STEPS + 1)
    met = between(true[ends[:, 0]], true[ends[:, 1]]) + random.normal(0, 1, (len(ties), 3)) * CLOSURE_NOISE
    edges = np.concatenate([np.column_stack([chains, chains + 1]), ends])
    measured = np.concatenate([*read, met])
    is_closure = np.arange(len(edges)) >= 2 * STEPS
    std = np.where(is_closure[:, None], CLOSURE_NOISE, NOISE)
    information = np.apply_along_axis(np.diag, 1, 1.0 / np.square(std))
    owner = np.where(is_closure, UNOWNED, np.arange(len(edges)) // STEPS)
    shared = shared_errors(owner, measured, np.full(len(edges), STEP_M), SCALE_STD)
    start = np.concatenate([poses_along(read[0]), compose(SECOND_BEGINS, poses_along(read[1]))])
    return true, start, Graph(edges, measured, information, is_closure, shared)


@pytest.mark.parametrize("ties", [[(5, 5), (6, 7), (8, 8)], [(0, 20), (20, 0), (35, 38)]])
def test_the_error_of_relative_frames_matches_their_covariance(ties):
    random, squared = np.random.default_rng(len(ties)), []
    for _ in range(60):
        true, start, graph = draw(random, ties)
        found = pose_graph.optimise(start, *graph.parts, PLAIN, 0, graph.shared)
        frames = compose(implied_frames(found, true, ROBOT_OF), np.array([*found[:, :2].mean(axis=0), 0.0]))
        error = frames[1] - frames[0]
        covariance = frame_covariances(found, graph, ROBOT_OF)[0, 1]
        squared.append(error @ np.linalg.solve(covariance, error) / 3)
    assert np.mean(squared) == pytest.approx(1.0, abs=0.35)


def test_the_covariance_is_larger_if_robots_met_at_one_place_only():
    random = np.random.default_rng(0)
    _, start, once = draw(random, [(5, 5), (6, 7), (8, 8)])
    _, _, along = draw(random, [(0, 0), (20, 20), (38, 38)])
    (near, near_rad), (far, far_rad) = (frame_stds(start, graph, ROBOT_OF)[0, 1] for graph in (along, once))
    assert near < 0.5 * far and near_rad < far_rad


def test_the_uncertainty_between_unconnected_robots_is_large():
    _, start, graph = draw(np.random.default_rng(0), [(0, 0)])
    stds = frame_stds(start, graph.of(~graph.is_closure), ROBOT_OF)
    assert (stds[0, 1] > 1.0).all() and stds[0, 0] == pytest.approx(0.0, abs=1e-3)
