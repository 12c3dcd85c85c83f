"""Pose graphs survive the g2o format, and public ones can be read."""

from pathlib import Path

import numpy as np
import pytest

from tests.real_data import DATA, needs_data
from twc_env.config import PoseGraphConfig
from twc_env.datasets.logs.g2o import write_g2o, write_vertices
from twc_env.datasets.logs.pose_graph_file import read_pose_graph
from twc_env.errors import DataError
from twc_env.slam.pose_graph import robust_back_end as robust_backend

CASES = Path(__file__).parents[1] / "cases"


def some_graph():
    rng = np.random.default_rng(0)
    factors = rng.normal(size=(4, 3, 3))
    return {
        "nodes": rng.normal(size=(4, 3)),
        "edges_ij": np.array([[0, 1], [1, 2], [2, 3], [0, 3]]),
        "edges_z": rng.normal(size=(4, 3)),
        "edges_information": factors @ factors.transpose(0, 2, 1),
    }


@pytest.mark.parametrize("name", ["a.g2o", "a.g2o.gz"])
def test_a_graph_survives_a_round_trip(tmp_path, name):
    graph = some_graph()
    write_g2o(tmp_path / name, graph)
    read = read_pose_graph(tmp_path / name)
    found = read.poses, read.edges, read.measured, read.information
    assert all(np.allclose(one, graph[key], atol=1e-6) for one, key in zip(found, graph, strict=True))
    assert read.is_odometry.tolist() == [True, True, True, False]


def test_the_graph_of_a_team_is_numbered_robot_by_robot(tmp_path):
    """As its keyframes arrive, those of several robots take turns: odometry was read as closures."""
    graph = some_graph() | {"edges_ij": np.array([[0, 2], [1, 3], [0, 1], [3, 2]]), "fixed": 1}
    write_g2o(tmp_path / "a.g2o", graph | {"node_ids": np.array([[0, 0], [1, 0], [0, 1], [1, 1]])})
    read = read_pose_graph(tmp_path / "a.g2o")
    assert np.allclose(read.poses, graph["nodes"][[0, 2, 1, 3]], atol=1e-6)
    assert [tuple(edge) for edge in read.edges.tolist()][:3] == [(0, 1), (2, 3), (0, 2)]
    assert read.is_odometry.tolist() == [True, True, False, False]
    assert "FIX 1000" in (tmp_path / "a.g2o").read_text().splitlines()


@pytest.mark.parametrize(("counts", "first"), [((5, 5), 1000), ((900, 3), 1000), ((901, 3), 2000), ((3, 1901), 3000)])
def test_a_closure_from_the_end_of_a_path_to_the_start_of_the_next_is_no_odometry(tmp_path, counts, first):
    """The second robot begins where the first ends."""
    ids = np.array([(robot, k) for robot in range(2) for k in range(counts[robot])])
    nodes = np.column_stack([ids.sum(axis=1) + (counts[0] - 2) * ids[:, 0], ids[:, 0] / 2, np.zeros(len(ids))])
    ij = np.array([(k, k + 1) for k in range(len(ids) - 1)])
    graph = {"nodes": nodes, "node_ids": ids, "edges_ij": ij, "edges_z": np.diff(nodes, axis=0)}
    information = np.tile(np.diag([100.0, 100.0, 400.0]), (len(ij), 1, 1))
    write_g2o(tmp_path / "a.g2o", graph | {"edges_information": information})
    read = read_pose_graph(tmp_path / "a.g2o")
    assert read.vertex_ids[counts[0]] == first
    assert np.flatnonzero(~read.is_odometry).tolist() == [counts[0] - 1]


def test_a_table_tells_whose_keyframe_each_vertex_is(tmp_path):
    """Robot 1 was carried: its second part has a number of its own in the graph."""
    graph = {"node_ids": np.array([[1, 0], [0, 0], [2, 0], [3, 0], [1, 3]]), "node_steps": np.array([4, 5, 0, 60, 21])}
    graph["node_robots"] = np.array([[1, 0], [0, 0], [-1, 0], [1, 4], [1, 3]])
    write_vertices(tmp_path / "a.csv", graph | {"node_times_s": np.array([0.4, 0.5, 0.0, 6.0, 2.1])})
    assert (tmp_path / "a.csv").read_text().splitlines() == [
        "vertex,robot,keyframe,step,time_s", "0,0,0,5,0.5", "1000,1,0,4,0.4", "1001,1,3,21,2.1", "2000,prior,0,,",
        "3000,1,4,60,6",
    ]  # fmt: skip


