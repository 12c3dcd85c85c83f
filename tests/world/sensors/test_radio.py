import dataclasses

import numpy as np
import pytest

from twc_env.config import HighBandConfig, RadioConfig
from twc_env.maps import load_map
from twc_env.world.building.floorplan import AccessPoint, Floorplan
from twc_env.world.sensors.mean_rssi import lose_in_bodies
from twc_env.world.sensors.radio import HIGH_BAND, LOW_BAND, RadioModel
from twc_env.world.sensors.reception import WifiReceiver
from twc_env.world.sensors.signal_map import strongest_signal_dbm

QUIET = {"shadowing_std_db": 0.0, "fading_std_db": 0.0, "device_offset_std_db": 0.0, "noise_std_db": 0.0}
SURE = {**QUIET, "detection_floor_dbm": -119.0, "detection_slope_db": 0.05}


def hall(inner_walls=(), macs=((1, 2),), source=(0.0, 0.0)) -> Floorplan:
    outer = [[-5, -50, 200, -50], [200, -50, 200, 50], [200, 50, -5, 50], [-5, 50, -5, -50]]
    walls = np.array([*outer, *[w[:4] for w in inner_walls]], float).reshape(-1, 2, 2)
    losses = [8.0] * 4 + [w[4] for w in inner_walls]
    points = [AccessPoint(f"ap-{i}", np.array(source), m) for i, m in enumerate(macs)]
    return Floorplan("hall", walls, losses, access_points=points, interior_m=[[1, 0]])


def test_rssi_at_one_metre_is_the_configured_power_up_to_the_transmitters_offset():
    model = RadioModel(RadioConfig(**QUIET, power_at_1m_dbm=-40.0), hall(macs=[tuple(range(1, 200))]))
    levels = model.mean_rssi_dbm(np.array([1.0, 0.0]))
    assert levels.mean() == pytest.approx(-40.0, abs=0.3)
    assert levels.std() == pytest.approx(1.0, abs=0.2)


def test_rssi_stops_rising_below_the_smallest_distance():
    model = RadioModel(RadioConfig(**QUIET, distance_min_m=0.5), hall())
    assert np.array_equal(model.mean_rssi_dbm(np.array([0.5, 0.0])), model.mean_rssi_dbm(np.array([0.0, 0.01])))


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_each_wall_attenuates_by_its_loss(scale):
    position = np.array([10.0, 0.3])
    walls = [(2, -3, 2, 3, 4.0), (5, -3, 5, 3, 7.0), (8, 1, 8, 3, 50.0), (12, -3, 12, 3, 50.0)]
    config = RadioConfig(**QUIET, power_spread_db=0.0)
    open_hall = RadioModel(config, hall()).mean_rssi_dbm(position)
    blocked = RadioModel(dataclasses.replace(config, wall_loss_scale=scale), hall(walls)).mean_rssi_dbm(position)
    assert open_hall - blocked == pytest.approx([11.0 * scale, 11.0 * scale])


@pytest.mark.parametrize("storey", [0, 1, -3])
@pytest.mark.parametrize("walls", [{}, {"wall_loss_scale": 2.0, "wall_loss_limit_db": 14.0}])
def test_the_map_of_signal_strengths_has_what_robots_hear_on_the_mean(storey, walls):
    plan = hall([(2, -3, 2, 3, 4.0), (8, -3, 8, 3, 7.0)])
    above = [dataclasses.replace(point, floor=storey) for point in plan.access_points]
    plan = dataclasses.replace(plan, access_points=above)
    config = RadioConfig(**QUIET, power_spread_db=0.0, floor_loss_grazing_db=5.0, **walls)
    places = np.array([[0.0, 0.01], [1.0, 1.0], [5.0, 0.5], [30.0, -2.0]])
    heard = [RadioModel(config, plan).mean_rssi_dbm(place).max() for place in places]
    assert strongest_signal_dbm(plan, places, config) == pytest.approx(heard)


def shadowing(config, plan):
    """Function from a position to the shadowing of each address (transmitters,) [dB]."""
    shadowed, clear = RadioModel(config, plan), RadioModel(dataclasses.replace(config, shadowing_std_db=0.0), plan)
    return lambda place: shadowed.mean_rssi_dbm(place) - clear.mean_rssi_dbm(place)


def test_shadowing_depends_on_the_position_only():
    plan = load_map("twin-01")
    first, second = shadowing(RadioConfig(), plan), shadowing(RadioConfig(), plan)
    place, elsewhere = np.array([10.0, 1.2]), np.array([22.0, 5.0])
    before = first(place)
    second(elsewhere)
    assert np.array_equal(before, second(place))
    assert np.abs(before - first(elsewhere)).max() > 0.5


