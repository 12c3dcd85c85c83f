"""Angles and directions of compiled loops, against the mathematical library."""

import math

import numpy as np
import pytest

from twc_env.kernels.angles import angle_of, turn_evenly, wrapped


def test_an_angle_is_that_of_the_mathematical_library():
    random = np.random.default_rng(0)
    points = random.normal(size=(2000, 2)) * 10.0 ** random.uniform(-6, 6, (2000, 1))
    points = np.concatenate([points, random.integers(-2, 3, (200, 2)), points[:500] * [1.0, 1e-9]])
    found = np.array([angle_of(x, y) for x, y in points])
    assert np.abs(found - np.arctan2(points[:, 1], points[:, 0])).max() < 1e-15


@pytest.mark.parametrize("step", [0.0, -math.pi / 2, 2 * math.pi / 1081, 0.7])
def test_directions_turn_evenly_and_only_where_they_are_asked_for(step):
    found = np.full((2, 1081), 9.0)
    turn_evenly(-2.3, step, 3, 1079, found[0], found[1])
    angles = -2.3 + step * np.arange(1077)
    assert np.abs(found[:, 3:-1] - [np.cos(angles), np.sin(angles)]).max() < 2e-13
    assert (found[:, [0, 1, 2, -1]] == 9.0).all()


def test_a_wrapped_angle_is_within_half_a_turn():
    assert [wrapped(angle) for angle in (3.0, 4.0, -4.0, 7.0)] == pytest.approx(
        [3.0, 4.0 - 2 * math.pi, 2 * math.pi - 4.0, 7.0 - 2 * math.pi]
    )
