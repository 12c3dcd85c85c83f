import json

import pytest

from tests.soak import graph_fuzz
from tests.soak.__main__ import main
from tests.soak.graph_fuzz import fuzz_graphs


def test_mutated_graphs_are_rejected_in_one_line_or_optimised():
    report = fuzz_graphs(40, seed=3)
    assert report.escaped == []
    assert report.count == 40
    assert report.refused > 3
    assert report.optimised > 10


def test_the_fuzzer_detects_injected_faults(monkeypatch):
    def broken(graph, method):
        if len(graph.poses):
            raise ValueError("bad")

    monkeypatch.setattr(graph_fuzz, "METHODS", ("none",))
    kept = graph_fuzz.optimise_graph
    calls = []

    def first_is_right(graph, method):
        calls.append(1)
        return kept(graph, method) if len(calls) == 1 else broken(graph, method)

    monkeypatch.setattr(graph_fuzz, "optimise_graph", first_is_right)
    report = fuzz_graphs(10)
    assert report.escaped
    assert report.optimised == 0


def test_the_command_counts_mutated_graphs(tmp_path, capsys):
    assert main(["--graphs", "5", "--json", str(tmp_path / "a.json")]) == 0
    assert json.loads((tmp_path / "a.json").read_text())["graphs"]["count"] == 5
    assert "5 mutated pose graphs" in capsys.readouterr().out


@pytest.mark.parametrize("line", graph_fuzz._ODD_LINES)
def test_each_odd_line_is_named_or_used(line, tmp_path):
    path = tmp_path / "a.g2o"
    path.write_text(graph_fuzz.ring_graph() + line + "\n")
    report = graph_fuzz.GraphFuzzReport()
    graph_fuzz._try(path, "none", line, report)
    assert report.escaped == []
