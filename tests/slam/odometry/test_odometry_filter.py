from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twc_env.config import OdometryFilterConfig
from twc_env.records.geometry import compose, wrap_angle
from twc_env.slam.odometry.filterpy_filter import FilterpyFilters
from twc_env.slam.odometry.filters import make_filters
from twc_env.slam.odometry.odometry_filter import CompiledFilters

DT_S = 0.1
CONFIG = OdometryFilterConfig()


class Single:
    """The filter of the second of two robots; the state of the first must never change."""

    def __init__(self, kind, config):
        self._filters, self._robots = kind(config, 2), np.array([1])

    @property
    def state(self) -> np.ndarray:
        assert not self._filters.states[0].any()
        return self._filters.states[1]

    @property
    def covariance(self) -> np.ndarray:
        return self._filters.covariances[1]

    def predict(self, odometry, turn_rate_rad_s, dt_s) -> None:
        self._filters.predict(self._robots, odometry[None], np.array([turn_rate_rad_s]), np.array([dt_s]))

    def update(self, pose, information, is_clear=False) -> bool:
        is_matched, poses = np.ones(2, bool), np.stack([pose, pose])
        self._filters.update(
            self._robots, poses, np.stack([information, information]), is_matched, np.array([True, is_clear])
        )
        return bool(is_matched[1])


BOTH = pytest.mark.parametrize("kind", [partial(Single, CompiledFilters), partial(Single, FilterpyFilters)])


SHARP = np.diag([1e4, 1e4, 1e5])
"""Information of a match good to 1 cm and 0.2 degrees."""


def random_information(random) -> np.ndarray:
    root = random.normal(0, 1, (3, 3)) * (0.05, 0.05, 0.02)
    return np.linalg.inv(root @ root.T + np.diag([1e-4, 1e-4, 1e-5]))


@settings(max_examples=8)
@given(st.integers(0, 10_000))
def test_the_compiled_filter_equals_filterpy_over_two_hundred_steps(seed):
    random = np.random.default_rng(seed)
    compiled, oracle = Single(CompiledFilters, CONFIG), Single(FilterpyFilters, CONFIG)
    for step in range(200):
        odometry = random.normal(0, 1, 3) * (0.1, 0.03, 0.15)
        turn_rate = odometry[2] / DT_S + random.normal(0, 0.2)
        dt_s = random.uniform(0.05, 0.2)
        compiled.predict(odometry, turn_rate, dt_s)
        oracle.predict(odometry, turn_rate, dt_s)
        if step % 3 == 0:
            pose = compiled.state[:3] + random.normal(0, 0.05, 3)
            pose[2] = wrap_angle(pose[2])
            information = random_information(random)
            is_clear = bool(random.random() < 0.5)
            assert compiled.update(pose, information, is_clear) == oracle.update(pose, information, is_clear)
        assert compiled.state == pytest.approx(oracle.state, abs=1e-9)
        assert compiled.covariance == pytest.approx(oracle.covariance, abs=1e-9)


@BOTH
def test_perfect_odometry_is_integrated_exactly(kind):
    random, ekf, true = np.random.default_rng(3), kind(CONFIG), np.zeros(3)
    for _ in range(300):
        motion = random.normal(0, 1, 3) * (0.1, 0.02, 0.15)
        ekf.predict(motion, motion[2] / DT_S, DT_S)
        true = compose(true, motion)
        assert ekf.state[:2] == pytest.approx(true[:2], abs=1e-9)
    assert wrap_angle(ekf.state[2] - true[2]) == pytest.approx(0.0, abs=1e-9)
    assert ekf.state[3:5] == pytest.approx(np.zeros(2), abs=1e-9)


@BOTH
def test_the_gyro_bias_is_estimated_from_the_odometry(kind):
    random, bias = np.random.default_rng(1), 0.03
    ekf = kind(CONFIG)
    for _ in range(600):
        turn = random.normal(0, 0.05)
        odometry = np.array([0.05, 0.0, turn + random.normal(0, CONFIG.odometry_turn_std_rad)])
        ekf.predict(odometry, turn / DT_S + bias + random.normal(0, CONFIG.turn_std_rad / DT_S), DT_S)
    assert ekf.state[3] == pytest.approx(bias, abs=3 * np.sqrt(ekf.covariance[3, 3]))
    assert np.sqrt(ekf.covariance[3, 3]) < 0.6 * CONFIG.gyro_bias_std_rad_s


@BOTH
def test_the_gyro_bias_is_estimated_from_measured_poses(kind):
    bias, true = 0.03, np.zeros(3)
    ekf = kind(CONFIG)
    for _ in range(400):
        motion = np.array([0.05, 0.0, 0.02])
        true = compose(true, motion)
        ekf.predict(motion, 0.02 / DT_S + bias, DT_S)
        ekf.update(true, SHARP)
    assert ekf.state[3] == pytest.approx(bias, abs=0.004)
    assert np.hypot(*(ekf.state[:2] - true[:2])) < 0.02


