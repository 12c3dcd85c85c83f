import csv
import json

import pytest

from tests.soak.malformed.graph_fuzz import ring_graph
from twc_env.__main__ import main
from twc_env.datasets.logs.pose_graph_file import read_pose_graph
from twc_env.datasets.logs.tum import read_tum
from twc_env.exploration.drawing import palette
from twc_env.pictures.graph_picture import graph_figure
from twc_env.pictures.style import style
from twc_env.slam.graph_optimisation.whole_graph import optimise_graph


@pytest.fixture
def ring(tmp_path):
    path = tmp_path / "ring.g2o"
    path.write_text(ring_graph(first=40) + "EDGE_SE2 44 44 1 0 0 1 0 0 1 0 1\n")
    return path


def test_a_graph_is_optimised_and_everything_written(ring, tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="matplotlib is an optional dependency")
    assert main(["optimise", str(ring), "--out", str(tmp_path / "o"), "--json", str(tmp_path / "a.json")]) == 0
    out = capsys.readouterr().out
    assert "note: 1 edges from a vertex to itself left out: 44" in out
    assert "sound" in out and "LOST" not in out
    times, poses = read_tum(tmp_path / "o" / "poses.tum")
    assert times[0] == 40 and len(poses) == 24
    rows = list(csv.DictReader((tmp_path / "o" / "closures.csv").read_text().splitlines()))
    assert [row["accepted"] for row in rows] == 8 * ["True"] + ["False"]
    assert rows[-1]["reason"] and float(rows[-1]["chi_squared"]) > 100
    assert rows[-1]["disagrees_with"]
    assert (tmp_path / "o" / "graph.png").stat().st_size > 10_000
    found = json.loads((tmp_path / "a.json").read_text())
    assert not found["is_lost"] and len(found["rejected"]) == 1


def test_ids_with_more_digits_than_times_are_numbered_anew_in_the_trajectory(tmp_path, capsys):
    path = tmp_path / "symbols.g2o"
    path.write_text(ring_graph(first=ord("a") << 56))
    assert main(["optimise", str(path), "--out", str(tmp_path / "o")]) == 0
    assert "poses.tum counts the poses from 0" in capsys.readouterr().out
    times, _ = read_tum(tmp_path / "o" / "poses.tum")
    assert times.tolist() == list(range(24))
    assert f"VERTEX_SE2 {(ord('a') << 56) + 23} " in (tmp_path / "o" / "graph.g2o").read_text()


def test_two_robots_joined_by_a_closure_alone_are_unchecked_and_the_closure_is_named(tmp_path, capsys):
    path = tmp_path / "two.g2o"
    one, other = (ring_graph(first=first).splitlines()[:-1] for first in (0, 500))  # without the false closures
    path.write_text("\n".join([*one, *other]) + "\nEDGE_SE2 5 503 40 7 1 100 0 0 100 0 400\n")
    assert main(["optimise", str(path)]) == 0
    out = capsys.readouterr().out
    assert "the part behind closure 5-503 hangs on it alone, nothing checks it: 24 of 48 poses" in out
    assert "unchecked" in out and "sound" not in out


def test_poses_that_no_accepted_closure_joins_to_the_others_are_counted(tmp_path, capsys):
    path = tmp_path / "two.g2o"
    path.write_text(ring_graph() + ring_graph(first=500) + "EDGE_SE2 5 503 40 7 1 100 0 0 100 0 400\n")
    assert main(["optimise", str(path)]) == 0
    out = capsys.readouterr().out
    assert "component 0: nothing accepted joins 24 of 48 poses to the others" in out and "unchecked" in out


def test_observations_that_contradict_the_rest_are_counted_and_listed(tmp_path, capsys):
    path = tmp_path / "a.g2o"
    path.write_text(
        "EDGE_SE2 0 1 1 0 0 100 0 0 100 0 400\nEDGE_SE2 1 2 1 0 0 100 0 0 100 0 400\n"
        "EDGE_SE2_XY 0 8 1 1 100 0 100\nEDGE_SE2_XY 1 8 0 1 100 0 100\nEDGE_SE2_XY 2 8 -1 1 100 0 100\n"
        "EDGE_SE2_XY 0 9 1 -1 100 0 100\nEDGE_SE2_XY 1 9 0 -1 100 0 100\nEDGE_SE2_XY 2 9 9 5 100 0 100\n"
    )
    main(["optimise", str(path), "--out", str(tmp_path / "o"), "--json", str(tmp_path / "a.json")])
    assert (
        "1 of 6 observations of landmarks contradict the rest (chi squared above 9.21): of 9" in capsys.readouterr().out
    )
    rows = list(csv.DictReader((tmp_path / "o" / "landmark_observations.csv").read_text().splitlines()))
    assert [row["contradicts"] for row in rows] == 5 * ["False"] + ["True"]
    listed = json.loads((tmp_path / "a.json").read_text())["contradicting landmark observations"]
    assert [(row["vertex"], row["landmark"]) for row in listed] == [(2, 9)]


def test_the_picture_of_a_graph_has_the_palette_and_a_title_apart_from_its_axes(ring):
    pytest.importorskip("matplotlib", reason="matplotlib is an optional dependency")
    graph = read_pose_graph(ring)
    with style():
        figure = graph_figure(graph, optimise_graph(graph, "ours"))
        title, renderer = figure._suptitle, figure.canvas.get_renderer()
        assert title.get_text() == "24 poses, 8 of 9 closures accepted"
        assert not any(title.get_window_extent().overlaps(axes.get_tightbbox(renderer)) for axes in figure.axes)
    names = {text.get_text(): line.get_color() for text, line in zip(
        figure.legends[0].get_texts(), figure.legends[0].get_lines(), strict=True)}  # fmt: skip
    assert names["accepted closures (8)"] == palette.CLOSURE != names["rejected closures (1)"]


def test_vertices_without_an_edge_are_nothing_to_optimise(tmp_path, refusal):
    path = tmp_path / "a.g2o"
    path.write_text("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\n")
    assert "has 2 vertices and no edge (EDGE_SE2)" in refusal(main, ["optimise", str(path)])


def test_a_lost_graph_ends_with_one_and_says_why(ring, capsys):
    assert main(["optimise", str(ring), "--robust", "none"]) == 1
    assert "LOST, component 0: what is accepted contradicts itself" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["missing.g2o"], "cannot read missing.g2o"),
        (["missing.g2o", "--robust", "our"], "unknown method 'our' for --robust; choose from ours, dcs"),
    ],
)
def test_bad_input_is_one_line(arguments, message, capsys):
    assert main(["optimise", *arguments]) == 2
    error = capsys.readouterr().err.strip()
    assert message in error and "\n" not in error