def test_a_graph_in_map_coordinates_keeps_its_micrometres(tmp_path):
    nodes = np.array([[500000.123456, 5412345.654321, 1.0], [500001.5, 5412346.234567, -3.1]])
    graph = {"nodes": nodes, "edges_ij": [[0, 1]], "edges_z": nodes[1:], "edges_information": [np.eye(3)]}
    write_g2o(tmp_path / "graph.g2o", graph)
    again = read_pose_graph(tmp_path / "graph.g2o")
    assert np.abs(again.poses - nodes).max() < 1e-7
    assert np.abs(again.measured - nodes[1:]).max() < 1e-7


def test_the_information_matrix_is_written_as_its_upper_triangle(tmp_path):
    graph = {
        "nodes": np.zeros((2, 3)),
        "edges_ij": [[0, 1]],
        "edges_z": [[1, 2, 3]],
        "edges_information": [[[11, 12, 13], [12, 22, 23], [13, 23, 33]]],
    }
    write_g2o(tmp_path / "a.g2o", graph)
    assert "EDGE_SE2 0 1 1 2 3 11 12 13 22 23 33" in (tmp_path / "a.g2o").read_text()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"edges_ij": np.array([[0, 1]])}, "differ in length"),
        ({"edges_ij": np.array([[0, 1], [1, 2], [2, 3], [0, 4]])}, "must lie in 0..3"),
        ({"edges_z": np.zeros((4, 2))}, r"\(n, 3\)"),
        ({"nodes": np.full((4, 3), np.nan)}, "nodes of the pose graph must be finite"),
    ],
)
def test_a_graph_that_does_not_fit_together_is_not_written(tmp_path, change, message):
    with pytest.raises(DataError, match=message):
        write_g2o(tmp_path / "a.g2o", some_graph() | change)
    assert not (tmp_path / "a.g2o").exists()


def solved(path, robust="ours"):
    """Poses of a file, its closures and how many of them are believed."""
    graph = read_pose_graph(path)
    parts = graph.poses, graph.edges, graph.measured, graph.information, ~graph.is_odometry
    result = robust_backend.solve(*parts, PoseGraphConfig(robust=robust), int(graph.held[0]) if len(graph.held) else 0)
    return result.poses, ~graph.is_odometry, int((~graph.is_odometry & result.accepted).sum())


@pytest.mark.parametrize("name", ["two-robots.g2o", "two-robots-apart.g2o"])
def test_the_paths_of_two_robots_are_not_joined_by_their_numbers(name):
    poses, is_closure, believed = solved(CASES / "12-g2o-ids" / name)
    assert ((~is_closure).sum(), is_closure.sum(), believed) == (6, 5, 4)
    assert np.ptp(poses[:, :2], axis=0) == pytest.approx([3.0, 3.0], abs=0.01)


def test_ids_may_have_any_step():
    odd, plain = (read_pose_graph(CASES / "12-g2o-ids" / name) for name in ("odd-ids.g2o", "consecutive.g2o"))
    assert odd.is_odometry.tolist() == plain.is_odometry.tolist()
    assert odd.is_odometry.sum() == 29


def test_toro_is_read_as_the_planar_graph_it_is():
    graph = read_pose_graph(CASES / "16-g2o-toro" / "toro.graph")
    assert graph.poses.tolist() == [[0, 0, 0], [1, 0, 0], [2, 0, 0]]
    assert graph.information[0].tolist() == np.diag([100.0, 100.0, 400.0]).tolist()


def test_the_fixed_vertex_of_a_file_stays_in_place():
    poses, *_ = solved(CASES / "16-g2o-toro" / "fix.g2o", "plain")
    assert poses[2] == pytest.approx([2.0, 0.0, 0.0], abs=1e-9)
    assert poses[0, 0] == pytest.approx(-0.2, abs=1e-3)


def test_a_self_edge_is_not_written(tmp_path):
    with pytest.raises(DataError, match="edge 1 of the pose graph leads from node 1 to itself"):
        write_g2o(tmp_path / "a.g2o", some_graph() | {"edges_ij": np.array([[0, 1], [1, 1], [2, 3], [0, 3]])})


@needs_data
@pytest.mark.parametrize(
    ("name", "odometry"),
    [("MIT", 807), ("intel", 1727), ("manhattan", 3499), ("manhattanOlson3500_vertigo", 3499), ("ring", 433)],
)
def test_public_graphs_keep_their_odometry(name, odometry):
    assert read_pose_graph(DATA / "posegraph" / f"{name}.g2o.gz").is_odometry.sum() == odometry


@needs_data
@pytest.mark.parametrize(("name", "vertices", "edges"), [("MIT", 808, 827), ("intel", 1728, 2512)])
def test_public_graphs_have_their_published_size(name, vertices, edges):
    graph = read_pose_graph(DATA / "posegraph" / f"{name}.g2o.gz")
    assert (len(graph.poses), len(graph.edges)) == (vertices, edges)
    assert np.all(np.linalg.eigvalsh(graph.information) > 0)
