"""Rows of trained models beside the teams of a benchmark."""

import math

import pytest

from twc_env.config import EnvConfig, override
from twc_env.suite.entries import Entry
from twc_env.suite.gaps import rows_of_models


def played(team, number, share, wrong=0):
    entry = Entry("twc/Tiny-v1", override(EnvConfig(), {"max_cycles": 20}), team, number)
    values = {"period_s": 1.0, "coverage": [share, share], "wrong_merges": wrong}
    return entry, values


def rows(shares, buildings=3):
    pairs = [played(team, k, share + 0.01 * k, k) for team, share in shares.items() for k in range(buildings)]
    return rows_of_models(["runs/mine"], *(list(each) for each in zip(*pairs, strict=True)))


def test_the_gap_is_that_between_the_best_scripted_team_and_the_informed_one():
    shares = {"runs/mine": 0.6, "minpos": 0.5, "random": 0.1, "information-gain": 0.4, "informed": 0.9}
    (row,) = rows(shares)
    assert row["task"] == "twc/Tiny-v1" and row["best_scripted"] == "minpos" and row["seed"] is None
    assert (row["gap_closed"], row["lead"]) == (pytest.approx(0.25), pytest.approx(0.1))
    assert (row["gap_low"], row["gap_high"]) == (pytest.approx(0.25), pytest.approx(0.25)), "paired by building"
    assert row["score"] == pytest.approx(0.5 / 0.8, abs=0.02)
    assert (row["wrong_merges"], row["wrong_merges_of_best"]) == (3, 3)
    assert row["low"] < row["score"] < row["high"]
    assert set(row["mean_coverage"]) == {"model", *shares} - {"runs/mine"}
    assert row["mean_coverage"]["model"] - row["mean_coverage"]["minpos"] == pytest.approx(row["lead"])


def test_there_is_no_gap_where_the_informed_team_is_not_ahead():
    (row,) = rows({"runs/mine": 0.6, "minpos": 0.9, "random": 0.1, "informed": 0.9})
    assert math.isnan(row["gap_closed"]) and math.isnan(row["gap_low"]) and row["lead"] == pytest.approx(-0.3)


def test_a_team_that_loses_closes_less_than_nothing():
    (row,) = rows({"runs/mine": 0.4, "minpos": 0.5, "random": 0.1, "informed": 0.9})
    assert row["gap_closed"] == pytest.approx(-0.25) and row["lead_high"] < 0.0
