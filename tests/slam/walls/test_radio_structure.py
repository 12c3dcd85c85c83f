import numpy as np

import twc_env
from twc_env.config import KVisibilityConfig
from twc_env.records.messages import SensorFrame, WifiScan
from twc_env.slam.walls import radio_structure
from twc_env.slam.walls.radio_structure import RadioStructure, update_reading

CONFIG = KVisibilityConfig(enabled=True, noise_std_db=2.0, wall_loss_db=10.0, period_scans=1)


def frame(rssi_dbm):
    scan = WifiScan(np.array([7]), np.array([rssi_dbm]))
    return SensorFrame(0, 0, 0.0, np.zeros(3), 0.0, np.zeros(4), scan)


def level(distance_m, walls):
    return -35.0 - 23.0 * np.log10(max(distance_m, 0.5)) - 10.0 * walls


def test_clear_rays_become_free_and_rays_through_a_wall_uncertain():
    radio = RadioStructure(CONFIG, 0.1, 1)
    for angle in np.linspace(0, 2 * np.pi, 80):
        for distance in (0.5, 4.0):
            place = np.array([distance * np.cos(angle), distance * np.sin(angle), 0.0])
            radio.add(frame(level(distance, distance > 2.0 and place[0] > 0)), place)
    grid = radio.picture_of((0,), np.zeros((1, 3)), 0).grid

    def at(x, y):
        return grid.log_odds[tuple(grid.cell_of(np.array([x, y])))]

    assert at(-2.0, 0.3) < 0
    assert at(2.0, 0.3) > at(-2.0, 0.3)


def test_a_transmitter_is_located_where_its_readings_are_strongest():
    radio = RadioStructure(CONFIG, 0.1, 1)
    for x in np.linspace(-3.0, 3.0, 40):
        for y in (-1.0, 1.5):
            radio.add(frame(level(np.hypot(x - 0.7, y), 0)), np.array([x, y, 0.0]))
    (place,) = radio.picture_of((0,), np.zeros((1, 3)), 0).transmitter_m
    assert np.linalg.norm(place - [0.7, 0.0]) < 0.3


def test_the_map_moves_with_the_frame_and_is_cached_until_new_readings():
    radio = RadioStructure(CONFIG, 0.1, 1)
    for x in np.linspace(0.4, 5.0, 30):
        radio.add(frame(level(x, 0)), np.array([x, 0.0, 0.0]))
    first = radio.picture_of((0,), np.zeros((1, 3)), 0)
    assert radio.picture_of((0,), np.zeros((1, 3)), 0) is first
    moved = radio.picture_of((0,), np.array([[100.0, 0.0, 0.0]]), 1)
    assert np.allclose(moved.grid.origin_m - first.grid.origin_m, [100.0, 0.0], atol=0.11)


def walk(radio, count, seed=0):
    """Add scans of two transmitters along a path one by one; returns the map after each."""
    random = np.random.default_rng(seed)
    pictures = []
    for k in range(count):
        place = np.array([0.3 * k, random.normal(), 0.0])
        heard = [level(np.hypot(*(place[:2] - at)), 0) + random.normal(0, 2.0) for at in ((0, 2), (6, -3))]
        scan = WifiScan(np.array([7, 9]), np.array(heard))
        radio.add(SensorFrame(0, 0, 0.0, np.zeros(3), 0.0, np.zeros(4), scan), place)
        pictures.append(radio.picture_of((0,), np.zeros((1, 3)), 0))
    return pictures


def test_readings_added_one_by_one_give_the_same_map_as_all_at_once():
    several, at_once = RadioStructure(CONFIG, 0.1, 1), RadioStructure(CONFIG, 0.1, 1)
    for radio in (several, at_once):
        radio.give_transmitters(np.array([7, 9]), np.array([[0.0, 2.0], [6.0, -3.0]]), np.zeros((1, 3)))
    pictures = walk(several, 40)
    first = pictures[0].grid.log_odds.copy()
    at_once._readings = several._readings
    grid, whole = pictures[-1].grid, at_once.picture_of((0,), np.zeros((1, 3)), 0).grid
    assert np.array_equal(grid.log_odds, whole.log_odds) and np.allclose(grid.origin_m, whole.origin_m)
    assert np.count_nonzero(grid.log_odds) > 200
    assert np.array_equal(pictures[0].grid.log_odds, first)
    assert pictures[0].grid.log_odds.shape < grid.log_odds.shape


