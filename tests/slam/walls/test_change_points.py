"""Refinement of the points along a path at which the number of crossed walls changes."""

import numpy as np
import pytest

from twc_env.slam.walls.change_points import refine_changes

STEP_M, LOSS_DB = 0.01, 8.0


def readings(walls, seed):
    """Excess path loss [dB] along a path, with the shadowing and noise of the k-visibility buildings."""
    random = np.random.default_rng(seed)
    keep = np.exp(-STEP_M / 0.5)
    shadowing = np.zeros(len(walls))
    for i in range(1, len(walls)):
        shadowing[i] = keep * shadowing[i - 1] + random.normal(0, 3.0 * np.sqrt(1 - keep**2))
    return LOSS_DB * walls + shadowing + random.normal(0, 3.0, len(walls))


def settled(walls, by_map, seed):
    return refine_changes(by_map, LOSS_DB * by_map, readings(walls, seed), STEP_M * np.arange(len(walls)))


@pytest.mark.parametrize("off", [-12, 9])
def test_a_change_point_moves_to_the_drop_of_the_readings(off):
    walls = (np.arange(600) >= 300).astype(int)
    by_map = (np.arange(600) >= 300 + off).astype(int)
    misses = [np.sum(settled(walls, by_map, seed) != walls) for seed in range(9)]
    assert np.median(misses) <= 2 < abs(off)


def test_a_short_change_is_kept_only_if_the_readings_support_it():
    at = np.arange(600)
    detour = ((at >= 300) & (at < 330)).astype(int)
    none = np.zeros(600, int)
    assert sum(settled(none, detour, seed).max() for seed in range(9)) <= 1
    assert sum(settled(detour, detour, seed).max() for seed in range(9)) >= 8


def test_a_long_change_of_the_map_is_kept():
    long = ((np.arange(600) >= 300) & (np.arange(600) < 400)).astype(int)
    assert all(settled(np.zeros(600, int), long, seed).any() for seed in range(3))


def test_without_readings_the_map_is_unchanged():
    walls = (np.arange(50) >= 20).astype(int)
    assert np.array_equal(refine_changes(walls, LOSS_DB * walls, np.full(50, np.nan), np.arange(50.0)), walls)
