import argparse

import pytest

from twc_env.reproduce import twc_table1
from twc_env.reproduce.runner import Runner, plain


def options(**changes):
    parser = argparse.ArgumentParser()
    twc_table1.add_arguments(parser)
    values = parser.parse_args([])
    for key, value in ({"seeds": [50], "scenes": ["#01"]} | changes).items():
        setattr(values, key, value)
    return values


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    rows = twc_table1.rows(options(), Runner("table", tmp_path_factory.mktemp("cache"), {}))
    return {(r["method"], *(v for v in (r["alpha"], r["gamma"]) if v is not None)): r for r in rows}


def test_every_cell_of_the_print_has_its_row_and_fused_has_one(table):
    printed = [("text", a) for a in (0.5, 0.8, 1.0)] + [("wifi", g) for g in (0.5, 0.8, 1.0)]
    assert set(table) == {*printed, ("twc", 0.5, 0.8), ("twc", 0.8, 0.8), ("twc", 0.5, 1.0), ("lidar",), ("fused",)}
    assert table["twc", 0.8, 0.8]["paper_precision"] == 95 and table["twc", 0.8, 0.8]["paper_recall"] == 90


def test_stricter_thresholds_never_find_more(table):
    for method in ("text", "wifi"):
        recalls = [table[method, value]["recall_absolute"] for value in (0.5, 0.8, 1.0)]
        assert recalls == sorted(recalls, reverse=True)


def test_on_one_denominator_two_cues_find_no_more_than_one(table):
    for alpha, both in ((0.5, 0.8), (0.8, 0.8), (0.5, 1.0)):
        row = table["twc", alpha, both]
        assert row["recall_absolute"] <= min(
            table["text", alpha]["recall_absolute"], table["wifi", both]["recall_absolute"]
        )
        assert row["recall_conditional"] >= row["recall_absolute"]


def test_fused_beats_the_hard_rule(table):
    fused, hard = table["fused",], table["twc", 0.8, 0.8]
    assert fused["precision"] >= 99.0 and fused["recall_absolute"] >= 90.0
    assert fused["recall_absolute"] > hard["recall_absolute"]
    assert fused["average_precision"] > max(hard["average_precision"], table["wifi", 0.8]["average_precision"])


def test_remarks_measure_the_distance_to_the_print(table):
    lines = twc_table1.remarks(plain(list(table.values())))
    assert any(line.startswith("twc against the print: mean absolute error") for line in lines)


def test_the_printed_rules_can_be_chosen():
    literal = twc_table1.judge_scene("#01", 51, options(std_mode="paper", rssi_mode="paper"))
    rows = {(f["method"], f["gamma"]): f for f in literal if f["method"] == "wifi"}
    # A distance of at least gamma dB is met by nearly all pairs: what is left is the ratio of shared transmitters.
    assert rows["wifi", 0.5]["recall_absolute"] > 0.99 and rows["wifi", 0.5]["precision"] < 0.3