@BOTH
@pytest.mark.parametrize("too_long", [0.04, -0.03, 0.0])
def test_the_odometry_scale_is_estimated_in_rooms_and_used_in_corridors(kind, too_long):
    random, ekf, true = np.random.default_rng(4), kind(CONFIG), np.zeros(3)
    for step in range(600):
        motion = np.array([0.05, 0.0, 0.03 if step < 400 else 0.0])
        true = compose(true, motion)
        read = motion * (1.0 + too_long, 1.0, 1.0) + random.normal(0, 1, 3) * (0.002, 0.001, 0.005)
        ekf.predict(read, motion[2] / DT_S, DT_S)
        if step < 400:
            ekf.update(true + random.normal(0, 1, 3) * (0.01, 0.01, 0.003), SHARP)
    assert ekf.state[4] == pytest.approx(1.0 - 1.0 / (1.0 + too_long), abs=3 * np.sqrt(ekf.covariance[4, 4]))
    assert np.sqrt(ekf.covariance[4, 4]) == pytest.approx(CONFIG.position_std_per_m / np.sqrt(20.0), rel=0.05), (
        "in 20 m"
    )
    assert np.hypot(*(ekf.state[:2] - true[:2])) < 0.12, "10 m without a match"


@BOTH
def test_walls_first_seen_at_the_end_of_a_corridor_do_not_confirm_the_scale(kind):
    ekf, random = kind(CONFIG), np.random.default_rng(3)
    for step in range(401):
        ekf.predict(np.array([0.1, 0.0, 0.0]), 0.0, DT_S)
        askew = random.normal(0.0, 0.01)
        across = np.array([-np.sin(askew), np.cos(askew)])
        information = SHARP.copy()
        if step < 400:  # walls with slightly wrong directions: no information along the path
            information[:2, :2] = 1e4 * np.outer(across, across)
        ekf.update(ekf.state[:3].copy(), information)
    assert ekf.covariance[4, 4] ** 0.5 == pytest.approx(CONFIG.odometry_scale_std, rel=0.05)
    assert np.linalg.eigvalsh(ekf.covariance)[0] > 0.0


@pytest.mark.parametrize("worse", [1.0, 2.0])
@pytest.mark.parametrize("too_long", [0.02, -0.02])
def test_odometry_noise_does_not_bias_the_scale(too_long, worse):
    """Not even if odometry is worse than the filter assumes."""
    count, random = 200, np.random.default_rng(7)
    filters, robots, true = CompiledFilters(CONFIG, count), np.arange(count), np.zeros((count, 3))
    information, always = np.tile(SHARP, (count, 1, 1)), np.ones(count, bool)
    noise_m = worse * CONFIG.position_std_per_m * np.sqrt(0.05)
    for step in range(400):
        motion = np.tile([0.05, 0.0, 0.03 * np.sin(0.02 * step)], (count, 1))
        true = compose(true, motion)
        read = motion * (1.0 + too_long, 1.0, 1.0)
        read[:, :2] += random.normal(0.0, noise_m, (count, 2))
        filters.predict(robots, read, motion[:, 2] / DT_S, np.full(count, DT_S))
        seen = true + random.normal(0.0, 1.0, (count, 3)) * (0.01, 0.01, 0.003)
        filters.update(robots, seen, information, always.copy(), always)
    error = filters.states[:, 4] - (1.0 - 1.0 / (1.0 + too_long))
    claimed = np.sqrt(filters.covariances[:, 4, 4]).mean()
    assert abs(error.mean()) < 0.7 * claimed
    assert error.std() < 1.1 * worse * claimed


def test_odometry_without_scale_uncertainty_gets_no_scale_estimate():
    ekf, true = Single(CompiledFilters, OdometryFilterConfig(odometry_scale_std=0.0)), np.zeros(3)
    for _ in range(100):
        true = compose(true, [0.05, 0.0, 0.02])
        ekf.predict(np.array([0.06, 0.0, 0.02]), 0.02 / DT_S, DT_S)
        ekf.update(true, SHARP)
    assert ekf.state[4] == 0.0


@BOTH
def test_a_match_that_contradicts_the_prediction_is_rejected(kind):
    ekf = kind(CONFIG)
    for _ in range(60):
        ekf.predict(np.array([0.1, 0.0, 0.0]), 0.0, DT_S)
    before, spread = ekf.state.copy(), ekf.covariance.copy()
    total = spread[:3, :3] + np.linalg.inv(SHARP)
    reach_m = np.sqrt(CONFIG.match_gate / np.linalg.inv(total)[0, 0])
    assert not ekf.update(before[:3] + [1.01 * reach_m, 0.0, 0.0], SHARP)
    assert np.array_equal(ekf.state, before) and np.array_equal(ekf.covariance, spread)
    assert ekf.update(before[:3] + [0.99 * reach_m, 0.0, 0.0], SHARP)
    assert ekf.state[0] - before[0] > 0.8 * reach_m


