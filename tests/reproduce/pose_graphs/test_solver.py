import sys

import pytest

from tests.real_data import needs_data
from twc_env.errors import ConfigError
from twc_env.reproduce.pose_graphs import solver


@needs_data
def test_both_solvers_find_one_optimum_and_ours_takes_at_most_twice_as_long(rows_of):
    pytest.importorskip("gtsam", reason="gtsam is an extra of its own: pip install 'twc_env[crosscheck]'")
    ours, theirs = rows_of(solver, "--datasets", "intel", "--starts", "odometry", "--repeats", "3")
    assert (ours["solver"], theirs["solver"]) == ("ours", "gtsam")
    assert ours["from_best_m"] < 0.005 and theirs["from_best_m"] < 0.005
    assert ours["squared_error"] == pytest.approx(theirs["squared_error"], rel=1e-3)
    assert ours["time_s"] < 2 * theirs["optimise_s"]


@needs_data
def test_the_whole_of_optimise_is_compared_on_every_published_graph(rows_of, monkeypatch):
    monkeypatch.setattr(solver, "solve_gtsam", lambda start, graph: (solver.solve_ours(start, graph)[0], 0.2, 0.1))
    rows = rows_of(solver, "--starts", "published", "--repeats", "1")
    assert {row["dataset"] for row in rows} >= {"intel", "MIT", "manhattan", "ring", "ringCity"}
    for none, ours, theirs in zip(rows[::3], rows[1::3], rows[2::3], strict=True):
        assert [row["solver"] for row in (none, ours, theirs)] == ["optimise none", "optimise ours", "gtsam"]
        assert none["of_gtsam"] == pytest.approx(none["time_s"] / 0.2) and theirs["of_gtsam"] == 1.0
        assert none["squared_error"] == pytest.approx(theirs["squared_error"], rel=1e-2) or none["dataset"] == "MIT"


@needs_data
def test_without_gtsam_the_table_says_what_to_install(rows_of, monkeypatch):
    monkeypatch.setitem(sys.modules, "gtsam", None)
    with pytest.raises(ConfigError, match="pip install"):
        rows_of(solver, "--datasets", "MIT", "--starts", "odometry", "--repeats", "1")
