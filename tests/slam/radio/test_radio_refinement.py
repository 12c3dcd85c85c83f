import numpy as np
import pytest

from twc_env.metrics.trajectory import absolute_trajectory_error_m
from twc_env.records.geometry import between, poses_along
from twc_env.slam.odometry.odometry_calibration import Motions
from twc_env.slam.radio.building_axes import BuildingAxes
from twc_env.slam.radio.radio_evidence import FieldEvidence
from twc_env.slam.radio.radio_refinement import _QuadraticModel, jacobian, refined

RANDOM = np.random.default_rng(4)
ANGLES = np.linspace(0.0, 4 * np.pi, 80)
PATH = np.column_stack([18 * np.cos(ANGLES), 12 * np.sin(ANGLES), ANGLES + np.pi / 2])
MOTIONS = between(PATH[:-1], PATH[1:])
TRUTH = poses_along(MOTIONS)
BOXES = RANDOM.uniform(-30, 30, (40, 2)) + TRUTH[:, :2].mean(axis=0)
AWAY_M = np.linalg.norm(TRUTH[:, None, :2] - BOXES, axis=2)
HEARD = np.maximum(65 - 30 * np.log10(np.maximum(AWAY_M, 1.0)) + RANDOM.normal(size=AWAY_M.shape), 0.0)


def test_the_gradient_by_motions_follows_from_that_by_positions():
    slopes = jacobian(TRUTH)
    for motion, axis in ((0, 2), (30, 0), (60, 1), (78, 2)):
        step = np.zeros_like(MOTIONS)
        step[motion, axis] = 1e-5
        ahead, behind = (poses_along(MOTIONS + sign * step)[:, :2] for sign in (1, -1))
        assert slopes[:, :, motion, axis] == pytest.approx((ahead - behind) / 2e-5, abs=1e-5)


@pytest.mark.parametrize("noise", [0.5, 2.0])
def test_the_closed_form_gaussian_of_a_path_is_correct(noise):
    random = np.random.default_rng(2)
    places, motions = 5, 4
    slopes, missed = random.normal(size=(places, 2, motions, 3)), random.normal(size=(motions, 3))
    variance, causes = random.uniform(0.5, 2.0, (motions, 3)), random.normal(size=(2, motions, 3))
    by_place, root = random.normal(size=(places, 2)), random.normal(size=(10, 10))
    told = root @ root.T + np.eye(10)
    view = _QuadraticModel(slopes, missed, variance, causes, by_place, told.reshape(places, 2, places, 2))
    slopes, causes = slopes.reshape(10, 12), causes.reshape(2, 12)
    before = np.diag(noise**2 * variance.ravel()) + causes.T @ causes
    pull = slopes.T @ (told @ slopes @ missed.ravel() + by_place.ravel())
    likeliest = np.linalg.solve(slopes.T @ told @ slopes + np.linalg.inv(before), pull)
    assert view.maximum(noise).ravel() == pytest.approx(likeliest, rel=1e-5, abs=1e-6)
    both = np.eye(10) + told @ slopes @ before @ slopes.T
    assert view.volume(noise) == pytest.approx(0.5 * np.linalg.slogdet(both)[1], rel=1e-6)


def test_radio_reduces_the_noise_of_a_path():
    std = np.array([0.05, 0.05, 0.02])
    noisy = MOTIONS + std * RANDOM.normal(size=MOTIONS.shape)
    before = poses_along(noisy)
    information = np.tile(np.diag(1.0 / std**2), (len(noisy), 1, 1))
    after = refined(before, Motions(noisy, noisy[:, 2]), information, [FieldEvidence(HEARD)]).poses
    errors = [absolute_trajectory_error_m(poses, TRUTH) for poses in (before, after)]
    assert errors[1] < 0.5 * errors[0]


def test_the_scale_of_a_map_is_corrected_to_that_of_the_odometry():
    information = np.tile(np.diag([400.0, 400.0, 2500.0]), (len(MOTIONS), 1, 1))
    small = TRUTH * [0.85, 0.85, 1.0]
    after = refined(small, Motions(MOTIONS, MOTIONS[:, 2]), information, [FieldEvidence(HEARD)])
    assert np.ptp(after.poses[:, 0]) == pytest.approx(np.ptp(TRUTH[:, 0]), rel=0.02)
    errors = [absolute_trajectory_error_m(poses, TRUTH) for poses in (small, after.poses)]
    assert errors[1] < 0.1 * errors[0]
    nothing = refined(TRUTH, Motions(MOTIONS, MOTIONS[:, 2]), information, [], BuildingAxes(0.0))
    assert nothing.misfit == pytest.approx(0.0, abs=1e-6)


def test_the_path_that_explains_the_readings_fits_better():
    information = np.tile(np.diag([400.0, 400.0, 2500.0]), (len(MOTIONS), 1, 1))
    other = np.random.default_rng(1).permutation(HEARD)
    right, wrong = (
        refined(TRUTH, Motions(MOTIONS, MOTIONS[:, 2]), information, [FieldEvidence(heard)]).misfit
        for heard in (HEARD, other)
    )
    assert right < wrong


def test_motion_along_walls_keeps_the_heading_of_a_map():
    """Corridors at right angles with noisy RSSI, and noisy odometry."""
    random, corners = np.random.default_rng(5), np.repeat([0, 1, 1, 0, 1, 1], 2)
    turns = np.where(np.arange(120) % 10 == 9, np.tile(corners, 10) * np.pi / 2, 0.0)
    motions = np.column_stack([np.full(120, 3.0), np.zeros(120), turns])
    truth = poses_along(motions)
    away = np.linalg.norm(truth[:, None, :2] - 2 * BOXES, axis=2)
    heard = np.maximum(65 - 30 * np.log10(np.maximum(away, 1.0)) + 6 * random.normal(size=away.shape), 0.0)
    std = np.array([0.05, 0.05, 0.03])
    noisy = motions + std * random.normal(size=motions.shape)
    information = np.tile(np.diag(1.0 / std**2), (len(noisy), 1, 1))
    free, held = (
        refined(poses_along(noisy), Motions(noisy, noisy[:, 2]), information, [FieldEvidence(heard)], axes).poses
        for axes in (BuildingAxes(0.0), BuildingAxes())
    )
    errors = [np.linalg.norm(poses[:, :2] - truth[:, :2], axis=1).mean() for poses in (free, held)]
    assert errors[1] < 0.8 * errors[0]


@pytest.mark.parametrize("noise", [0.2, 3.0])
def test_the_odometry_noise_is_estimated_from_the_readings(noise):
    std = np.array([0.05, 0.05, 0.02])
    random = np.random.default_rng(11)
    noisy = MOTIONS + noise * std * random.normal(size=MOTIONS.shape)
    information = np.tile(np.diag(1.0 / std**2), (len(noisy), 1, 1))
    found = refined(poses_along(noisy), Motions(noisy, noisy[:, 2]), information, [FieldEvidence(HEARD)]).noise
    assert noise / 3 < found < 3 * noise
