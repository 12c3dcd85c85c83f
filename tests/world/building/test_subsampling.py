import pickle
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

import twc_env
from twc_env.config import BuildingConfig, EnvConfig, RadioConfig, override
from twc_env.world.building.subsampling import subsampled
from twc_env.world.sensors.radio import RadioModel

PLAN = twc_env.load_map("twin-02")
RADIO = override(
    EnvConfig(), {
        "radio.access_point_spread_db": 4.0, "radio.power_spread_db": 3.0, "radio.bssids_per_access_point": 5,
        "radio.high_band.share": 0.5, "radio.sweep_duration_s": 2.0, "radio.cells.count": 5,
    },
).radio  # fmt: skip
"""Radio with every random property of a building."""
PLACES = PLAN.starts[:, :2]


def closely_numbered():
    """The plan with addresses of which some are virtual addresses of others."""
    step = 1 << 40
    macs = [(5 + 3 * step,), (5,), (5 + 2 * step, 7), (6,)]
    points = [replace(a, macs=macs[i] if i < 4 else a.macs) for i, a in enumerate(PLAN.access_points)]
    return replace(PLAN, access_points=tuple(points))


def test_the_default_config_changes_nothing():
    assert subsampled(PLAN, BuildingConfig()) is PLAN


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_shares_of_signs_and_access_points_remain(share):
    plan = subsampled(PLAN, BuildingConfig(sign_share=share, access_point_share=share))
    assert len(plan.signs) == round(share * len(PLAN.signs))
    assert len(plan.access_points) == round(share * len(PLAN.access_points))
    assert {s.text for s in plan.signs} <= {s.text for s in PLAN.signs}
    assert np.array_equal(plan.walls_m, PLAN.walls_m)


def test_duplication_gives_many_signs_one_text_and_moves_none():
    plan = subsampled(PLAN, BuildingConfig(sign_duplication=1.0))
    counts = Counter(s.text for s in plan.signs)
    assert min(counts.values()) >= 3
    assert len(counts) < 0.4 * len({s.text for s in PLAN.signs})
    for sign, old in zip(plan.signs, PLAN.signs, strict=True):
        assert np.array_equal(sign.position_m, old.position_m)


def test_glass_is_among_the_walls_with_floor_on_both_sides():
    plan = subsampled(PLAN, BuildingConfig(glass_share=0.5))
    glass = np.array([name == "glass" for name in plan.wall_materials])
    everywhere = np.array(
        [name == "glass" for name in subsampled(PLAN, BuildingConfig(glass_share=1.0)).wall_materials]
    )
    outline = ((PLAN.walls_m == PLAN.bounds_m[:2]) | (PLAN.walls_m == PLAN.bounds_m[2:])).all(axis=1).any(axis=1)
    assert not everywhere[outline].any() and everywhere.sum() > 10
    assert 0.3 < glass.sum() / everywhere.sum() < 0.7 and not glass[~everywhere].any()
    assert np.array_equal(plan.wall_loss_db, PLAN.wall_loss_db) and plan.origin == PLAN.origin


def test_materials_that_the_plan_names_stay():
    named = replace(PLAN, wall_materials=("brick",) * len(PLAN.walls_m))
    assert set(subsampled(named, BuildingConfig(glass_share=1.0)).wall_materials) == {"brick"}


def test_beams_pass_partitions_of_glass():
    def free(share):
        settings = {"map": "twin-02", "building.glass_share": share, "lidar.glass_return_probability": 0.0}
        env = twc_env.parallel_env(config={"robots": 1, "slam.mode": "off", **settings})
        seen, _ = env.reset(seed=0, options={"starts": "map"})
        env.close()
        return seen["robot_0"]["lidar"].mean()

    assert free(1.0) > free(0.0) + 0.05


