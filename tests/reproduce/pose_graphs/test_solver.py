import sys

import pytest

from tests.real_data import needs_data
from twc_env.errors import ConfigError
from twc_env.reproduce.pose_graphs import solver


@needs_data
def test_both_solvers_find_one_optimum_and_ours_takes_at_most_twice_as_long(rows_of):
    pytest.importorskip("gtsam", reason="gtsam is an extra of its own: pip install 'twc_env[crosscheck]'")
    ours, theirs = rows_of(solver, "--datasets", "intel", "--repeats", "3")
    assert (ours["solver"], theirs["solver"]) == ("ours", "gtsam")
    assert ours["from_best_m"] < 0.005 and theirs["from_best_m"] < 0.005
    assert ours["squared_error"] == pytest.approx(theirs["squared_error"], rel=1e-3)
    assert ours["time_s"] < 2 * theirs["optimise_s"]


@needs_data
def test_without_gtsam_the_table_says_what_to_install(rows_of, monkeypatch):
    monkeypatch.setitem(sys.modules, "gtsam", None)
    with pytest.raises(ConfigError, match="pip install"):
        rows_of(solver, "--datasets", "MIT", "--repeats", "1")
