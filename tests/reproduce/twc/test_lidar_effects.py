"""The table of what limits and errors of laser scanners cost."""

import pytest

from twc_env.config import EnvConfig, override
from twc_env.reproduce.twc import lidar_effects


@pytest.mark.parametrize("effect", lidar_effects.EFFECTS)
def test_every_effect_changes_the_scanner_and_only_none_does_not(effect):
    assert (override(EnvConfig(), lidar_effects.EFFECTS[effect]) == EnvConfig()) == (effect == "none")


def test_a_row_stands_beside_that_without_an_effect_in_the_same_building(rows_of):
    none, slow = rows_of(lidar_effects, "--effects", "5 Hz", "--buildings", "1", "--robots", "2")
    assert (none["effect"], slow["effect"], slow["buildings"]) == ("none", "5 Hz", 1)
    assert none["d_ate_m"] == none["sd_ate_m"] == slow["sd_ate_m"] == 0.0
    assert slow["d_ate_m"] == pytest.approx(slow["ate_m"] - none["ate_m"], abs=1e-4) and slow["ate_m"] != none["ate_m"]
    for row in (none, slow):
        assert row["fully_merged"] in (0, 1) and row["wrong_merges"] == 0
        assert 0.0 < row["ate_m"] == row["ate_max_m"] < 0.1 and 0.0 < row["wall_thickness_m"] < 0.5