def test_shadowing_has_the_configured_spread_and_correlation():
    config = RadioConfig(shadowing_std_db=2.0, shadowing_length_m=4.0)
    added = shadowing(config, hall(macs=[(i + 1,) for i in range(150)]))
    places = np.random.default_rng(0).uniform(0, 150, (150, 2))
    here = np.array([added(p) for p in places])
    assert here.std() == pytest.approx(2.0, rel=0.05)
    for gap_m in (1.0, 4.0, 8.0):
        there = np.array([added(p + [gap_m, 0.0]) for p in places])
        assert (here * there).mean() / 4.0 == pytest.approx(np.exp(-gap_m / 4.0), abs=0.06)


def test_addresses_of_one_access_point_share_shadowing_and_others_do_not():
    plan = hall(macs=[(1, 2), (3,)])
    model = RadioModel(RadioConfig(), plan)
    assert model.macs.tolist() == [1, 2, 3]
    assert model.access_point_of.tolist() == [0, 0, 1]
    one, same, other = shadowing(RadioConfig(), plan)(np.array([7.0, 7.0]))
    assert one == pytest.approx(same)
    assert abs(one - other) > 1e-3


def test_shadowing_moves_with_the_building():
    plan = load_map("twin-01")
    moved = plan.moved([30.0, -8.0, 2.0])
    here, there = np.array([3.0, 1.0]), moved.home
    position_moved = np.array([30.0, -8.0]) + np.array([[np.cos(2), -np.sin(2)], [np.sin(2), np.cos(2)]]) @ here
    assert there is plan
    expected = RadioModel(RadioConfig(), plan).mean_rssi_dbm(here)
    assert RadioModel(RadioConfig(), moved).mean_rssi_dbm(position_moved) == pytest.approx(expected, abs=1e-9)


def test_readings_are_whole_decibels_with_ascending_addresses():
    model = RadioModel(RadioConfig(), load_map("twin-01"))
    scan = WifiReceiver(RadioConfig(), model, robot=0, seed=1).scan(np.array([15.0, 1.2]))
    assert np.array_equal(scan.rssi_dbm, np.round(scan.rssi_dbm))
    assert (np.diff(scan.macs) > 0).all()
    assert scan.macs.dtype == np.int64


def test_eight_access_points_are_heard_all_over_the_twin_maps():
    for name in ("twin-01", "twin-02"):
        plan = load_map(name)
        model = RadioModel(RadioConfig(), plan)
        cells = plan.cells(1.0)
        rows, columns = np.nonzero(cells.free)
        for row, column in zip(rows, columns, strict=True):
            centre = cells.origin_m + (np.array([column, row]) + 0.5) * cells.resolution_m
            level = model.mean_rssi_dbm(centre)
            assert len(np.unique(model.access_point_of[level > -88.0])) >= 8


def test_noise_differs_between_scans_with_the_configured_spread():
    config = RadioConfig(**{**SURE, "noise_std_db": 3.0})
    receiver = WifiReceiver(config, RadioModel(config, hall(macs=[tuple(range(1, 31))])), robot=0, seed=0)
    readings = np.array([receiver.scan(np.array([5.0, 0.0])).rssi_dbm for _ in range(300)])
    assert readings.std(axis=0).mean() == pytest.approx(3.0, rel=0.05)


def test_fading_changes_only_after_the_fading_length():
    config = RadioConfig(**{**SURE, "fading_std_db": 4.0, "fading_length_m": 0.5})
    receiver = WifiReceiver(config, RadioModel(config, hall(macs=[tuple(range(1, 31))])), robot=0, seed=0)
    first, same, moved = (receiver.scan(np.array([x, 0.0])).rssi_dbm for x in (20.0, 20.0, 20.6))
    assert np.array_equal(first, same)
    assert np.abs(first - moved).max() > 3


def test_devices_differ_by_their_offset():
    config = RadioConfig(**{**SURE, "device_offset_std_db": 6.0})
    model = RadioModel(config, hall())
    place = np.array([5.0, 0.0])
    readings = [WifiReceiver(config, model, robot, seed=3).scan(place).rssi_dbm for robot in range(8)]
    assert len({tuple(r) for r in readings}) > 4


def test_a_building_without_access_points_gives_empty_scans():
    plan = Floorplan("bare", hall().walls_m, hall().wall_loss_db, interior_m=[[1, 0]])
    scan = WifiReceiver(RadioConfig(), RadioModel(RadioConfig(), plan), robot=0, seed=0).scan(np.zeros(2))
    assert len(scan.macs) == len(scan.rssi_dbm) == 0


