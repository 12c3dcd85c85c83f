import numpy as np
import pytest

from twc_env.slam.radio.building_axes import STD_RAD, BuildingAxes

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
