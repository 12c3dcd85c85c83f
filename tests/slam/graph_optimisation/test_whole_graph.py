import numpy as np
import pytest

from tests.real_data import DATA, needs_data
from tests.soak.malformed.graph_fuzz import ring_graph
from twc_env.config import PoseGraphConfig
from twc_env.datasets.logs.pose_graph_file import read_pose_graph
from twc_env.metrics import absolute_trajectory_error_m
from twc_env.records.planar_graph import PlanarGraph
from twc_env.reproduce.pose_graphs import robustness
from twc_env.slam.graph_optimisation.components import (
    components_of,
    hanging_parts,
    placed_poses,
    poses_apart,
    unchecked_poses,
)
from twc_env.slam.graph_optimisation.whole_graph import METHODS, optimise_graph


def read(tmp_path, text):
    (tmp_path / "a.g2o").write_text(text)
    return read_pose_graph(tmp_path / "a.g2o")


@pytest.mark.parametrize("method", [name for name in METHODS if name != "none"])
def test_the_false_closure_of_a_ring_is_rejected_and_its_opponent_named(tmp_path, method):
    graph = read(tmp_path, ring_graph())
    result = optimise_graph(graph, method)
    assert np.flatnonzero(~result.accepted).tolist() == [len(graph.edges) - 1]
    false = len(graph.edges) - 1
    assert result.reasons[false]
    assert result.squared_errors[false] > 100
    by, chi = result.opponents[false]
    assert result.accepted[by] and not graph.is_odometry[by] and chi > 100
    radius = np.hypot(*(result.poses[:, :2] - result.poses[:, :2].mean(axis=0)).T)
    assert radius == pytest.approx(np.full(24, 5.0), abs=0.1)
    assert not result.is_lost


def test_a_fit_of_all_closures_says_that_it_contradicts_itself(tmp_path):
    result = optimise_graph(read(tmp_path, ring_graph()), "none")
    assert result.accepted.all()
    assert result.is_lost
    assert "contradicts itself" in result.trust[0].reasons[0]


def test_without_odometry_between_them_two_components_are_solved_apart(tmp_path):
    graph = read(tmp_path, ring_graph() + ring_graph(first=500))
    result = optimise_graph(graph)
    assert result.component.tolist() == 24 * [0] + 24 * [1]
    assert result.poses[24:] == pytest.approx(result.poses[:24], abs=1e-6)
    assert [trust.accepted for trust in result.trust] == [8, 8]


def test_fixed_vertices_stay_and_others_move(tmp_path):
    text = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nVERTEX_SE2 2 2 0 0\nFIX 2\n"
    edges = "EDGE_SE2 0 1 1.1 0 0 100 0 0 100 0 400\nEDGE_SE2 1 2 1.1 0 0 100 0 0 100 0 400\n"
    one = optimise_graph(read(tmp_path, text + edges))
    assert one.poses[:, 0] == pytest.approx([-0.2, 0.9, 2.0], abs=1e-4)
    both = optimise_graph(read(tmp_path, text + "FIX 0\n" + edges))
    assert both.poses[:, 0] == pytest.approx([0.0, 1.0, 2.0], abs=1e-4)


def test_landmarks_that_outweigh_odometry_move_the_poses(tmp_path):
    text = (
        "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 1.4 0 0 1 0 0 1 0 100\n"
        "EDGE_SE2_XY 0 9 0.5 1 1000 0 1000\nEDGE_SE2_XY 1 9 -0.5 1 1000 0 1000\n"
        "EDGE_SE2_XY 0 8 0.5 -1 1000 0 1000\nEDGE_SE2_XY 1 8 -0.5 -1 1000 0 1000\n"
    )
    result = optimise_graph(read(tmp_path, text))
    assert result.poses[1] == pytest.approx([1.0, 0.0, 0.0], abs=0.01)
    assert result.landmarks_m == pytest.approx(np.array([[0.5, -1.0], [0.5, 1.0]]), abs=0.01)
    assert result.landmark_errors.max() < 0.1


SURVEYED = (
    "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 1 0 0 100 0 0 100 0 400\n"
    "VERTEX_XY 8 10.5 5\nVERTEX_XY 9 10.5 7\n"
    "EDGE_SE2_XY 0 8 0.5 -1 100 0 100\nEDGE_SE2_XY 1 8 -0.5 -1 100 0 100\n"
    "EDGE_SE2_XY 0 9 0.5 1 100 0 100\nEDGE_SE2_XY 1 9 -0.5 1 100 0 100\n"
)


def test_two_fixed_landmarks_stay_and_say_where_the_poses_lie(tmp_path):
    graph = read(tmp_path, SURVEYED + "FIX 8\nFIX 9\n")
    assert graph.remarks == ()
    result = optimise_graph(graph)
    assert result.landmarks_m.tolist() == [[10.5, 5.0], [10.5, 7.0]]
    assert result.poses == pytest.approx(np.array([[10.0, 6.0, 0.0], [11.0, 6.0, 0.0]]), abs=1e-4)


