from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from tests.real_data import DATA, needs_data
from twc_env.config import PoseGraphConfig
from twc_env.datasets.logs.pose_graph_file import read_pose_graph
from twc_env.errors import DataError
from twc_env.metrics import absolute_trajectory_error_m
from twc_env.records.geometry import between, compose, wrap_angle
from twc_env.reproduce.pose_graphs.robustness import dead_reckoning, read_graph
from twc_env.slam.pose_graph import solver as pose_graph
from twc_env.slam.pose_graph.solver import Graph

PLAIN = PoseGraphConfig(robust="plain", iterations_max=100)


def information_of(count: int, std_m: float = 0.05, std_rad: float = 0.02) -> np.ndarray:
    return np.tile(np.diag([std_m**-2, std_m**-2, std_rad**-2]), (count, 1, 1))


def chi2(poses: np.ndarray, graph: Graph) -> float:
    return float(graph.squared_errors(poses).sum())


def random_graph(seed: int, count: int = 12, closures: int = 6) -> tuple[np.ndarray, Graph]:
    """True poses of a random path, and a graph of noisy odometry and closures."""
    random = np.random.default_rng(seed)
    true = np.zeros((count, 3))
    for i in range(1, count):
        true[i] = compose(true[i - 1], [1.0, 0.0, random.normal(0, 0.6)])
    chain = [(i, i + 1) for i in range(count - 1)]
    loops = [tuple(sorted(random.choice(count, 2, replace=False))) for _ in range(closures)]
    edges = np.array(chain + loops)
    noise = random.normal(0, 1, (len(edges), 3)) * (0.05, 0.05, 0.02)
    measured = compose(between(true[edges[:, 0]], true[edges[:, 1]]), noise)
    is_closure = np.arange(len(edges)) >= len(chain)
    return true, Graph(edges, measured, information_of(len(edges)), is_closure)


def with_closures(graph: Graph, ends, measured) -> Graph:
    """The graph with further closures, whose information is the mean of the others'."""
    usual = graph.information[graph.is_closure].mean(axis=0)
    return Graph(
        np.concatenate([graph.edges, ends]),
        np.concatenate([graph.measured, measured]),
        np.concatenate([graph.information, np.tile(usual, (len(ends), 1, 1))]),
        np.append(graph.is_closure, np.ones(len(ends), bool)),
    )


@pytest.fixture
def square():
    """Twenty steps around a square with heading drift, and a closure at the end."""
    count = 21
    true = np.zeros((count, 3))
    for i in range(1, count):
        true[i] = compose(true[i - 1], [1.0, 0.0, np.pi / 2 if i % 5 == 0 else 0.0])
    edges = np.array([(i, i + 1) for i in range(count - 1)] + [(0, count - 1)])
    measured = between(true[edges[:, 0]], true[edges[:, 1]])
    measured[:-1, 2] += 0.02
    information = information_of(len(edges))
    information[-1] *= 100
    return true, Graph(edges, measured, information, np.arange(len(edges)) == count - 1)


def test_residuals_are_relative_to_the_measured_pose(square):
    true, graph = square
    expected = between(graph.measured, between(*true[graph.edges.T]))
    assert pose_graph.residuals(true, graph.edges, graph.measured) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("robust", ["dcs", "cauchy", "plain"])
def test_a_drifting_square_closes(square, robust):
    true, graph = square
    start = dead_reckoning(graph)
    assert np.hypot(*(start[-1] - true[-1])[:2]) > 0.5
    config = PoseGraphConfig(robust=robust, robust_scale=1000.0, iterations_max=50)
    poses = pose_graph.optimise(start, *graph.parts, config)
    assert np.hypot(*(poses[-1] - true[-1])[:2]) < 0.05
    assert np.hypot(*(poses - true)[:, :2].T).max() < np.hypot(*(start - true)[:, :2].T).max() / 3


