"""The table of ambiguous buildings: what is built, and how teams are counted."""

import numpy as np
import pytest

from twc_env.reproduce.twc import ambiguity
from twc_env.reproduce.twc.alike_wings import alike_wings
from twc_env.world.building.floorplan_check import validate


@pytest.mark.parametrize("kind", ambiguity.KINDS)
def test_every_kind_has_other_buildings_in_each_split(kind):
    names = set()
    for split in ambiguity.SEEDS:
        for number in (0, 1, 100):  # more than the 100 of a split
            config, plan = ambiguity.building(kind, split, number)
            names.add(config.map if plan is None else plan.walls_m.tobytes())
    assert len(names) > 3


@pytest.mark.parametrize("has_wifi", [False, True])
def test_all_wings_are_the_same_but_for_their_access_points(has_wifi):
    plan = alike_wings(7, has_wifi)
    validate(plan)
    wings, rooms = (int(word) for word in plan.name.split() if word.isdecimal())
    length_m = np.ptp(plan.walls_m[..., 0]) / wings
    signs = sorted((round(float(s.position_m[0]), 3), float(s.position_m[1]), s.text) for s in plan.signs)
    first = signs[:rooms]
    for wing in range(wings):
        own = signs[wing * rooms : (wing + 1) * rooms]
        assert [(y, text) for _, y, text in own] == [(y, text) for _, y, text in first]
        assert np.allclose([x - wing * length_m for x, *_ in own], [x for x, *_ in first], atol=2e-3)
    assert len({mac for point in plan.access_points for mac in point.macs}) == (wings if has_wifi else 0)


def test_a_team_is_right_wrong_or_abstains():
    def run(merged, pairs, now=0):
        return {
            "robots": 3, "merged": merged, "wrong_pairs": pairs, "wrong_pairs_at_end": now, "undone": 0, "ate_m": 0.1,
        }  # fmt: skip

    row = ambiguity._row("bare", [run(3, 0), run(3, 2), run(3, 1, 1), run(2, 0), run(1, 0)])
    assert (row["right"], row["wrong"], row["abstained"], row["teams"]) == (1, 2, 2, 5)
    assert (row["wrong_at_end"], row["wrong_pairs"], row["merged_share"]) == (1, 3, 0.8)


def test_a_team_plays_to_its_last_step(monkeypatch):
    monkeypatch.setitem(ambiguity.SETTINGS, "wings", {"max_cycles": 30})
    found = ambiguity.episode("validation", "nearest-frontier", "wings", 0)
    assert found["robots"] == 3 and found["wrong_pairs"] == 0 and 1 <= found["merged"] <= 3
