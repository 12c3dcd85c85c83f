"""Radio SLAM in a synthetic world: transmitters over a square, RSSI by distance, odometry with a heading drift."""

import dataclasses
import functools
import itertools
import tracemalloc

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from twc_env.config import RadioSlamConfig
from twc_env.errors import DataError
from twc_env.metrics.trajectory import absolute_trajectory_error_m
from twc_env.records.geometry import between, poses_along, wrap_angle
from twc_env.records.messages import Fingerprint
from twc_env.slam.odometry.odometry_calibration import Motions, calibrated
from twc_env.slam.pose_graph.distance_factor import Distances
from twc_env.slam.radio import radio_closures, radio_cue, radio_field
from twc_env.slam.radio.radio_similarity import CELL_ID_MIN
from twc_env.slam.radio.radio_slam import ORDER_MIN, RadioLog, RadioResult, _Solver, solve, spread
from twc_env.slam.radio.similarity_model import SimilarityModel

LAP_M = (40.0, 25.0)
TRANSMITTERS = 60


def true_path(laps: int = 3) -> np.ndarray:
    width, height = LAP_M
    corners = np.array([(0, 0), (width, 0), (width, height), (0, height), (0, 0)], float)
    sides = [np.linspace(a, b, int(np.linalg.norm(b - a)), endpoint=False) for a, b in itertools.pairwise(corners)]
    points = np.concatenate([np.concatenate(sides)] * laps)
    step = np.diff(points, axis=0, append=points[:1])
    return np.column_stack([points, np.arctan2(step[:, 1], step[:, 0])])


def made_log(
    curl: float = 0.006, seed: int = 0, first_mac: int = 1, noise_db: float = 2.0, laps: int = 3,
    slope_db: float = 30.0, floor_dbm: float = -85.0, power_std_db: float = 0.0,
) -> tuple[RadioLog, np.ndarray]:  # fmt: skip
    random = np.random.default_rng(seed)
    truth = true_path(laps)
    places = random.uniform((-15, -15), (55, 40), (TRANSMITTERS, 2))
    away = np.linalg.norm(truth[:, None, :2] - places[None], axis=2)
    level = -35 - slope_db * np.log10(np.maximum(away, 1.0)) + noise_db * random.normal(size=away.shape)
    level += power_std_db * np.random.default_rng([seed, 1]).normal(size=TRANSMITTERS)
    macs = first_mac + np.arange(TRANSMITTERS)
    prints = [Fingerprint(macs[row > floor_dbm], np.round(row[row > floor_dbm])) for row in level]
    motion = between(truth[:-1], truth[1:])
    motion[:, 0] *= 1.02
    motion[:, 2] += curl + 0.003 * random.normal(size=len(motion))
    return RadioLog(motion, motion[:, 2].copy(), prints), truth


def heard_both(seed: int) -> tuple[RadioLog, np.ndarray]:
    """`made_log` with WiFi and LTE cells."""
    wifi, truth = made_log(seed=seed)
    lte, _ = made_log(seed=seed + 5, first_mac=CELL_ID_MIN)
    both = [
        Fingerprint(np.concatenate([a.macs, b.macs]), np.concatenate([a.rssi_dbm, b.rssi_dbm]))
        for a, b in zip(wifi.fingerprints, lte.fingerprints, strict=True)
    ]
    return dataclasses.replace(wifi, fingerprints=both), truth


@functools.cache
def solved(made, seed) -> RadioResult:
    return solve(made(seed=seed)[0], RadioSlamConfig())


def error_m(poses: np.ndarray) -> float:
    return absolute_trajectory_error_m(poses, true_path())


def test_radio_removes_the_drift_of_odometry():
    log, _ = made_log()
    ours = error_m(solved(made_log, 0).poses)
    assert error_m(log.odometry) > 10.0 and ours < 1.0
    assert ours < error_m(solve(log, RadioSlamConfig(weighting="paper")).poses)