def test_subsampling_depends_on_the_plan_only():
    config = BuildingConfig(sign_share=0.6, sign_duplication=0.5, access_point_share=0.5, glass_share=0.4)
    first, again = subsampled(PLAN, config), subsampled(PLAN, config)
    moved = subsampled(PLAN.moved(np.array([30.0, -4.0, 1.0])), config)
    assert first.digest == again.digest == moved.digest
    assert [s.text for s in first.signs] == [s.text for s in moved.signs]


@pytest.mark.parametrize("dial", ["sign_share", "sign_duplication"])
def test_dials_of_signs_change_nothing_of_the_radio(dial):
    plan = subsampled(PLAN, BuildingConfig(**{dial: 0.5}))
    assert plan.digest != PLAN.digest and plan.origin == PLAN.origin
    whole, left = RadioModel(RADIO, PLAN), RadioModel(RADIO, plan)
    assert np.array_equal(left.macs, whole.macs) and np.array_equal(left.sweep_place, whole.sweep_place)
    for place in PLACES:
        assert np.array_equal(left.mean_rssi_dbm(place), whole.mean_rssi_dbm(place))


@pytest.mark.parametrize("wifi", [True, False])
@pytest.mark.parametrize("pose", [[0.0, 0.0, 0.0], [30.0, -4.0, 1.0]])
@pytest.mark.parametrize("share", [0.0, 0.2, 0.5, 0.9])
def test_access_points_that_stay_and_cells_keep_their_properties(share, pose, wifi):
    radio, plan = replace(RADIO, wifi=wifi), closely_numbered()
    whole = RadioModel(radio, plan)
    kept = subsampled(plan.moved(np.array(pose)), BuildingConfig(access_point_share=share))
    left = RadioModel(radio, kept.home)
    at = np.searchsorted(whole.macs, left.macs)
    assert np.array_equal(whole.macs[at], left.macs), "other addresses"
    assert len(left.macs) == 5 * len(kept.access_points) * wifi + 5
    assert np.array_equal(left.band_of, whole.band_of[at])
    assert np.array_equal(left.sweep_place, whole.sweep_place[at])
    for place in PLACES:
        assert left.mean_rssi_dbm(place) == pytest.approx(whole.mean_rssi_dbm(place)[at], abs=1e-9)


def test_what_is_left_knows_its_origin_wherever_it_goes():
    plan = subsampled(PLAN, BuildingConfig(access_point_share=0.5))
    moved = plan.moved(np.array([3.0, 4.0, 1.0]))
    for each in (
        plan,
        moved,
        moved.home,
        pickle.loads(pickle.dumps(moved)),
        subsampled(plan, BuildingConfig(sign_share=0)),
    ):
        assert each.origin == PLAN.origin
    assert PLAN.origin.digest == PLAN.digest


def test_a_subsampled_building_with_other_access_points_is_one_of_its_own():
    plan = subsampled(PLAN, BuildingConfig(access_point_share=0.5))
    other = replace(plan, access_points=(replace(plan.access_points[0], macs=(1, 2)), *plan.access_points[1:]))
    assert other.origin.digest == other.digest
    assert RadioModel(RadioConfig(), other).macs[:2].tolist() == [1, 2]


def test_robots_hear_the_same_where_signs_are_missing():
    scans = []
    for share in (1.0, 0.5):
        env = twc_env.parallel_env(map="twin-02", robots=2, config={"building.sign_share": share})
        env.reset(seed=0)
        scans.append([])
        for _ in range(20):
            env.step({agent: np.array([0.5, 0.2]) for agent in env.agents})
            scans[-1] += [(f.wifi.macs.tolist(), f.wifi.rssi_dbm.tolist()) for f in env.frames if f.wifi is not None]
    assert scans[0] == scans[1] and len(scans[0]) > 4


def test_the_environment_uses_the_subsampled_building():
    env = twc_env.parallel_env(map="twin-02", config={"building.sign_share": 0.5, "building.access_point_share": 0.0})
    observations, _ = env.reset(seed=0)
    assert len(env.floorplan.signs) == round(0.5 * len(PLAN.signs))
    assert not observations["robot_0"]["wifi"].any()
