import argparse
import os
import sys

import pytest

from twc_env.errors import ConfigError
from twc_env.reproduce import solver
from twc_env.reproduce.runner import Runner

needs_data = pytest.mark.skipif(
    "TWC_DATA" not in os.environ, reason="real pose graphs lie in the folder TWC_DATA, which is not set"
)


def table(tmp_path, *words: str) -> list[dict]:
    parser = argparse.ArgumentParser()
    solver.add_arguments(parser)
    return solver.rows(parser.parse_args(words), Runner("solver", tmp_path, {"words": words}))


@needs_data
def test_both_solvers_find_one_optimum_and_ours_takes_at_most_twice_as_long(tmp_path):
    pytest.importorskip("gtsam", reason="gtsam is an extra of its own: pip install twc_env[crosscheck]")
    ours, theirs = table(tmp_path, "--datasets", "intel", "--repeats", "3")
    assert (ours["solver"], theirs["solver"]) == ("ours", "gtsam")
    assert ours["from_best_m"] < 0.005 and theirs["from_best_m"] < 0.005
    assert ours["squared_error"] == pytest.approx(theirs["squared_error"], rel=1e-3)
    assert ours["time_s"] < 2 * theirs["optimise_s"]


@needs_data
def test_without_gtsam_the_table_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "gtsam", None)
    with pytest.raises(ConfigError, match="pip install"):
        table(tmp_path, "--datasets", "MIT", "--repeats", "1")
