"""Walls are drawn from few beams and from noisy ranges, and only where there are walls."""

import numpy as np
import pytest

from twc_env.config.range_noise import RangeNoise
from twc_env.slam.matching.scan_matching import LineField, scan_points

RANGE_MAX_M = 10.0


def drawn(ranges_m, noise_m=0.0):
    field = LineField(24.0, 0.1, RANGE_MAX_M, RangeNoise(noise_m))
    field.add(np.zeros((1, 3)), ranges_m[None])
    return field


@pytest.mark.parametrize("beams", [36, 60, 90, 180])
def test_walls_of_a_wide_room_are_drawn_with_few_beams(scan, walls, beams):
    room = walls((-6, -5), (6, -5), (6, 5), (-6, 5))
    points = scan_points(scan(room, np.zeros(3), 720), RANGE_MAX_M)
    assert drawn(scan(room, np.zeros(3), beams)).share_near(points, np.zeros(3), 0.1) > 0.85


def test_no_wall_is_drawn_between_distant_end_points(scan, walls):
    posts = np.concatenate([walls((4.0, y), (4.3, y), (4.3, y + 0.3), (4.0, y + 0.3)) for y in (-0.6, 0.3)])
    field, between = LineField(24.0, 0.1, RANGE_MAX_M), np.pi / 36
    field.add(np.array([[0.0, 0.0, between]]), scan(posts, (0.0, 0.0, between), 36)[None])
    assert field.share_near(np.array([[4.0, 0.0], [4.0, 0.3]]), np.zeros(3), 0.2) == 0.0


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("noise_m", [0.01, 0.03, 0.05])
def test_walls_are_drawn_straight_despite_range_noise(scan, walls, noise_m, seed):
    corridor = walls((-20, -1), (20, -1), (20, 1), (-20, 1))
    ranges_m = scan(corridor, np.zeros(3))
    field = drawn(np.maximum(ranges_m + np.random.default_rng(seed).normal(0, noise_m, 180), 0.01), noise_m)
    askew = np.array([field.facing_at((x, 1.0), (x, 0.0)) for x in np.arange(-1.8, 1.9, 0.1)]) + 0.5 * np.pi
    assert np.rad2deg(np.sqrt(np.nanmean(askew**2))) < 10.0


@pytest.mark.parametrize("per_m", [0.0175, 0.03])
def test_no_wall_lies_across_a_corridor_where_noise_grows_with_range(scan, walls, per_m):
    """Far walls of a scanner such as LDS-01 are twice as noisy as typical ones, whose limits would cut them into pieces
    of any direction."""
    corridor, noise = walls((-20, -1.2), (20, -1.2), (20, 1.2), (-20, 1.2)), RangeNoise(0.005, per_m, 1.75)
    exact_m, askew_rad = scan(corridor, np.zeros(3), 360), []
    for seed in range(20):
        std_m = np.hypot(noise.std_m, noise.per_m * np.minimum(exact_m, 3.5))
        ranges_m = np.maximum(exact_m + np.random.default_rng(seed).normal(0.0, std_m), 0.01)
        field = LineField(24.0, 0.1, 3.5, noise)
        field.add(np.zeros((1, 3)), np.where(ranges_m < 3.5, ranges_m, np.inf)[None])
        askew_rad += [field.facing_at((x, 1.2), (x, 0.0)) + 0.5 * np.pi for x in np.arange(-3.2, 3.3, 0.1)]
    askew = np.abs(askew_rad)
    assert np.isfinite(askew).mean() > 0.8
    assert np.nanmean(askew > 0.5) == 0.0 and np.sqrt(np.nanmean(askew**2)) < 0.04
