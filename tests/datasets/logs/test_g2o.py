"""Pose graphs survive the g2o format, and public ones can be read."""

import numpy as np
import pytest

from tests.real_data import DATA, needs_data
from twc_env.datasets.logs.g2o import read_g2o, write_g2o
from twc_env.errors import DataError


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
    read = read_g2o(tmp_path / name)
    assert all(np.allclose(read[key], graph[key], atol=1e-6) for key in graph)
    assert read["edges_kind"] == ["odometry", "odometry", "odometry", "closure"]


def test_a_graph_in_map_coordinates_keeps_its_micrometres(tmp_path):
    nodes = np.array([[500000.123456, 5412345.654321, 1.0], [500001.5, 5412346.234567, -3.1]])
    graph = {"nodes": nodes, "edges_ij": [[0, 1]], "edges_z": nodes[1:], "edges_information": [np.eye(3)]}
    write_g2o(tmp_path / "graph.g2o", graph)
    again = read_g2o(tmp_path / "graph.g2o")
    assert np.abs(again["nodes"] - nodes).max() < 1e-7
    assert np.abs(again["edges_z"] - nodes[1:]).max() < 1e-7


def test_two_graphs_in_one_file_do_not_overwrite_each_other(tmp_path):
    (tmp_path / "two.g2o").write_text("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nVERTEX_SE2 0 5 5 0\n")
    with pytest.raises(DataError, match=r"two.g2o, line 3: vertex 0 stands elsewhere in a line before"):
        read_g2o(tmp_path / "two.g2o")


def test_the_information_matrix_is_written_as_its_upper_triangle(tmp_path):
    graph = {
        "nodes": np.zeros((2, 3)),
        "edges_ij": [[0, 1]],
        "edges_z": [[1, 2, 3]],
        "edges_information": [[[11, 12, 13], [12, 22, 23], [13, 23, 33]]],
    }
    write_g2o(tmp_path / "a.g2o", graph)
    assert "EDGE_SE2 0 1 1 2 3 11 12 13 22 23 33" in (tmp_path / "a.g2o").read_text()


def test_vertex_numbers_may_have_gaps(tmp_path):
    (tmp_path / "a.g2o").write_text("VERTEX_SE2 7 0 0 0\nVERTEX_SE2 3 1 0 0\nEDGE_SE2 7 3 1 0 0 1 0 0 1 0 1\n")
    graph = read_g2o(tmp_path / "a.g2o")
    assert graph["vertex_ids"].tolist() == [7, 3]
    assert graph["edges_ij"].tolist() == [[0, 1]]


def test_nodes_of_a_file_of_edges_alone_lie_along_the_odometry(tmp_path):
    lines = ["0 2 9 9 0", "1 0 -1 0 0", "1 2 1 0 1.5707963267948966", "7 2 -3 0 0"]
    (tmp_path / "a.g2o").write_text("\n".join(f"EDGE_SE2 {line} 1 0 0 1 0 1" for line in lines))
    graph = read_g2o(tmp_path / "a.g2o")
    assert graph["vertex_ids"].tolist() == [0, 1, 2, 7]
    quarter = np.pi / 2
    assert np.allclose(graph["nodes"], [[0, 0, 0], [1, 0, 0], [2, 0, quarter], [2, 3, quarter]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2 5 6 1 0 0 1 0 0 1 0 1\n", "no edges lead from vertex 0 to 5"),
        ("VERTEX_SE2 0 0 0\n", "line 1: expected 4 finite numbers"),
        ("VERTEX_SE2 99999999999999999999 0 0 0\n", "line 1: expected"),
        ("VERTEX_SE2 0 0 0 inf\n", "line 1: expected 4 finite numbers"),
        ("VERTEX_SE2 0 0 0 0\nEDGE_SE2 0 9 1 0 0 1 0 0 1 0 1\n", "line 2: the edge names vertex 9"),
        ("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n", "holds VERTEX_SE3:QUAT"),
        ("", "it is empty"),
    ],
)
def test_a_malformed_file_is_refused_with_the_reason(tmp_path, text, message):
    (tmp_path / "a.g2o").write_text(text)
    with pytest.raises(DataError, match=message):
        read_g2o(tmp_path / "a.g2o")


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


@needs_data
@pytest.mark.parametrize(("name", "vertices", "edges"), [("MIT", 808, 827), ("intel", 1728, 2512)])
def test_public_graphs_have_their_published_size(name, vertices, edges):
    graph = read_g2o(DATA / "posegraph" / f"{name}.g2o.gz")
    assert (len(graph["nodes"]), len(graph["edges_ij"])) == (vertices, edges)
    assert np.all(np.linalg.eigvalsh(graph["edges_information"]) > 0)