@BOTH
def test_a_clear_match_that_contradicts_the_prediction_is_a_slip_and_updates_no_other_state(kind):
    ekf = kind(CONFIG)
    for _ in range(60):
        ekf.predict(np.array([0.1, 0.0, 0.0]), 0.0, DT_S)
        ekf.update(ekf.state[:3].copy(), SHARP)
    before, learned = ekf.state.copy(), ekf.covariance[3:, 3:].copy()
    slipped = before[:3] + [-0.4, 0.2, 0.3]
    assert not ekf.update(slipped, SHARP)
    assert ekf.update(slipped, SHARP, is_clear=True)
    assert ekf.state[:3] == pytest.approx(slipped, abs=0.002)
    assert ekf.state[3:] == pytest.approx(before[3:], abs=1e-4)
    assert ekf.covariance[3:, 3:] == pytest.approx(learned, rel=0.2, abs=1e-6)
    assert np.linalg.eigvalsh(ekf.covariance).min() > 0


@BOTH
def test_the_covariance_stays_symmetric_and_positive_definite(kind):
    random, ekf = np.random.default_rng(2), kind(CONFIG)
    for step in range(500):
        ekf.predict(random.normal(0, 0.1, 3), random.normal(0, 1), DT_S)
        if step % 2:
            ekf.update(ekf.state[:3] + random.normal(0, 0.03, 3), random_information(random))
        assert ekf.covariance == pytest.approx(ekf.covariance.T, abs=1e-12)
        assert np.linalg.eigvalsh(ekf.covariance).min() > 0


@BOTH
def test_uncertainty_grows_with_motion_and_shrinks_with_a_match(kind):
    ekf, areas = kind(CONFIG), []
    for _ in range(30):
        ekf.predict(np.array([0.1, 0.0, 0.0]), 0.0, DT_S)
        areas.append(np.linalg.det(ekf.covariance[:3, :3]))
    assert np.all(np.diff(areas) > 0)
    ekf.update(ekf.state[:3].copy(), SHARP)
    assert np.linalg.det(ekf.covariance[:3, :3]) < areas[-1]


@BOTH
@pytest.mark.parametrize("side", [1, -1])
def test_heading_residuals_wrap_at_pi(kind, side):
    ekf = kind(CONFIG)
    for _ in range(31):
        ekf.predict(np.array([0.0, 0.0, 0.1 * side]), side / 1.0, DT_S)
    before = float(ekf.state[2])
    measured = wrap_angle(before + 0.15 * side)
    assert measured * side < 0
    ekf.update(np.array([*ekf.state[:2], measured]), SHARP)
    assert 0.05 < (ekf.state[2] - before) * side < 0.1501


@BOTH
def test_a_measurement_without_information_changes_nothing(kind):
    ekf = kind(CONFIG)
    for _ in range(20):
        ekf.predict(np.array([0.1, 0.0, 0.02]), 0.2, DT_S)
    before, spread = ekf.state.copy(), ekf.covariance.copy()
    ekf.update(before[:3] + [3.0, -2.0, 0.5], np.zeros((3, 3)))
    assert ekf.state == pytest.approx(before, abs=1e-6)
    assert ekf.covariance == pytest.approx(spread, abs=1e-9)


@BOTH
def test_a_corridor_match_corrects_only_across_the_axis(kind):
    ekf = kind(CONFIG)
    for _ in range(60):
        ekf.predict(np.array([0.1, 0.0, 0.0]), 0.0, DT_S)
    before, spread = ekf.state.copy(), ekf.covariance.copy()
    ekf.update(before[:3] + [0.3, 0.2, 0.0], np.diag([0.0, 1e4, 1e5]))
    assert ekf.state[0] == pytest.approx(before[0], abs=1e-4)
    assert ekf.covariance[0, 0] == pytest.approx(spread[0, 0], rel=1e-3)
    assert ekf.state[1] - before[1] > 0.15
    assert ekf.covariance[1, 1] < 0.2 * spread[1, 1]


@pytest.mark.parametrize("kind", [CompiledFilters, FilterpyFilters])
def test_an_update_does_not_modify_the_measurement(kind):
    filters, robots = kind(CONFIG, 1), np.zeros(1, np.int64)
    poses, information = np.array([[0.1, 0.0, 3.0]]), np.diag([100.0, 100.0, 100.0])[None]
    filters.predict(robots, np.array([[0.1, 0.0, 0.0]]), np.zeros(1), np.full(1, DT_S))
    filters.update(robots, poses, information, np.ones(1, bool), np.zeros(1, bool))
    assert poses.tolist() == [[0.1, 0.0, 3.0]]
    assert np.array_equal(information[0], np.diag([100.0, 100.0, 100.0]))


def test_the_config_selects_the_filter():
    assert isinstance(make_filters(OdometryFilterConfig(backend="compiled"), 1), CompiledFilters)
    assert isinstance(make_filters(OdometryFilterConfig(backend="filterpy"), 1), FilterpyFilters)
