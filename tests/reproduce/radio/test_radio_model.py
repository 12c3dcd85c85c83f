import dataclasses

import numpy as np
import pytest

from tests.real_data import DATA, needs_data
from twc_env.config import HighBandConfig, RadioConfig
from twc_env.datasets.surveys.fingerprints import RadioSurvey
from twc_env.errors import DataError
from twc_env.reproduce import radio_places as places
from twc_env.reproduce.radio import radio_likeness, radio_papers
from twc_env.reproduce.radio.radio_hearing import device_hearing, hearing, missed_by_sweeps, missed_share
from twc_env.reproduce.radio.radio_model import STUDIES, notes
from twc_env.reproduce.radio.radio_rooms import surveyed_rooms
from twc_env.reproduce.radio.radio_study import spread_over
from twc_env.world.building.floor_cells import Cells

CLEAR = RadioConfig(
    shadowing_std_db=0.0, fading_std_db=0.0, device_offset_std_db=0.0, noise_std_db=0.0, power_spread_db=0.0,
    detection_floor_dbm=-119.0,
)  # fmt: skip


def empty_survey(points: int = 30) -> RadioSurvey:
    zeros = np.zeros(points, int)
    position = np.column_stack([np.linspace(1, 39, points), np.full(points, 8.0)])
    return RadioSurvey(
        "hall", position, zeros, 2.0 * np.arange(points), zeros, ("a", "b", "c"), np.full((points, 3), np.nan),
        transmitter_m=np.array([[5.0, 8.0], [5.0, 8.0], [30.0, 3.0]]), transmitter_floor=np.array([1, 1, 2]),
        is_high_band=np.array([False, True, False]),
    )  # fmt: skip


def test_an_office_has_rooms_on_both_sides_of_its_corridor():
    for bounds in ([0, 0, 42.0, 16.4], [0, 0, 16.4, 42.0]):
        plan = places.office("office", bounds)
        assert plan.bounds_m.tolist() == [0, 0, *bounds[2:]]
        middle, room = plan.bounds_m[2:] / 2, np.array([3.0, 3.0])
        assert plan.wall_index.crossing(middle, room[None])[0][0] >= 1


def test_a_surveyed_corridor_is_open_and_what_lies_beside_it_is_walled_off():
    across = np.stack(np.meshgrid(np.arange(2.0, 38.0), [9.0, 10.0]), axis=-1).reshape(-1, 2)
    around = np.stack(np.meshgrid(np.arange(4.0, 12.0), [2.0, 6.0]), axis=-1).reshape(-1, 2)
    at_m, kinds = np.concatenate([across, around]), np.repeat([1, 3], [len(across), len(around)])
    zeros = np.zeros(len(at_m), int)
    survey = RadioSurvey(
        "hall", at_m, zeros, zeros, zeros, ("a",), np.zeros((len(at_m), 1)), room_kind=kinds,
        transmitter_m=np.array([[20.0, 11.5]]), transmitter_floor=np.array([0]), is_high_band=np.array([False]),
    )  # fmt: skip
    plan = surveyed_rooms(survey, 0, np.array([0.0, 0.0, 42.0, 14.0]))
    assert plan.wall_index.crossing(np.array([3.0, 9.1]), survey.transmitters[0])[0][0] == 0
    corridor_end, room, middle_of_room = np.array([[37.0, 10.0], [5.0, 2.5], [8.0, 4.0]])
    assert plan.wall_index.crossing(np.array([3.0, 9.1]), corridor_end[None])[0][0] == 0
    assert plan.wall_index.crossing(np.array([5.0, 9.1]), room[None])[0][0] == 1
    assert plan.wall_index.crossing(room, middle_of_room[None])[0][0] == 0
    assert plan.bounds_m.tolist() == [0, 0, 42.0, 14.0]


