import gzip

import numpy as np
import pytest

from tests.soak.malformed.graph_fuzz import ring_graph
from twc_env.datasets.logs import pose_graph_file
from twc_env.datasets.logs.pose_graph_file import read_pose_graph, write_pose_graph
from twc_env.errors import DataError
from twc_env.slam.graph_optimisation.whole_graph import optimise_graph


def read(tmp_path, text, name="a.g2o"):
    path = tmp_path / name
    path.write_bytes(gzip.compress(text.encode()) if name.endswith(".gz") else text.encode())
    return read_pose_graph(path)


EDGE = "EDGE_SE2 {} {} 1 0 0 100 0 0 100 0 400\n"


@pytest.mark.parametrize("name", ["a.g2o", "a.g2o.gz", "a.graph"])
def test_a_file_is_read_packed_or_not(tmp_path, name):
    graph = read(tmp_path, ring_graph(), name)
    assert graph.poses.shape == (24, 3)
    assert graph.is_odometry.sum() == 23
    assert graph.remarks == ()


def test_toro_lines_have_their_own_order_of_the_information(tmp_path):
    (information,) = read(tmp_path, "EDGE2 0 1 1 0 0 1 2e-3 5 9 3e-3 4e-3\n").information
    assert information == pytest.approx(np.array([[1, 2e-3, 3e-3], [2e-3, 5, 4e-3], [3e-3, 4e-3, 9]]))


def test_a_flipped_edge_gives_the_same_solution(tmp_path):
    text = "".join(EDGE.format(k, k + 1) for k in range(4)) + "EDGE_SE2 {} {} {} 50 3 2 60 1 300\n"
    straight = read(tmp_path, text.format(0, 3, "2 1 0.5"))
    c, s = np.cos(0.5), np.sin(0.5)
    back = f"{-c * 2 - s * 1} {s * 2 - c * 1} -0.5"
    # the same information, of errors as twists in the frame of the other end
    way = np.array([[c, -s, 1], [s, c, -2], [0, 0, 1]])
    there = way.T.copy()
    there = np.linalg.inv(there) @ np.array([[50, 3, 2], [3, 60, 1], [2, 1, 300]]) @ np.linalg.inv(way)
    words = " ".join(str(v) for v in there[np.triu_indices(3)])
    text = "".join(EDGE.format(k, k + 1) for k in range(4))
    # turned round and back, it is as it was
    turned = read(tmp_path, text + f"EDGE_SE2 3 0 {back} {words}\n")
    assert turned.edges[-1].tolist() == [0, 3]
    assert turned.measured[-1] == pytest.approx([2, 1, 0.5])
    assert "1 edges lead from a higher to a lower id" in " ".join(turned.remarks)
    assert turned.information[-1] == pytest.approx(straight.information[-1], rel=1e-9)


def test_what_is_left_out_is_named(tmp_path):
    text = (
        ring_graph() + "EDGE_SE2 4 4 1 0 0 1 0 0 1 0 1\nPARAMS 1\nPARAMS 2\nVERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nFIX 77\n"
    )
    remarks = " ".join(read(tmp_path, text).remarks)
    assert "1 edges from a vertex to itself left out: 4" in remarks
    assert "2 lines of the kind 'PARAMS' left out" in remarks
    assert "'VERTEX_SE3:QUAT' (three dimensions) left out" in remarks
    assert "FIX names 77, which is neither a vertex nor a landmark with a place" in remarks


def test_vertices_without_a_line_are_named(tmp_path):
    graph = read(tmp_path, "VERTEX_SE2 7 0 0 0\n" + EDGE.format(7, 9))
    assert graph.vertex_ids.tolist() == [7, 9]
    assert np.isnan(graph.poses[1]).all()
    assert "1 vertices have no line" in " ".join(graph.remarks)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("VERTEX3 0 0 0 0 0 0 0\nEDGE3 0 1 0 0 0 0 0 0\n", "is a graph in three dimensions (VERTEX3, EDGE3)"),
        ("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n", "is a graph in three dimensions"),
        ("VERTEX_SE2 0 0 0 0\nEDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 1\n", "is a graph in three dimensions (EDGE_SE3:QUAT)"),
        ("\x01\x02 1 2\n", "it is a binary file"),
        ("", "it is empty"),
        ("hello world\n", "it holds hello"),
        ("VERTEX_SE2 0 0 0\n", "line 1: expected 4 finite numbers after VERTEX_SE2; got '0 0 0'"),
        ("VERTEX_SE2 0 0 0 nan\n", "line 1: expected 4 finite numbers"),
        ("VERTEX_SE2 a 0 0 0\n", "names a vertex 'a'; ids are whole numbers"),
        ("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 0 1 0 0\n", "line 2: vertex 0 stands elsewhere in a line before"),
        ("EDGE_SE2 0 1 1 0 0 1 0 0 -1 0 1\n", "line 1: the information is no inverse covariance"),
        ("EDGE_SE2 0 1 1e30 0 0 1 0 0 1 0 1\n", "values must be metres, radians and inverse covariances; got 1e+30"),
        (EDGE.format(0, 1) + "EDGE_SE2_XY 0 1 1 1 1 0 1\nEDGE_SE2_XY 0 5 1 1 1 0 -1\n", "line 3: the information"),
    ],
)
def test_what_cannot_be_read_is_one_line(tmp_path, text, message):
    with pytest.raises(DataError) as error:
        read(tmp_path, text)
    assert message in str(error.value)


def test_a_written_graph_is_read_again_without_the_rejected_edges(tmp_path):
    graph = read(tmp_path, ring_graph(first=100) + "FIX 103\nVERTEX_XY 7 1 1\nFIX 7\nEDGE_SE2_XY 103 7 1 1 9 0 9\n")
    result = optimise_graph(graph)
    write_pose_graph(tmp_path / "b.g2o", graph, result.poses, result.landmarks_m, result.accepted)
    again = read_pose_graph(tmp_path / "b.g2o")
    assert again.vertex_ids.tolist() == graph.vertex_ids.tolist()
    assert len(again.edges) == result.accepted.sum() == len(graph.edges) - 1
    assert again.held.tolist() == [3]
    assert again.held_landmarks.tolist() == [0]
    assert again.poses == pytest.approx(result.poses, abs=1e-9)
    assert again.landmarks_m == pytest.approx(result.landmarks_m, abs=1e-9)


def test_of_lines_of_very_many_kinds_the_first_are_named_and_the_others_counted(tmp_path):
    path = tmp_path / "a.g2o"
    path.write_text("".join(f"K{k}\n" for k in range(5000)) + "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n")
    remarks = read_pose_graph(path).remarks
    assert "1 line of the kind 'K0' left out" in remarks and "4980 lines of other kinds left out" in remarks
    assert len(remarks) < 25


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("ab", "more than 3 lines of unknown kinds; name a pose graph"),
        ("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1", "more than 3 lines of a kind; cut the graph into parts"),
    ],
)
def test_too_many_lines_are_refused_at_the_line(line, told, tmp_path, monkeypatch):
    monkeypatch.setattr(pose_graph_file, "LINES_MAX", 3)
    path = tmp_path / "a.g2o"
    path.write_text(f"{line}\n" * 9)
    with pytest.raises(DataError, match=f"line 4: {told}"):
        read_pose_graph(path)
