import numpy as np

from twc_env.reproduce.twc import bare_places
from twc_env.world.building.floorplan_check import validate

BARE = "corridor 1.2 m"


def test_every_scene_is_a_sound_plan_with_the_signs_and_access_points_of_its_name():
    for name, scene in bare_places.SCENES.items():
        plan = validate(scene.plan())
        assert bool(plan.access_points) is ("without WiFi" not in name)
        assert bool(plan.signs) is ("words" in name or "numbers" in name or name == "hall")
        assert all(0.0 < x < plan.bounds_m[2] for x in np.array([sign.position_m[0] for sign in plan.signs]))


def test_robots_that_hear_one_access_point_along_a_bare_corridor_are_not_merged_by_that(rows_of):
    (row,) = rows_of(bare_places, "--scenes", BARE, "--seeds", "3-4", "--steps", "240")
    assert (row["scene"], row["episodes"]) == (BARE, 2)
    assert row["wrong_merges"] == row["wrong_episodes"] == row["undone"] == row["false_closures"] == 0
    assert row["merged_share"] == 0.333 and 0.0 < row["ate_m"] <= row["ate_worst_m"] < 0.5
