import argparse

from twc_env.reproduce import matching
from twc_env.reproduce.runner import Runner


def test_candidates_are_verified_with_a_guess_and_without(tmp_path):
    parser = argparse.ArgumentParser()
    matching.add_arguments(parser)
    options = parser.parse_args(["--buildings", "1", "--pairs", "2", "--points", "180"])
    table = matching.rows(options, Runner("matching", tmp_path, {}))
    assert [(row["task"], row["guess"]) for row in table] == [
        (task, guess) for task in ("match", "verify") for guess in ("with", "without")
    ]
    assert all(row["found"] == 1.0 and row["pairs"] == 2 and row["time_ms"] > 0 for row in table)
