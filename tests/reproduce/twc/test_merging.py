import numpy as np
import pytest

from twc_env.errors import ConfigError
from twc_env.maps import load_map
from twc_env.reproduce.twc import merging
from twc_env.reproduce.twc.merging import BYTES, THICKNESS, merge_in, overlapping_ways

SMALL = "test/0005"


def test_ways_start_apart_stay_on_the_floor_and_overlap():
    plan = load_map(SMALL)
    ways = overlapping_ways(plan, 3)
    starts = np.array([way[0] for way in ways])
    for k, way in enumerate(ways):
        assert plan.cells().is_free(way).all()
        others = np.concatenate([w for i, w in enumerate(ways) if i != k])
        assert min(np.hypot(*(others - p).T).min() for p in way) < 0.2
        assert np.hypot(*(np.delete(starts, k, axis=0) - starts[k]).T).min() >= 1.0


def test_one_building_is_merged_rightly():
    row = merge_in(SMALL, robots=3, seed=0)
    assert row["fully_merged"] == 1 and row["wrong_merges"] == 0
    assert 0 < row["first_merge_s"] <= row["all_merged_s"] and row["bytes_to_first_merge"] > 0
    assert row["team_ate_m"] < 0.1
    assert row["undone"] == 0
    assert sum(row[key] for key in BYTES[1:]) == row["bytes_to_first_merge"]
    assert row["wall_thickness_m"] < 1.3 * row["wall_thickness_true_m"]


def test_more_robots_than_rooms_are_refused():
    with pytest.raises(ConfigError, match="test/0000 has 7 rooms for 8 robots: choose fewer robots"):
        overlapping_ways(load_map("test/0000"), 8)


def test_the_table_ends_with_the_sum_over_buildings(rows_of, monkeypatch):
    found = {"test/0000": 1, "test/0001": 0}
    monkeypatch.setattr(
        merging,
        "merge_in",
        lambda name, robots, seed, settings: {
            "building": name, "rooms": 3, "steps": 10, "fully_merged": found[name], "wrong_merges": 0,
            "first_merge_s": None if name == "test/0001" else 4.0, "all_merged_s": None, "bytes_to_first_merge": 7,
            "team_ate_m": 0.1 + found[name], "team_ate_max_m": 0.1 + found[name],
            "undone": 0, **dict.fromkeys(BYTES[1:], 1), **dict.fromkeys(THICKNESS, 0.1),
        },
    )  # fmt: skip
    table = rows_of(merging, "--buildings", "2")
    assert [row["building"] for row in table] == ["test/0000", "test/0001", "all 2"]
    assert [row.get("buildings") for row in table] == [None, None, 2]
    assert table[-1]["fully_merged"] == 1 and table[-1]["first_merge_s"] == 4.0
    assert table[-1]["team_ate_m"] == pytest.approx(0.6) and table[-1]["team_ate_max_m"] == pytest.approx(1.1)