def test_known_transmitters_keep_their_columns_and_storeys():
    survey = empty_survey()
    plan = places.with_known_transmitters(places.office("office", [0, 0, 42.0, 16.4]), survey, floor=1)
    assert [point.floor for point in plan.access_points] == [0, 1]
    simulated = places.simulate(survey, plan, dataclasses.replace(CLEAR, wall_loss_scale=0.0), 0)
    assert simulated.rssi_dbm.shape == (30, 3)
    distance = np.maximum(np.abs(survey.position_m[:, 0] - 5.0), 0.5)
    assert simulated.rssi_dbm[:, 0] == pytest.approx(-35.0 - 23.0 * np.log10(distance), abs=0.51)
    assert (simulated.rssi_dbm[:, 2] < simulated.rssi_dbm[:, 0].max() - 20).all()


def test_shops_lie_along_wide_floor_and_not_along_narrow_corridors():
    free = np.zeros((60, 120), bool)
    free[20:40, 5:45] = True  # a concourse, 10 m wide
    free[28:31, 45:115] = True  # a corridor, 1.5 m wide, leads away from it
    cells = Cells(free, ~free, np.array([3.0, -2.0]), 0.5)
    shops = places.beside_wide_floor(cells, 4.0, 3.0)
    corners = np.array([[4.0, 13.0], [24.0, 13.0], [15.0, 8.0 - 2.9], [15.0, 18.0 + 2.9]])
    assert shops.is_free(corners).all()
    assert not shops.is_free(np.array([[31.0, 12.7], [55.0, 12.7], [15.0, 4.0], [15.0, 22.0]])).any()
    plan = places.with_spread_transmitters(places.office("o", [0, 0, 42.0, 16.4]), 50, 100, 0, around=shops)
    stood_m = np.array([point.position_m for point in plan.access_points])
    assert shops.is_free(stood_m).all()
    assert len(np.unique(stood_m, axis=0)) == 50


def test_phones_side_by_side_are_averaged():
    survey = empty_survey(2)
    one = dataclasses.replace(survey, rssi_dbm=np.array([[-50.0, np.nan, np.nan], [-60.0, -70.0, np.nan]]))
    two = dataclasses.replace(survey, rssi_dbm=np.array([[-54.0, -80.0, np.nan], [np.nan, -72.0, np.nan]]))
    merged = places.merged([one, two]).rssi_dbm
    assert merged[:, :2].tolist() == [[-52.0, -80.0], [-60.0, -71.0]]
    assert np.isnan(merged[:, 2]).all()


def test_a_remembering_model_gives_the_same_strengths():
    survey = empty_survey()
    plan = places.with_known_transmitters(places.office("office", [0, 0, 42.0, 16.4]), survey, floor=1)
    model = places.RememberingModel(RadioConfig(), plan)
    twice = [places.simulate(survey, plan, RadioConfig(), 3, model=model).rssi_dbm for _ in range(2)]
    plain = places.simulate(survey, plan, RadioConfig(), 3).rssi_dbm
    assert np.array_equal(twice[0], plain, equal_nan=True)
    assert np.array_equal(twice[1], plain, equal_nan=True)


@pytest.mark.parametrize(("floor_dbm", "slope_db"), [(-92.0, 1.5), (-70.0, 5.0)])
def test_readings_alone_tell_where_a_receivers_hearing_ends(floor_dbm, slope_db):
    random = np.random.default_rng(0)
    level = np.round(random.uniform(-110.0, -30.0, 40_000))
    is_heard = random.random(len(level)) < 1 / (1 + np.exp((floor_dbm - level) / slope_db))
    found_dbm, found_db = hearing(np.where(is_heard, level, np.nan))
    assert found_dbm == pytest.approx(floor_dbm, abs=1.0)
    assert found_db == pytest.approx(slope_db, rel=0.1)


