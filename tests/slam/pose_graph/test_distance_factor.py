import numpy as np
import pytest

from twc_env.metrics.trajectory import absolute_trajectory_error_m
from twc_env.records.geometry import between, compose
from twc_env.slam.pose_graph.distance_factor import Distances, RadioEquations


def chain(count: int, seed: int = 0) -> np.ndarray:
    random = np.random.default_rng(seed)
    poses = np.zeros((count, 3))
    for k in range(1, count):
        poses[k] = compose(poses[k - 1], [1.0, 0.1 * random.normal(), 0.4 * random.normal()])
    return poses


def equations(poses: np.ndarray, distances: Distances) -> RadioEquations:
    edges = np.column_stack([np.arange(len(poses) - 1), np.arange(1, len(poses))])
    motion = between(poses[:-1], poses[1:])
    return RadioEquations(
        edges, motion, np.tile(np.diag([400.0, 400.0, 900.0]), (len(edges), 1, 1)), distances, len(poses)
    )


def test_the_analytic_jacobian_matches_finite_differences():
    poses = chain(6)
    distances = Distances(np.array([[0, 3], [5, 1], [2, 4]]), np.array([1.0, 2.0, 3.0]), np.array([0.5, 1.0, 4.0]))
    jacobian = distances.jacobian(poses)
    for e, (i, j) in enumerate(distances.pairs):
        for axis in range(2):
            for pose, sign in ((i, 1.0), (j, -1.0)):
                moved = poses.copy()
                moved[pose, axis] += 1e-6
                slope = (distances.residuals(moved)[e] - distances.residuals(poses)[e]) / 1e-6
                assert slope == pytest.approx(sign * jacobian[e, axis], abs=1e-5)


def test_normal_equations_of_distances_match_finite_differences():
    poses = chain(6)
    distances = Distances(np.array([[1, 4], [5, 2]]), np.array([1.0, 2.5]), np.array([0.5, 2.0]))
    graph, weight = equations(poses, distances), np.ones(7)
    _, _, gradient = graph.linearise(poses, weight)
    for pose in range(1, 6):
        for axis in range(3):
            moved = poses.copy()
            moved[pose, axis] += 1e-6
            slope = (graph.squared_errors(moved).sum() - graph.squared_errors(poses).sum()) / 2e-6
            assert -gradient[pose, axis] == pytest.approx(slope, abs=2e-3)


def test_distances_converge_in_four_iterations():
    """Without the off-diagonal blocks of the information matrix, four iterations would not be enough."""
    truth = chain(12, seed=1)
    pairs = np.array([(i, j) for i in range(12) for j in range(i + 3, 12, 3)])
    length = np.linalg.norm(truth[pairs[:, 0], :2] - truth[pairs[:, 1], :2], axis=1)
    graph = equations(truth, Distances(pairs, length, np.full(len(pairs), 1e-4)))
    start = truth + 0.02 * np.random.default_rng(0).normal(size=truth.shape) * (np.arange(12) > 0)[:, None]
    solved = graph.minimise(start, np.ones_like, 4)
    assert graph.squared_errors(solved).sum() < 1e-6 < graph.squared_errors(start).sum()


def test_coinciding_positions_have_no_gradient():
    poses = np.zeros((2, 3))
    distances = Distances(np.array([[0, 1]]), np.array([3.0]), np.array([1.0]))
    assert np.isfinite(distances.residuals(poses)).all() and not distances.jacobian(poses).any()


def test_distances_correct_a_drifted_path_and_the_first_pose_stays_fixed():
    truth = chain(30, seed=3)
    pairs = np.array([(i, j) for i in range(30) for j in range(i + 5, 30, 4)])
    length = np.linalg.norm(truth[pairs[:, 0], :2] - truth[pairs[:, 1], :2], axis=1)
    distances = Distances(pairs, length, np.full(len(pairs), 0.01))
    drifted = truth.copy()
    for k in range(1, 30):
        drifted[k] = compose(drifted[k - 1], between(truth[k - 1], truth[k]) + [0.0, 0.0, 0.02])
    found = equations(drifted, distances).minimise(drifted, lambda squared: np.ones(len(squared)), 50)
    assert (found[0] == drifted[0]).all()
    error = [absolute_trajectory_error_m(poses, truth) for poses in (found, drifted)]
    assert error[0] < 0.1 and error[1] > 5 * error[0]
