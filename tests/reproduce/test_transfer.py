"""The table of a trained policy with other numbers of robots, and in buildings of other kinds."""

import pytest

from tests.real_data import needs_data
from twc_env import tasks
from twc_env.maps import load_map
from twc_env.reproduce.learning import transfer


@pytest.fixture
def tiny(monkeypatch):
    """Episodes of a few seconds."""
    monkeypatch.setitem(tasks.TASKS, transfer.TASK, {**tasks.TASKS[transfer.TASK], "max_cycles": 40})
    monkeypatch.setattr(transfer, "STEPS", 60)


def test_a_row_is_the_lead_of_the_policy_over_a_team_in_the_same_buildings(rows_of, tiny):
    words = ["--kinds", "2 robots", "--buildings", "2", "--model", "minpos", "--agents", "random", "minpos"]
    random, same = rows_of(transfer, *words, "--jobs", "1")
    assert (random["kind"], random["team"], random["buildings"]) == ("2 robots", "random", 2)
    assert random["lead"] == pytest.approx(random["mean_coverage"] - random["mean_coverage_of_team"])
    assert random["lead_low"] <= random["lead"] <= random["lead_high"] and 0.0 < random["mean_coverage"] < 1.0
    assert same["lead"] == same["lead_low"] == same["lead_high"] == 0.0, "a team against itself"
    assert (random["wrong_merges"], random["wrong_merges_of_team"]) == (0, 0)


@needs_data
@pytest.mark.parametrize(("kind", "count"), [("flats", 20), ("floors", 3), ("ipa floors", 11)])
def test_real_buildings_are_played_by_three_robots_for_longer(kind, count, rows_of, tiny):
    maps = transfer.maps_of(kind)
    assert len(maps) == len(set(maps)) == count
    assert transfer.entry_of(kind, "random", 0).config.robots == 3
    assert transfer.entry_of(kind, "random", 0).config.max_cycles == transfer.STEPS > 40
    assert len(load_map(maps[-1]).walls_m) > 50