def test_points_beside_each_other_tell_what_a_receiver_misses():
    x, y = np.meshgrid(np.arange(1.0, 40.0), np.arange(1.0, 16.0))
    zeros, boxes = np.zeros(x.size, int), np.random.default_rng(0).uniform([0, 0], [42.0, 16.4], (20, 2))
    survey = RadioSurvey(
        "hall", np.column_stack([x.ravel(), y.ravel()]), zeros, 1.0 * zeros, zeros, tuple(map(str, range(40))),
        np.full((x.size, 40), np.nan), transmitter_m=np.repeat(boxes, 2, axis=0), transmitter_floor=np.zeros(40, int),
        is_high_band=np.arange(40) % 2 == 1,
    )  # fmt: skip
    plan = places.with_known_transmitters(places.office("office", [0, 0, 42.0, 16.4]), survey, floor=0)
    high = HighBandConfig(share=0.5, miss_probability_offset=-0.2)
    config = RadioConfig(miss_probability=0.25, detection_floor_dbm=-80.0, high_band=high)
    heard = dataclasses.replace(survey, rssi_dbm=places.simulate(survey, plan, config, 0).rssi_dbm)
    assert missed_share(heard, False) == pytest.approx(0.25, abs=0.03)
    assert missed_share(heard, True) == pytest.approx(0.05, abs=0.03)
    told = device_hearing(heard)
    assert told["miss_probability"] == missed_share(heard, False)
    assert told["high_band"]["miss_probability_offset"] == pytest.approx(-0.2, abs=0.04)
    low_only = device_hearing(dataclasses.replace(heard, is_high_band=np.zeros(40, bool)))
    assert set(low_only) == {"detection_floor_dbm", "detection_slope_db", "miss_probability"}
    with pytest.raises(DataError, match=r"survey hall has no readings at 2\.4 GHz"):
        device_hearing(dataclasses.replace(heard, is_high_band=np.ones(40, bool)))


def test_sweeps_before_and_after_tell_what_the_one_between_missed():
    random, scans, networks = np.random.default_rng(0), 600, 40
    level = np.repeat(np.linspace(-90.0, -40.0, networks)[None], scans, axis=0)
    is_high = np.arange(networks) % 2 == 1
    is_heard = random.random((scans, networks)) >= np.where(is_high, 0.2, 0.05)
    time_s = np.tile(2.0 * np.arange(20), 30)
    walk = np.repeat(np.arange(30), 20)
    since_s = np.zeros((scans, networks))
    for k in range(1, scans):
        since_s[k] = np.where(is_heard[k], 0.0, since_s[k - 1] + 2.0)
    survey = RadioSurvey(
        "mall", np.zeros((scans, 2)), 0 * walk, time_s, walk, tuple(map(str, range(networks))), level,
        is_high_band=is_high, age_s=since_s + 0.5,
    )  # fmt: skip
    assert missed_by_sweeps(survey, True) == pytest.approx(0.2, abs=0.02)
    assert missed_by_sweeps(survey, False) == pytest.approx(0.05, abs=0.015)
    shuffled = random.permutation(scans)
    assert missed_by_sweeps(survey.at_scans(shuffled), True) == missed_by_sweeps(survey, True)


def test_the_spread_is_that_of_the_mean_over_what_is_drawn():
    values = np.random.default_rng(1).normal(5.0, 2.0, 400)
    low, high, _ = spread_over(400, lambda drawn: {"mean": float(values[drawn].mean())}, draws=400)["mean"]
    assert (low + high) / 2 == pytest.approx(values.mean(), abs=0.05)
    assert high - low == pytest.approx(2 * 1.96 * 2.0 / 20.0, rel=0.15)


def test_real_places_near_a_real_figure_are_counted():
    values = np.array([1.0, 2.0, 3.0, 4.0])
    low, high, near = spread_over(4, lambda drawn: {"first": float(values[drawn[0]])}, draws=400)["first"]
    assert (low, high) == (1.0, 4.0)
    assert near == pytest.approx(0.25, abs=0.07)