def test_a_fifth_of_false_closures_changes_little():
    log, truth = made_log()
    clean = solved(made_log, 0)
    random = np.random.default_rng(2)
    count = len(clean.closures) // 4
    false = Distances(
        np.sort(random.integers(0, len(truth), (count, 2)), axis=1), np.full(count, 2.0), np.full(count, 2.0)
    )
    assert error_m(solve(log, RadioSlamConfig(), false_closures=false).poses) < 1.5


def test_one_transmitter_with_constant_rssi_does_not_change_the_odometry():
    log, _ = made_log(laps=2)
    alike = [Fingerprint(np.array([CELL_ID_MIN]), np.array([-80.0]))] * len(log.fingerprints)
    result = solve(dataclasses.replace(log, fingerprints=alike), RadioSlamConfig(), ("lte",))
    assert result.fell_back and result.poses == pytest.approx(log.odometry, abs=1e-9)


def test_uninformative_fingerprints_do_not_change_the_odometry():
    log, _ = made_log()
    random = np.random.default_rng(2)
    shuffled = dataclasses.replace(
        log, fingerprints=[log.fingerprints[k] for k in random.permutation(len(log.fingerprints))]
    )
    result = solve(shuffled, RadioSlamConfig())
    assert result.fell_back and result.poses == pytest.approx(log.odometry, abs=1e-9)
    empty = dataclasses.replace(
        log, fingerprints=[Fingerprint(np.zeros(0, np.int64), np.zeros(0))] * len(log.fingerprints)
    )
    assert solve(empty, RadioSlamConfig()).fell_back


@pytest.mark.parametrize("seed", [0, 3])
def test_a_better_path_is_kept_if_most_places_share_no_transmitter(seed):
    """Places without a common transmitter all have the same similarity, whatever their distance."""
    log, truth = made_log(0.002, seed, noise_db=4.0, laps=2, slope_db=50.0, floor_dbm=-75.0, power_std_db=15.0)
    result = solve(log, RadioSlamConfig())
    assert absolute_trajectory_error_m(log.odometry, truth) > 2.5
    assert absolute_trajectory_error_m(result.poses, truth) < 0.6


def test_wifi_and_lte_can_be_used_separately_and_together():
    together, result = heard_both(0)[0], solved(heard_both, 0)
    assert sorted(result.models) == ["lte", "wifi"]
    assert error_m(result.poses) < 1.0
    assert sorted(solve(together, RadioSlamConfig(), cues=("lte",)).models) == ["lte"]


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_adding_lte_to_wifi_does_not_increase_the_error(seed):
    """Odometry has a scale error of 2 %, which radio cannot observe: that alone gives 0.44 m."""
    alone = error_m(solved(made_log, seed).poses)
    assert error_m(solved(heard_both, seed).poses) < min(alone + 0.05, 0.6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"fingerprints": [Fingerprint(np.array([1]), np.array([-50.0]))] * 4}, "and 5 fingerprints; got .* and 4"),
        ({"turned_rad": np.zeros(3)}, r"turns \(4,\).*; got .*\(3,\)"),
        ({"motions": np.zeros((4, 2))}, r"motions \(4, 3\).*; got \(4, 2\)"),
        ({"motions": np.full((4, 3), np.nan)}, "finite"),
        ({"motions": "far"}, "numbers"),
        ({"fingerprints": [None] * 5}, "fingerprint 0 is None"),
        (
            {"fingerprints": [Fingerprint(np.array([2, 1]), np.array([-50.0, -60.0]))] * 5},
            "fingerprint 0 .* not ascend",
        ),
        ({"fingerprints": [Fingerprint(np.array([1]), np.array([np.nan]))] * 5}, "strength that is not finite"),
    ],
)
def test_a_log_with_parts_of_unequal_length_is_rejected(changes, message):
    heard = Fingerprint(np.array([1]), np.array([-50.0]))
    parts = {"motions": np.zeros((4, 3)), "turned_rad": np.zeros(4), "fingerprints": [heard] * 5}
    with pytest.raises(DataError, match=message):
        RadioLog(**{**parts, **changes})
    assert RadioLog(**{key: list(value) for key, value in parts.items()}).odometry.shape == (5, 3)


