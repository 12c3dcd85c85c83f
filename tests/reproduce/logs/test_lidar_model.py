"""The estimators of `lidar-model` on scans whose figures are known."""

import numpy as np
import pytest

from tests.real_data import needs_data
from twc_env.reproduce.logs import lidar_model
from twc_env.reproduce.logs.lidar_model import changed, interval, no_return, off_map, plan_of, residuals_m, simulated
from twc_env.world.building.floorplan import Floorplan

ANGLES = np.deg2rad(np.arange(180) - 90.0)
ROOM = np.array([[[0, 0], [9, 0]], [[9, 0], [9, 6]], [[9, 6], [0, 6]], [[0, 6], [0, 0]], [[4, 2], [4, 3.5]]], float)
PLAN = Floorplan("room", ROOM, np.zeros(len(ROOM)))
POSES = np.array([[2.0 + 0.15 * k, 1.2 + 0.05 * k, 0.25 * k] for k in range(30)])
EXACT = {"range_noise_std_m": 0.0, "beam_divergence_rad": 0.0, "dark_share": 0.0}


def scans(**changes):
    return simulated(PLAN, ANGLES, POSES, 0, {**EXACT, **changes})


@pytest.fixture(scope="module")
def exact():
    return scans()


def test_the_plan_of_a_log_follows_the_walls_that_it_saw():
    plan = plan_of(scans(range_noise_std_m=0.01), ANGLES, POSES)
    ends = plan.walls_m.reshape(-1, 2)
    sides = [abs(ends[:, 0]), abs(ends[:, 0] - 9), abs(ends[:, 1]), abs(ends[:, 1] - 6), abs(ends[:, 0] - 4)]
    away = np.min(sides, axis=0)
    assert np.quantile(away, 0.9) < 0.05, "the noise of the points, and corners"
    again = simulated(plan, ANGLES, POSES, 0, EXACT)
    both = np.isfinite(again)
    assert both.mean() > 0.95
    assert np.quantile(np.abs(again - scans())[both], 0.9) < 0.05


@pytest.mark.parametrize("noise_m", [0.005, 0.01, 0.02])
def test_the_residual_is_about_the_noise_of_the_scanner(noise_m):
    found = 1.4826 * np.median(np.abs(np.concatenate(residuals_m(scans(range_noise_std_m=noise_m), ANGLES, POSES))))
    assert found == pytest.approx(noise_m, rel=0.35)


def test_the_residual_does_not_count_errors_of_the_poses(exact):
    shaken = POSES + np.random.default_rng(0).normal(0, [0.02, 0.02, 0.005], POSES.shape)
    found = np.concatenate(residuals_m(exact, ANGLES, shaken))
    assert 1.4826 * np.median(np.abs(found)) < 0.02


def test_beams_without_return_points_off_the_map_and_changes_have_their_shares(exact):
    assert np.mean(np.concatenate(no_return(exact, ANGLES, POSES))) == np.mean(~np.isfinite(exact))
    assert np.mean(np.concatenate(off_map(exact, ANGLES, POSES))) < 0.001
    assert np.mean(np.concatenate(changed(exact, ANGLES, POSES))) < 0.01
    random = np.random.default_rng(1)
    is_short = (random.random(exact.shape) < 0.05) & (exact > 1.5)
    shortened = np.where(is_short, exact - random.uniform(0.5, 1.0, exact.shape), exact)
    away = np.concatenate(off_map(shortened, ANGLES, POSES)).mean()
    assert away == pytest.approx(is_short.mean(), rel=0.25)
    assert np.concatenate(changed(shortened, ANGLES, POSES)).mean() == pytest.approx(is_short.mean(), rel=0.4)


def test_the_interval_contains_the_value_and_shrinks_with_the_number_of_scans():
    random = np.random.default_rng(0)
    widths = []
    for scan_count in (200, 3200):
        values = [random.random(50) < 0.1 for _ in range(scan_count)]
        low, high = interval(values, lambda some: float(np.concatenate(some).mean()), 0)
        assert low < 0.1 < high
        widths.append(high - low)
    assert widths[1] < 0.5 * widths[0]


@needs_data
def test_rows_of_a_real_log_have_all_figures(rows_of):
    rows = rows_of(lidar_model, "--logs", "aces", "--scans", "40")
    assert {row["quantity"].partition(", ")[0] for row in rows} == lidar_model.MEASURES.keys()
    assert len(rows) == 3 * len(lidar_model.MEASURES)
    for row in rows:
        assert row["role"] == "reported" and 0.0 <= row["simulated"] < 0.2
        assert row["real"] is None or row["real_low"] <= row["real"] <= row["real_high"]