def test_perfect_measurements_change_nothing(square):
    true, graph = square
    exact = replace(graph, measured=between(*true[graph.edges.T]))
    poses = pose_graph.optimise(true, *exact.parts, PoseGraphConfig())
    assert np.abs(between(true, poses)).max() < 1e-9


@settings(max_examples=15)
@given(st.integers(0, 10_000))
def test_small_graphs_agree_with_scipy(seed):
    _, graph = random_graph(seed)
    start = dead_reckoning(graph)
    root = np.linalg.cholesky(graph.information)

    def cost(free):
        poses = np.concatenate([start[:1], free.reshape(-1, 3)])
        r = pose_graph.residuals(poses, graph.edges, graph.measured)
        return np.einsum("kji,kj->ki", root, r).ravel()

    best = least_squares(cost, start[1:].ravel(), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    poses = pose_graph.optimise(start, *graph.parts, PLAIN)
    assert chi2(poses, graph) <= 2 * best.cost * (1 + 1e-4) + 1e-6
    assert np.abs(between(poses[1:], best.x.reshape(-1, 3))).max() < 2e-3


@settings(max_examples=15)
@given(st.integers(0, 10_000))
def test_no_iteration_increases_the_error_from_any_start(seed):
    true, graph = random_graph(seed)
    start = compose(true, np.random.default_rng(seed).normal(0, 1, true.shape) * (3.0, 3.0, 1.5))
    errors = [chi2(start, graph)]
    for count in range(1, 8):
        config = PoseGraphConfig(robust="plain", iterations_max=count)
        poses = pose_graph.optimise(start, *graph.parts, config)
        errors.append(chi2(poses, graph))
    assert np.all(np.diff(errors) <= 1e-9 * errors[0])


def test_the_fixed_pose_stays_and_the_others_move_with_it():
    true, graph = random_graph(3)
    there = compose(np.array([50.0, -20.0, 2.0]), true)
    start = compose(there, np.random.default_rng(0).normal(0, 0.1, true.shape))
    for fixed in (0, 5, len(true) - 1):
        poses = pose_graph.optimise(start, *graph.parts, PLAIN, fixed=fixed)
        assert np.array_equal(poses[fixed], start[fixed])
        reference = pose_graph.optimise(true, *graph.parts, PLAIN)
        relative = between(between(reference[fixed], reference), between(poses[fixed], poses))
        assert np.abs(relative).max() < 5e-3


@pytest.mark.parametrize("strange", [-1, 60])
def test_edges_to_missing_poses_are_rejected(strange):
    true, graph = random_graph(3)
    graph.edges[-1, 0] = strange
    with pytest.raises(DataError, match=r"edges join poses 0 to \d+; got"):
        pose_graph.optimise(true, *graph.parts, PLAIN)


def false_closure_error(robust: str) -> float:
    """Largest displacement [m] of the poses by one false closure among forty."""
    true, graph = random_graph(7, count=60, closures=40)
    config = PoseGraphConfig(robust=robust, iterations_max=100)
    good = pose_graph.optimise(true, *graph.parts, config)
    false = with_closures(graph, [[5, 55]], [compose(between(true[5], true[55]), [6.0, -4.0, 0.8])])
    bad = pose_graph.optimise(true, *false.parts, config)
    return float(np.hypot(*(bad - good)[:, :2].T).max())


def test_one_false_closure_changes_the_map_only_without_a_robust_loss():
    assert false_closure_error("dcs") < 0.02 < 0.3 < false_closure_error("plain")


def test_robust_weights_do_not_apply_to_odometry():
    squared, is_closure = np.array([0.0, 1e6, 1e6]), np.array([True, True, False])
    for robust in ("dcs", "cauchy", "plain"):
        weights = pose_graph.robust_weights(squared, is_closure, PoseGraphConfig(robust=robust))
        assert weights[[0, 2]].tolist() == [1.0, 1.0]
        assert (weights[1] < 1e-4) == (robust != "plain")


@pytest.mark.parametrize("robust", ["dcs", "cauchy"])
def test_robust_weights_fall_with_the_error(robust):
    squared = np.linspace(0, 200, 50)
    weights = pose_graph.robust_weights(squared, np.ones(50, bool), PoseGraphConfig(robust=robust))
    assert np.all(np.diff(weights) <= 0)
    assert np.all((weights > 0) & (weights <= 1))


def test_heading_residuals_wrap_at_pi():
    edges, measured = np.array([[0, 1]]), np.array([[1.0, 0.0, 0.1]])
    start = np.array([[0.0, 0.0, 3.1], [-1.0, 0.0, -3.1]])
    poses = pose_graph.optimise(start, edges, measured, information_of(1), np.array([False]), PLAIN)
    assert wrap_angle(poses[1, 2] - 3.2) == pytest.approx(0.0, abs=1e-6)


def public_graph(name: str) -> Graph:
    return read_graph(DATA / "posegraph" / f"{name}.g2o.gz")


@needs_data
@pytest.mark.parametrize(
    ("name", "chi2_max"),
    [("intel", 45.1), ("manhattanOlson3500_vertigo", 146.2), ("ring", 11.2), ("ringCity", 262.9)],
)
@pytest.mark.parametrize("robust", ["plain", "dcs"])
def test_public_pose_graphs_reach_their_known_error_from_odometry(name, chi2_max, robust):
    graph = public_graph(name)
    start = dead_reckoning(graph)
    config = PoseGraphConfig(robust=robust, iterations_max=100)
    poses = pose_graph.optimise(start, *graph.parts, config)
    assert chi2(poses, graph) <= chi2_max


@needs_data
def test_manhattan_reaches_its_optimum_from_odometry():
    graph = public_graph("manhattan")
    start = dead_reckoning(graph)
    poses = pose_graph.optimise(start, *graph.parts, PLAIN)
    assert chi2(poses, graph) == pytest.approx(3549.037, abs=0.01)


@needs_data
def test_a_start_forty_metres_off_ends_in_a_bounded_error():
    """From raw odometry the MIT graph has bad local minima; the error must still fall by six orders of magnitude."""
    graph = public_graph("MIT")
    start = dead_reckoning(graph)
    poses = pose_graph.optimise(start, *graph.parts, PLAIN)
    assert chi2(poses, graph) < 1e-6 * chi2(start, graph)


@needs_data
@pytest.mark.parametrize(("name", "error_max_m"), [("ring", 1.6), ("ringCity", 1.6)])
def test_simulated_public_graphs_converge_to_ground_truth(name, error_max_m):
    graph = public_graph(name)
    truth = read_pose_graph(DATA / "posegraph" / f"{name}_groundtruth.g2o.gz").poses
    start = dead_reckoning(graph)
    poses = pose_graph.optimise(start, *graph.parts, PLAIN)
    errors = [absolute_trajectory_error_m(estimate, truth) for estimate in (start, poses)]
    assert errors[1] < min(error_max_m, errors[0])


@pytest.mark.parametrize("seed", range(3))
def test_fixed_poses_stay_bit_identical_and_the_others_are_optimal(seed):
    true, graph = random_graph(seed)
    random, held = np.random.default_rng(seed), np.array([0, 1, 2, 7])
    start = true + random.normal(0, 0.05, true.shape)
    moves = np.setdiff1d(np.arange(len(true)), held)
    equations = pose_graph.NormalEquations(*graph.parts[:3], len(true), held)
    fitted = equations.minimise(start, np.ones_like, 100, 1e-9, 1e-9)

    def errors(free):
        poses = start.copy()
        poses[moves] = free.reshape(-1, 3)
        root = np.linalg.cholesky(graph.information[0])
        return (pose_graph.residuals(poses, graph.edges, graph.measured) @ root).ravel()

    assert fitted[held].tobytes() == start[held].tobytes()
    assert fitted[moves] == pytest.approx(least_squares(errors, start[moves].ravel()).x.reshape(-1, 3), abs=1e-5)