@pytest.mark.parametrize("cues", ["wifi", ["wifi", "smell"]])
def test_unknown_cues_are_rejected(cues):
    with pytest.raises(DataError, match="cues must be a list of some of wifi, lte"):
        solve(made_log()[0], RadioSlamConfig(), cues)


def test_cues_may_come_one_by_one():
    log = made_log()[0]
    listed, one_by_one = (solve(log, RadioSlamConfig(), cues) for cues in (["wifi"], iter(["wifi"])))
    assert not listed.fell_back and np.array_equal(listed.poses, one_by_one.poses)


def test_the_result_is_deterministic():
    log, _ = made_log()
    assert solve(log, RadioSlamConfig()).poses.tobytes() == solved(made_log, 0).poses.tobytes()


def test_the_result_does_not_depend_on_the_threads_of_matrix_libraries():
    with threadpool_limits(2, user_api="blas"):
        several = solve(made_log()[0], RadioSlamConfig()).poses
    assert several.tobytes() == solved(made_log, 0).poses.tobytes()


def test_calibration_recovers_scale_curl_and_turn_factor():
    truth = true_path(8)
    motion = between(truth[:-1], truth[1:])
    turned = motion[:, 2].copy()
    wrong = motion.copy()
    wrong[:, 0] *= 1.05
    wrong[:, 2] = wrap_angle(1.06 * turned + 0.01 * motion[:, 0])
    found = calibrated(Motions(wrong, 1.06 * turned + 0.01 * motion[:, 0]), truth)
    assert np.abs(found.motion[:, :2] - motion[:, :2]).max() < 0.01
    left, before = (np.abs(wrap_angle(m[:, 2] - turned)).max() for m in (found.motion, wrong))
    assert left < 0.5 * before


def test_isolated_closures_are_rejected_at_any_path_length():
    travel = 1e8 + np.arange(0.0, 200.0, 2.0)
    i, j = np.array([10, 11, 12, 40]), np.array([80, 81, 82, 70])
    assert radio_closures.with_support(i, j, travel).tolist() == [True, True, True, False]
    assert radio_closures.with_support(i[:0], j[:0], travel).tolist() == []


def test_memory_does_not_grow_with_pairs_of_scans_of_a_robot_at_rest():
    log, _ = made_log()
    standing = 2000
    still = RadioLog(
        np.concatenate([np.zeros((standing, 3)), log.motions]), np.concatenate([np.zeros(standing), log.turned_rad]),
        [*[log.fingerprints[0]] * standing, *log.fingerprints],
    )  # fmt: skip
    places, heard, config = np.arange(0, len(still.fingerprints), 40), still.fingerprints, RadioSlamConfig()
    tracemalloc.start()
    try:
        assert radio_cue.prepared("wifi", heard, still.travel_m, places, still.odometry[places], config)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 40e6


def test_the_strongest_closure_of_each_pair_of_segments_is_kept():
    travel = np.arange(0.0, 100.0, 2.0)
    i, j, s = np.array([0, 1, 20]), np.array([30, 31, 45]), np.array([0.8, 0.9, 0.7])
    assert sorted(radio_closures.strongest_per_cell(i, j, s, travel, 6.0).tolist()) == [1, 2]
    one_place, alike = np.zeros(4, int), np.array([1, 4, 2, 3])
    kept = radio_closures.strongest_per_place(one_place, one_place, alike, 2)
    assert kept.tolist() == [False, True, False, True]


