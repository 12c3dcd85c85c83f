from collections import Counter

import numpy as np
import pytest

import twc_env
from twc_env.config import BuildingConfig
from twc_env.world.thinning import thinned

PLAN = twc_env.load_map("twin-02")


def test_the_default_config_changes_nothing():
    assert thinned(PLAN, BuildingConfig()) is PLAN


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_shares_of_signs_and_access_points_remain(share):
    plan = thinned(PLAN, BuildingConfig(sign_share=share, access_point_share=share))
    assert len(plan.signs) == round(share * len(PLAN.signs))
    assert len(plan.access_points) == round(share * len(PLAN.access_points))
    assert {s.text for s in plan.signs} <= {s.text for s in PLAN.signs}
    assert np.array_equal(plan.walls_m, PLAN.walls_m)


def test_duplication_gives_many_signs_one_text_and_moves_none():
    plan = thinned(PLAN, BuildingConfig(sign_duplication=1.0))
    counts = Counter(s.text for s in plan.signs)
    assert min(counts.values()) >= 3
    assert len(counts) < 0.4 * len({s.text for s in PLAN.signs})
    for sign, old in zip(plan.signs, PLAN.signs, strict=True):
        assert np.array_equal(sign.position_m, old.position_m)


def test_thinning_depends_on_the_plan_only():
    config = BuildingConfig(sign_share=0.6, sign_duplication=0.5, access_point_share=0.5)
    first, again = thinned(PLAN, config), thinned(PLAN, config)
    moved = thinned(PLAN.moved(np.array([30.0, -4.0, 1.0])), config)
    assert first.digest == again.digest == moved.digest
    assert [s.text for s in first.signs] == [s.text for s in moved.signs]


def test_the_environment_uses_the_thinned_building():
    env = twc_env.parallel_env(map="twin-02", config={"building.sign_share": 0.5, "building.access_point_share": 0.0})
    observations, _ = env.reset(seed=0)
    assert len(env.floorplan.signs) == round(0.5 * len(PLAN.signs))
    assert not observations["robot_0"]["wifi"].any()