def test_the_number_of_ray_casts_per_reading_is_bounded(monkeypatch):
    cast, draw = [], radio_structure._update_all
    monkeypatch.setattr(radio_structure, "_update_all", lambda *all: cast.append(len(all[3])) or draw(*all))
    radio = RadioStructure(CONFIG, 0.1, 1)
    pictures = walk(radio, 300)
    assert len(pictures[-1].transmitter_m) == 2
    assert len(cast) == 300
    assert sum(cast) < 10 * 600


def test_a_transmitter_that_was_passed_closely_is_in_the_next_map():
    radio = RadioStructure(CONFIG, 0.1, 1)
    counts = [len(picture.transmitter_m) for picture in walk(radio, 60)]
    assert counts[0] == 1 and counts[-1] == 2 and sorted(counts) == counts


def test_observations_contain_the_radio_map_only_if_enabled():
    plain = twc_env.parallel_env(map="sfw-e4", robots=1)
    assert "radio" not in plain.observation_space("robot_0").spaces
    env = twc_env.parallel_env(map="sfw-e4", robots=1, max_cycles=40, config={"slam.k_visibility.enabled": True})
    observations, _ = env.reset(seed=0)
    assert env.belief("robot_0").radio_map is None or env.belief("robot_0").radio_map.resolution_m == 0.1
    for _ in range(30):
        observations, *_ = env.step({"robot_0": np.array([0.5, 0.2], np.float32)})
    assert env.observation_space("robot_0").contains(observations["robot_0"])
    assert env.belief("robot_0").radio_map is not None


def test_repeated_readings_of_earlier_sweeps_are_ignored():
    plain, repeating = RadioStructure(CONFIG, 0.1, 1), RadioStructure(CONFIG, 0.1, 1)
    macs, heard_m = np.array([7, 9]), 0.0
    for k, x in enumerate(np.linspace(0.4, 8.0, 20)):
        place, time_s, is_heard = np.array([x, 0.0, 0.0]), 2.0 * k, np.array([True, k % 4 == 0])
        heard_m = x if is_heard[1] else heard_m
        rssi_dbm = np.array([level(x, 0), level(8.5 - heard_m, 0)])
        age_s = np.array([0.5, 0.5 + 2.0 * (k % 4)])
        for radio, scan in (
            (plain, WifiScan(macs[is_heard], rssi_dbm[is_heard])),
            (repeating, WifiScan(macs, rssi_dbm, age_s)),
        ):
            radio.add(SensorFrame(0, k, time_s, np.zeros(3), 0.0, np.zeros(4), scan), place)
    one, other = (radio.picture_of((0,), np.zeros((1, 3)), 0) for radio in (plain, repeating))
    assert np.array_equal(one.grid.log_odds, other.grid.log_odds)
    assert np.array_equal(one.transmitter_m, other.transmitter_m)


def test_scans_with_only_repeated_readings_add_nothing():
    radio = RadioStructure(CONFIG, 0.1, 1)
    for k in range(5):
        scan = WifiScan(np.array([7]), np.array([-50.0]), np.array([float(k)]))
        radio.add(SensorFrame(0, k, float(k), np.zeros(3), 0.0, np.zeros(4), scan), np.array([0.5 * k, 0.0, 0.0]))
    assert len(radio._readings[0].macs) == 1


def test_a_known_wall_on_a_ray_explains_its_loss():
    signal, changes = (-40.0, 2.0, 8.0, 3.0), []  # power, exponent, wall loss and noise
    for level in (0, 40):
        log_odds = np.zeros((3, 60), np.int16)
        log_odds[1, 30] = level
        update_reading(log_odds, np.zeros(2), 10.0, 5.5, 0.15, 0.5, 0.15, -40.0 - 20 * np.log10(5.0) - 8.0, *signal)
        changes.append(int(log_odds[1, 15]))
    assert changes[1] < min(changes[0], 0)


def test_scans_may_be_lists():
    pictures = []
    for kind in (np.array, list):
        radio = RadioStructure(CONFIG, 0.1, 1)
        scan = WifiScan(kind([7, 9]), kind([-40.0, -50.0]), kind([0.0, 0.1]))
        radio.add(SensorFrame(0, 0, 0.0, np.zeros(3), 0.0, np.zeros(4), scan), np.zeros(3))
        pictures.append(radio.picture_of((0,), np.zeros((1, 3)), 0))
    assert np.array_equal(pictures[0].grid.log_odds, pictures[1].grid.log_odds)