def test_one_fixed_landmark_stays_beside_the_first_vertex(tmp_path):
    result = optimise_graph(read(tmp_path, SURVEYED + "FIX 8\n"))
    assert result.poses[0].tolist() == [0.0, 0.0, 0.0]
    assert result.landmarks_m[0].tolist() == [10.5, 5.0]
    assert result.landmarks_m[1] != pytest.approx([10.5, 7.0], abs=1.0)


def test_vertices_without_a_place_are_laid_along_odometry_first():
    edges = np.array([(0, 2), (0, 1), (1, 2), (2, 3)])
    measured = np.array([(9.0, 9.0, 0.0), (1.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 0.0, 0.0)])
    poses = np.full((4, 3), np.nan)
    poses[1] = [5.0, 5.0, np.pi / 2]
    graph = PlanarGraph(
        np.arange(4), poses, edges, measured, np.tile(np.eye(3), (4, 1, 1)), np.array([False, True, True, True]),
        np.zeros(0, np.int64),
    )  # fmt: skip
    laid = placed_poses(graph)
    assert laid[:, :2] == pytest.approx(np.array([[5, 4], [5, 5], [5, 6], [5, 7]]))
    assert components_of(graph).tolist() == [0, 0, 0, 0]


def test_poses_on_no_loop_are_unchecked():
    edges = np.array([(0, 1), (1, 2), (2, 3), (1, 3), (3, 4), (5, 6), (5, 6)])
    assert np.flatnonzero(unchecked_poses(7, edges)).tolist() == [0, 4]


def test_a_closure_that_is_a_bridge_is_named_with_the_smaller_part_unless_something_else_checks_it():
    edges = np.array([(0, 1), (1, 2), (2, 3), (1, 3), (3, 4), (4, 5)])
    is_closure = np.array([False, False, False, True, False, True])
    nothing = np.zeros((0, 2), np.int64)
    assert hanging_parts(6, edges, is_closure, nothing) == {5: 1}
    assert hanging_parts(6, edges, is_closure | (edges[:, 0] == 3), nothing) == {4: 2, 5: 1}
    assert hanging_parts(6, edges, is_closure, np.array([(0, 5)])) == {}
    assert [poses_apart(6, edges[:count]) for count in (0, 3, 6)] == [5, 2, 0]


BETWEEN = "EDGE_SE2 5 503 40 7 1 100 0 0 100 0 400\n"
SEEN = "EDGE_SE2_XY 0 900 1 1 {0} 0 {0}\nEDGE_SE2_XY 501 900 1 1 {0} 0 {0}\n"


@pytest.mark.parametrize(
    ("more", "hanging"),
    [
        ("", 24),
        ("EDGE_SE2 6 504 40 7 1 100 0 0 100 0 400\n", 0),
        (SEEN.format(1e-4), 0),
        ("FIX 1 500\n", 0),
        (SEEN.format(100), 24),
    ],
)
def test_one_closure_between_two_robots_alone_holds_half_of_the_map(tmp_path, more, hanging):
    graph = read(tmp_path, ring_graph() + ring_graph(first=500) + BETWEEN + more)
    result = optimise_graph(graph, "none")
    assert result.trust[0].hanging == hanging
    named = {tuple(graph.vertex_ids[graph.edges[e]].tolist()): poses for e, poses in result.hanging.items()}
    assert named == ({(5, 503): 24} if hanging else {})


@needs_data
@pytest.mark.parametrize("name", ["intel", "ring", "MIT"])
def test_graphs_without_false_closures_are_sound(name):
    result = optimise_graph(read_pose_graph(DATA / "posegraph" / f"{name}.g2o.gz"))
    assert not result.is_lost
    assert result.trust[0].accepted >= 0.95 * result.trust[0].closures


@needs_data
@pytest.mark.parametrize(("share", "is_lost"), [(0.5, False), (0.8, True)])
def test_the_lost_graph_of_mit_says_so(share, is_lost):
    start, clean, best = robustness.clean_graph(DATA / "posegraph", "MIT")
    graph, _ = robustness.corrupt(clean, best, "random", share, seed=3)
    edges = graph.edges, graph.measured, graph.information, ~graph.is_closure
    result = optimise_graph(PlanarGraph(np.arange(len(start)), start, *edges, np.zeros(0, np.int64)))
    assert (absolute_trajectory_error_m(result.poses, best) > 1.0) == is_lost
    assert result.is_lost == is_lost


def test_the_config_knows_all_methods():
    for name in METHODS:
        assert name == "none" or PoseGraphConfig(robust=name).robust == name
