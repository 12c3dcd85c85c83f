import pytest

from twc_env.config import EnvConfig, override
from twc_env.reproduce.twc import reality


@pytest.mark.parametrize("effect", [*reality.EFFECTS, reality.ALL, *reality.WORLDS])
def test_every_effect_changes_settings_and_only_clean_does_not(effect):
    changed = override(EnvConfig(), reality.settings_of(effect))
    assert (changed == EnvConfig()) == (effect == "clean")


def test_a_row_has_the_figures_of_its_effect(rows_of):
    words = ["--effects", "clean,people 12", "--buildings", "1", "--area", "150", "--steps", "120", "--robots", "2"]
    clean, people = rows_of(reality, *words)
    assert (clean["effect"], people["effect"]) == ("clean", "people 12")
    for row in (clean, people):
        assert 0.5 <= row["merged_share"] <= 1.0 and row["wrong_merges"] == row["wrong_teams"] == 0
        assert row["fully_merged"] in (0.0, 1.0) and row["stuck_worst"] == row["stuck_share"]
        assert 0.0 <= row["commanded_stuck_share"] == row["commanded_stuck_worst"] <= row["stuck_share"]
        assert 0.0 < row["ate_m"] < 0.2 and 0.3 < row["coverage_correct"] <= 1.0 and row["steps_per_s"] > 0
    assert clean["people_collisions"] == 0