def test_notes_count_what_is_near_and_what_a_perfect_model_would_have():
    row = {"dataset": "hall", "role": "reported", "real_low": 0.5, "real_high": 2.0, "real_near": 0.5}
    table = [
        {**row, "quantity": "rate", "real": 1.0, "simulated": 1.1},
        {**row, "quantity": "level", "real": 1.0, "simulated": 3.0},
        {**row, "quantity": "level far off", "real": 1.0, "simulated": None},
    ]
    first, second = notes(table)
    assert "1 of 3 rows within 15%" in first
    assert "1 are within it, and 1 within 15%, where other real places of the kind would have 1.5" in second


def test_every_set_is_either_calibrated_or_reported_and_both_exist():
    roles = [study.role for study in STUDIES]
    assert set(roles) == {"calibrated", "reported"}
    assert len({study.name for study in STUDIES}) == len(STUDIES)


@needs_data
@pytest.mark.parametrize("name", ["sfw_authors E3", "sfw_authors E5"])
def test_routers_are_as_strong_near_by_as_each_experiment_says(name):
    study = next(study for study in STUDIES if study.name == name)
    real, simulated = study.real(DATA, True), study.simulated(DATA, study.config, 0, True)
    for figure in ("mean RSS of class 0 [dBm]", "mean RSS of class 1 [dBm]"):
        assert simulated[figure] == pytest.approx(real[figure], abs=2.5)


@needs_data
def test_walls_take_less_in_the_experiment_whose_5_ghz_says_so():
    told_db, heard_db = {}, {}
    for name, routers in (("E3", 1), ("E5", 2)):
        study = next(study for study in STUDIES if study.name == f"sfw_authors {name}")
        laid = radio_papers._laid(DATA, routers)
        told_db[name] = radio_papers._wall_loss_db(laid)
        heard = [radio_papers._heard_in_flat(DATA, name, study.config, seed).rssi_dbm[:, 0] for seed in range(4)]
        heard_db[name] = np.mean([radio_papers._behind_walls_db(laid, 0, levels) for levels in heard])
    assert told_db == pytest.approx({"E3": 9.7, "E5": 8.7 / 1.5}, abs=0.1)
    assert heard_db["E5"] / heard_db["E3"] == pytest.approx(told_db["E5"] / told_db["E3"], abs=0.2)


@needs_data
def test_the_crowded_mall_misses_more_at_5_ghz_than_the_one_of_the_fit():
    config = next(study for study in STUDIES if study.name == "indoor20 site2_F6").config
    settings = radio_likeness._missed_beside_the_fit(DATA, "site2_F6", config, False)
    told = radio_likeness._missed(DATA, "site2_F6", False), radio_likeness._missed(DATA, "site1_B1", False)
    added = settings["miss_probability"] - config.miss_probability
    assert added == pytest.approx(told[0][0] - told[1][0])
    assert added + settings["high_band"]["miss_probability_offset"] == pytest.approx(told[0][1] - told[1][1])
    assert told[0][1] == pytest.approx(0.137, abs=0.002)
    unchanged = radio_likeness._missed_beside_the_fit(DATA, "site1_B1", config, False)
    assert unchanged["miss_probability"] == config.miss_probability


@needs_data
def test_a_quick_run_gives_a_real_and_a_simulated_figure_for_every_quantity(written):
    rows = written("radio-model", "--quick", "--runs", "1", "--only", "wifi")
    sets = {"wifi/sod", "wifi/uji_lib", "wifi/ble_lidar", "wifi/uw_floor"}
    assert {row["dataset"].split()[0] for row in rows} >= sets
    assert {row["role"] for row in rows} == {"calibrated", "reported"}
    assert all(row["real_low"] <= row["real_high"] for row in rows if row["real_low"] is not None)
    exponents = [row for row in rows if "exponent" in row["quantity"] and "CETC331" in row["dataset"]]
    assert len(exponents) == 2
    assert all(1.0 < row["simulated"] < 5.0 and 1.0 < row["real"] < 5.0 for row in exponents)
    walls = next(row for row in rows if row["quantity"] == "loss per wall [dB]" and row["role"] == "calibrated")
    assert walls["simulated"] == pytest.approx(walls["real"], rel=0.3)