def test_rssi_falls_ten_n_decibels_per_decade_in_each_band_by_its_own_exponent():
    config = RadioConfig(**QUIET, path_loss_exponent=2.0, high_band=HighBandConfig(share=0.5, path_loss_exponent=3.0))
    model = RadioModel(config, hall(macs=((1, 2, 3, 4),)))
    near, far = (model.mean_rssi_dbm(np.array([d, 0.0])) for d in (1.5, 15.0))
    assert model.band_of.tolist() == [LOW_BAND, HIGH_BAND, LOW_BAND, HIGH_BAND]
    assert near - far == pytest.approx([20.0, 30.0, 20.0, 30.0])


def test_wall_losses_are_greater_at_five_gigahertz_and_depend_on_the_material():
    walls, position = [(5, -3, 5, 3, 7.0)], np.array([10.0, 0.3])
    config = RadioConfig(**QUIET, high_band=HighBandConfig(share=0.5, wall_loss_factor=1.5))
    free, plain = hall(macs=((1, 2),)), hall(walls, macs=((1, 2),))
    brick = dataclasses.replace(plain, wall_materials=("", "", "", "", "brick"))
    clear = RadioModel(dataclasses.replace(config, power_spread_db=0.0), free).mean_rssi_dbm(position)
    for plan, expected in ((plain, [7.0, 10.5]), (brick, [7.0, 11.0])):
        model = RadioModel(dataclasses.replace(config, power_spread_db=0.0), plan)
        assert clear - model.mean_rssi_dbm(position) == pytest.approx(expected)


def test_the_detection_probability_follows_the_slope_of_the_band():
    high = HighBandConfig(share=0.5, path_loss_exponent=2.3, power_offset_db=0.0, detection_slope_factor=0.25)
    config = RadioConfig(**QUIET, power_spread_db=0.0, detection_slope_db=8.0, high_band=high)
    model = RadioModel(config, hall(macs=[(k, k + 100) for k in range(1, 101)]))
    config = dataclasses.replace(config, detection_floor_dbm=float(model.mean_rssi_dbm(np.array([30.0, 0.0]))[0]) - 4.0)
    model = RadioModel(config, hall(macs=[(k, k + 100) for k in range(1, 101)]))
    receiver = WifiReceiver(config, model, robot=0, seed=0)
    heard = np.concatenate([receiver.scan(np.array([30.0, 0.0])).macs for _ in range(40)])
    assert (heard <= 100).sum() / 4000 == pytest.approx(1 / (1 + np.exp(-4.0 / 8.0)), abs=0.03)
    assert (heard > 100).sum() / 4000 == pytest.approx(1 / (1 + np.exp(-4.0 / 2.0)), abs=0.03)


def test_the_wall_loss_is_bounded_by_the_limit():
    walls = [(x, -3, x, 3, 6.0) for x in range(1, 9)]
    high = HighBandConfig(share=0.5, wall_loss_factor=3.0)
    plain = RadioConfig(**QUIET, power_spread_db=0.0, high_band=high)
    limited = dataclasses.replace(plain, wall_loss_limit_db=15.0)
    open_hall, through, round_them = (
        np.array([RadioModel(config, plan).mean_rssi_dbm(np.array([x, 0.1])) for x in np.arange(0.5, 9.0)])
        for config, plan in ((plain, hall()), (plain, hall(walls)), (limited, hall(walls)))
    )
    lost, kept = open_hall - through, open_hall - round_them
    assert lost[:, 0] == pytest.approx(6.0 * np.arange(9))
    share = 10 ** (-15.0 / 10)
    assert kept == pytest.approx(-10 * np.log10((1 - share) * 10 ** (-lost / 10) + share))
    assert kept[0] == pytest.approx([0.0, 0.0])
    assert (np.diff(kept, axis=0) > 0).all()
    assert (np.diff(kept, 2, axis=0) < 0).all(), "each further wall costs less"
    assert (kept < 15.0).all()
    assert kept[-1] == pytest.approx([15.0, 15.0], abs=0.01)


def test_strong_signals_are_missed_with_the_configured_probability_of_their_band():
    high = HighBandConfig(share=0.5, miss_probability_offset=-0.3)
    config = RadioConfig(**SURE, miss_probability=0.35, high_band=high)
    model = RadioModel(config, hall(macs=[(k, k + 100) for k in range(1, 101)]))
    receiver = WifiReceiver(config, model, robot=0, seed=0)
    heard = np.concatenate([receiver.scan(np.array([3.0, 0.0])).macs for _ in range(40)])
    assert (heard <= 100).sum() / 4000 == pytest.approx(0.65, abs=0.03)
    assert (heard > 100).sum() / 4000 == pytest.approx(0.95, abs=0.02)


