import dataclasses

import numpy as np
import pytest

from tests.real_data import needs_data
from twc_env.datasets.logs.scan_log import apart
from twc_env.reproduce.logs.laser_logs import LOGS, corrected_log
from twc_env.reproduce.radio.radio_twins import PLACES, true_path
from twc_env.slam.radio.building_axes import LENGTH_M, STD_RAD, BuildingAxes

RANDOM = np.random.default_rng(3)


def places_along(direction_rad, length_m=4.0):
    steps = length_m * np.column_stack([np.cos(direction_rad), np.sin(direction_rad)])
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])


CORRIDORS = places_along(0.3 + 0.5 * np.pi * RANDOM.integers(0, 4, 60) + STD_RAD * RANDOM.normal(size=60))
ANYHOW = places_along(RANDOM.uniform(-np.pi, np.pi, 60))


def test_the_share_of_motion_along_walls_is_estimated():
    assert BuildingAxes().fitted(CORRIDORS).share > 0.9
    assert BuildingAxes().fitted(ANYHOW).share < 0.4


def test_the_likelihood_is_invariant_to_rotations_of_the_building():
    c, s = np.cos(0.7), np.sin(0.7)
    turned = CORRIDORS @ np.array([[c, s], [-s, c]])
    assert BuildingAxes().cost(turned) == pytest.approx(BuildingAxes().cost(CORRIDORS), abs=1e-6)
    _, information = BuildingAxes(0.9).slopes(CORRIDORS)
    swing = np.column_stack([-CORRIDORS[:, 1], CORRIDORS[:, 0]]).ravel()
    assert np.abs(information.reshape(122, 122) @ swing).max() < 1e-6 * np.abs(information).max()


def test_the_gradient_is_that_of_the_cost():
    axes = BuildingAxes(0.8)
    by_place, _ = axes.slopes(CORRIDORS)
    for place, axis in ((0, 0), (17, 1), (60, 0)):
        step = np.zeros_like(CORRIDORS)
        step[place, axis] = 1e-5
        ahead, behind = (axes.cost(CORRIDORS + sign * step) for sign in (1, -1))
        assert by_place[place, axis] == pytest.approx(-(ahead - behind) / 2e-5, rel=1e-3, abs=1e-4)


def test_axes_with_a_share_of_zero_have_no_effect():
    none = BuildingAxes(0.0).fitted(CORRIDORS)
    assert none.share == 0.0
    assert none.cost(CORRIDORS) == 0.0
    assert not any(part.any() for part in none.slopes(CORRIDORS))


def fitted_to(path):
    """The share of a path (n, 3) along axes and its deviation [deg], fitted together; at least one degree, or a few
    segments exactly on an axis would decide."""
    places, axes = path[apart(path, LENGTH_M), :2], BuildingAxes()
    for _ in range(100):
        deviation, probability, _ = axes._fit_axis(places)
        rms_rad = np.sqrt((probability * deviation**2).sum() / max(probability.sum(), 1e-12))
        axes = dataclasses.replace(axes.fitted(places), std_rad=max(float(rms_rad), np.radians(1.0)))
    return axes.share, float(np.degrees(axes.std_rad))


def test_share_and_deviation_of_a_made_path_are_found():
    random = np.random.default_rng(0)
    on_axis = 0.4 + np.pi / 2 * random.integers(0, 4, 3000) + np.radians(4.0) * random.normal(size=3000)
    heading = np.where(random.random(3000) < 0.7, on_axis, random.uniform(-np.pi, np.pi, 3000))
    path = np.cumsum(3.0001 * np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)
    assert fitted_to(np.column_stack([path, heading])) == pytest.approx((0.7, 4.0), abs=0.5)
    assert fitted_to(np.column_stack([path, heading]))[0] == pytest.approx(0.7, abs=0.05)


@needs_data
def test_paths_of_robots_stray_as_the_prior_says_and_scripted_walks_by_less():
    logs = [fitted_to(corrected_log(name).poses)[1] for name in LOGS]
    assert np.median(logs) == pytest.approx(np.degrees(STD_RAD), abs=0.2)
    assert all(fitted_to(true_path(place, 0))[1] < min(logs) for place in PLACES.values())