def test_closures_are_similar_distant_along_the_path_and_unique_per_pair_of_segments():
    travel = np.arange(0.0, 100.0, 2.0)
    similarity = np.full((50, 50), 0.1)
    similarity[0, 30], similarity[1, 31], similarity[20, 45], similarity[10, 14] = 0.8, 0.9, 0.75, 0.95
    model = SimilarityModel(np.array([0.7, 0.9]), np.array([6.0, 2.0]), np.array([4.0, 1.0]), np.array([50, 50]), 60.0)
    found = radio_closures.closures(similarity, travel, model, 0.7, 30.0, 6.0, 5)
    assert found.pairs.tolist() == [[1, 31], [20, 45]]
    assert found.distance_m == pytest.approx([2.0, 5.0]) and found.variance_m2 == pytest.approx([1.0, 3.25])


def test_the_weight_of_rssi_differences_scales_with_their_unit():
    random = np.random.default_rng(3)
    places = np.column_stack([np.linspace(0.0, 40.0, 80), np.zeros(80)])
    feature = 50.0 + places @ random.normal(0.0, 1.0, (2, 12)) + random.normal(0.0, 2.0, (80, 12))
    told, tenfold = (radio_field.learn_weight(scale * feature, places, places[:, 0], 6.0) for scale in (1.0, 10.0))
    assert told == pytest.approx(100.0 * tenfold, rel=1e-3) and 0.01 < told < 1.0


def test_a_path_is_accepted_only_if_readings_fit_it_better_than_the_odometry():
    log, truth = made_log()
    right = between(truth[:-1], truth[1:])
    solver = _Solver(dataclasses.replace(log, motions=right, turned_rad=right[:, 2]), RadioSlamConfig(), ("wifi",))
    bent = poses_along(right + [0.0, 0.0, 0.002])[solver._places]
    assert solver._rank_agreement(bent) > ORDER_MIN and not solver._improves_on_odometry(bent)
    drifted = _Solver(log, RadioSlamConfig(), ("wifi",))
    assert drifted._improves_on_odometry(between(truth[0], truth)[drifted._places])


def test_signal_strength_fields_recover_a_displacement():
    random = np.random.default_rng(0)
    grid = np.stack(np.meshgrid(np.arange(0.0, 12.0, 1.5), np.arange(0.0, 12.0, 1.5)), axis=-1).reshape(-1, 2)
    slopes = random.normal(0, 1.0, (40, 2))
    feature = 50 + grid @ slopes.T
    shifted = grid.copy()
    shifted[27] += (1.0, -0.5)  # the estimated position
    travel = 100.0 * np.arange(len(grid))
    found = radio_field.field_constraints(feature, shifted, travel, 4.0, 30.0, 0.1)
    mine = found.pairs[:, 1] == 27
    target = shifted[found.pairs[mine, 0]] + found.offset_m[mine]
    assert target == pytest.approx(np.tile(grid[27], (mine.sum(), 1)), abs=0.35)


def test_poses_between_corrected_ones_are_interpolated():
    path = np.column_stack([np.arange(5.0), np.zeros(5), np.zeros(5)])
    moved = spread(path, np.arange(5.0), np.array([0, 4]), np.array([[0, 0, 0], [4.0, 2.0, 0.0]]))
    assert moved[:, 1] == pytest.approx([0.0, 0.5, 1.0, 1.5, 2.0])


@pytest.mark.parametrize("not_heard", [100.0, 0.0])
def test_a_fingerprint_of_what_was_not_heard_is_refused(not_heard):
    prints = [Fingerprint(np.arange(3), np.array([-50.0, not_heard, -60.0]))] * 2
    with pytest.raises(DataError, match=f"a strength of {not_heard:g} dBm: leave out what was not heard"):
        RadioLog(np.zeros((1, 3)), np.zeros(1), prints)


def test_fingerprints_without_the_sign_of_dbm_are_refused():
    prints = [Fingerprint(np.arange(2), np.array([50.0, 60.0]))] * 2
    with pytest.raises(DataError, match="fingerprint 0 has strengths from 50 to 60: give dBm, such as -67"):
        RadioLog(np.zeros((1, 3)), np.zeros(1), prints)