def test_ceilings_attenuate_and_lengthen_the_path():
    config = RadioConfig(
        **QUIET, power_spread_db=0.0, floor_loss_db=15.0, floor_loss_further_db=4.0, floor_height_m=3.0,
        path_loss_exponent=2.0,
    )  # fmt: skip
    levels = []
    for floor in (0, 1, -3):
        plan = hall(macs=((1,),))
        above = dataclasses.replace(plan.access_points[0], floor=floor)
        levels.append(
            RadioModel(config, dataclasses.replace(plan, access_points=(above,))).mean_rssi_dbm(np.array([4.0, 0]))[0]
        )
    assert levels[0] - levels[1] == pytest.approx(15.0 + 20 * np.log10(5.0 / 4.0))
    assert levels[0] - levels[2] == pytest.approx(23.0 + 20 * np.log10(np.hypot(9.0, 4.0) / 4.0))


def test_ceiling_losses_grow_with_obliqueness_and_band():
    plan = hall(macs=((1, 2),))
    above = dataclasses.replace(plan.access_points[0], floor=1)
    plan = dataclasses.replace(plan, access_points=(above,))
    high = HighBandConfig(share=0.5, floor_loss_factor=1.5)
    plain = RadioConfig(**QUIET, floor_height_m=3.0, high_band=high)
    oblique = dataclasses.replace(plain, floor_loss_grazing_db=10.0)
    for x, cosine in ((4.0, 0.6), (0.0, 1.0), (40.0, 3.0 / np.hypot(40.0, 3.0))):
        place = np.array([x, 0.0])
        lost = RadioModel(plain, plan).mean_rssi_dbm(place) - RadioModel(oblique, plan).mean_rssi_dbm(place)
        assert lost == pytest.approx([10.0 * (1.0 - cosine), 15.0 * (1.0 - cosine)], abs=1e-9)
    same_storey = RadioModel(oblique, hall()).mean_rssi_dbm(np.array([4.0, 0.0]))
    assert np.array_equal(same_storey, RadioModel(plain, hall()).mean_rssi_dbm(np.array([4.0, 0.0])))


def test_the_number_of_addresses_per_access_point_can_be_set():
    plan = load_map("twin-01")
    for count in (1, 5):
        model = RadioModel(RadioConfig(bssids_per_access_point=count), plan)
        assert len(model.macs) == count * len(plan.access_points)
        assert len(np.unique(model.macs)) == len(model.macs)
        assert np.bincount(model.access_point_of).tolist() == [count] * len(plan.access_points)


def test_addresses_of_one_radio_share_their_fading_if_configured():
    plan = hall(macs=[tuple(range(1, 7))])
    config = RadioConfig(**{**SURE, "fading_std_db": 6.0}, power_spread_db=0.0, fading_shared=True)
    readings = WifiReceiver(config, RadioModel(config, plan), 0, 1).scan(np.array([9.0, 0.0])).rssi_dbm
    apart = dataclasses.replace(config, fading_shared=False)
    scattered = WifiReceiver(apart, RadioModel(apart, plan), 0, 1).scan(np.array([9.0, 0.0])).rssi_dbm
    assert np.ptp(readings) == 0.0
    assert np.ptp(scattered) > 2.0


def test_stale_readings_are_repeated_with_their_age_up_to_the_maximum():
    config = RadioConfig(**SURE, stale_age_max_s=5.0)
    receiver = WifiReceiver(config, RadioModel(config, hall()), robot=0, seed=0)
    first = receiver.scan(np.array([3.0, 0.0]), time_s=0.0)
    deaf = np.array([1e9, 0.0])
    second, third = receiver.scan(deaf, time_s=4.0), receiver.scan(deaf, time_s=6.0)
    assert first.age_s.tolist() == [0.0, 0.0]
    assert second.age_s.tolist() == [4.0, 4.0]
    assert np.array_equal(second.rssi_dbm, first.rssi_dbm)
    assert len(third.macs) == 0


def test_a_scan_that_sweeps_part_of_the_channels_renews_that_share():
    config = RadioConfig(**SURE, sweep_share=0.3, stale_age_max_s=100.0)
    receiver = WifiReceiver(config, RadioModel(config, hall(macs=[(mac,) for mac in range(1, 101)])), robot=0, seed=0)
    scans = [receiver.scan(np.array([3.0, 0.0]), time_s=2.0 * k) for k in range(300)]
    fresh = np.mean([(scan.age_s == 0.0).sum() / 100 for scan in scans])
    assert fresh == pytest.approx(0.3, abs=0.05)
    assert len(scans[-1].macs) == 100
    assert 2.0 < np.mean(np.concatenate([scan.age_s for scan in scans[30:]])) < 7.0


def test_channels_missed_by_a_partial_sweep_are_adjacent():
    plan = hall(macs=tuple((mac,) for mac in range(1, 201)))
    config = RadioConfig(**SURE, sweep_share=0.5, sweep_duration_s=1.0, stale_age_max_s=20.0, scan_period_s=2.0)
    model = RadioModel(config, plan)
    receiver = WifiReceiver(config, model, 0, 0)
    for k in range(60):
        scan = receiver.scan([1.0, 0.0], 2.0 * k)
        renewed = np.isin(model.macs, scan.macs[scan.age_s <= 1.0])[np.argsort(model.sweep_place)]
        assert np.abs(np.diff(renewed.astype(int))).sum() <= 2


def test_the_age_of_a_reading_is_the_time_since_its_channel_was_scanned():
    plan = hall(macs=((1, 2), (3, 4)))
    config = RadioConfig(
        sweep_duration_s=2.0, stale_age_max_s=20.0, noise_std_db=0.0, high_band=HighBandConfig(share=0.5)
    )
    receiver = WifiReceiver(config, RadioModel(config, plan), 0, 0)
    ages = receiver.scan([1.0, 0.0], 10.0).age_s
    low, high = ages[::2], ages[1::2]
    assert (low >= 1.0).all() and (low <= 2.0).all() and (high >= 0.0).all() and (high <= 1.0).all()
    assert receiver.scan([1.0, 0.0], 12.0).age_s.tolist() == ages.tolist()


def test_readings_come_in_the_configured_steps():
    config = RadioConfig(quantisation_db=2.0)
    readings = WifiReceiver(config, RadioModel(config, load_map("twin-01")), 0, 1).scan(np.array([15.0, 1.2])).rssi_dbm
    assert np.array_equal(readings % 2.0, np.zeros(len(readings)))


def test_readings_stay_below_zero_however_near_the_access_point():
    loud = RadioConfig(**SURE, power_at_1m_dbm=20.0)
    scan = WifiReceiver(loud, RadioModel(loud, hall()), 0, 0).scan(np.array([0.5, 0.0]))
    assert len(scan.rssi_dbm) == 2 and (scan.rssi_dbm == -1.0).all()


def test_access_points_change_their_power_every_minute_alike_for_all_robots():
    config = RadioConfig(
        power_change_std_db=5.0, noise_std_db=0.0, fading_std_db=0.0, device_offset_std_db=0.0, quantisation_db=0.01
    )
    model = RadioModel(config, load_map("twin-01"))
    receivers = [WifiReceiver(config, model, robot, 3) for robot in (0, 1)]

    def heard(receiver, time_s):
        scan = receiver.scan((15.0, 1.2), time_s)
        return dict(zip(scan.macs.tolist(), scan.rssi_dbm.tolist(), strict=True))

    first, other, same, later = (
        heard(receivers[0], 10.0), heard(receivers[1], 10.0), heard(receivers[0], 50.0), heard(receivers[0], 130.0)
    )  # fmt: skip
    common = sorted(set(first) & set(other) & set(same) & set(later))
    assert max(abs(first[mac] - other[mac]) for mac in common) < 0.02
    assert max(abs(first[mac] - same[mac]) for mac in common) < 0.02
    changed = np.array([first[mac] - later[mac] for mac in common])
    assert 3.0 < changed.std() < 12.0
    assert not receivers[0].is_plain


def test_signals_lose_in_bodies_only_in_the_line_of_sight():
    boxes = np.array(
        [[4.0, 4.0, 4.0, 0.0], [0.0, 0.0, 0.0, 4.0], [0.0, 3.0, 0.0, 0.0]]
    )  # in sight, above, wall, beside
    losses, crossed = np.zeros((1, 4)), np.array([0, 0, 1, 0])
    bodies = np.array([[x, y, 0.2, 7.0, 0.0] for x, y in ((1.0, 0.1), (2.0, 0.0), (5.0, 0.0), (-1.0, 0.0))])
    lose_in_bodies(0.0, 0.0, boxes, crossed, bodies, losses)
    assert losses.tolist() == [[14.0, 0.0, 0.0, 0.0]]
    bodies[0, 4] = np.inf  # a door weakens signals behind walls as well
    lose_in_bodies(0.0, 0.0, boxes, crossed, bodies, losses)
    assert losses.tolist() == [[28.0, 0.0, 7.0, 0.0]]
