"""Strokes of walls: straight, equally thick, closed over gaps between beams, and open at doors."""

import numpy as np
import pytest

from twc_env.exploration.drawing.primitives import OUTSIDE, raise_to_strokes
from twc_env.exploration.drawing.smooth_map import wall_strokes

FINER = 8


def drawn(log_odds):
    """Which of 8 x 8 small cells per cell are drawn as wall."""
    field = np.full((FINER * log_odds.shape[0], FINER * log_odds.shape[1]), OUTSIDE)
    strokes = FINER * wall_strokes(log_odds)
    strokes[:, :4] -= 0.5
    raise_to_strokes(field, strokes)
    return field > 0


def room_below(row=20, size=60):
    """Free floor below a row, unknown from it on."""
    log_odds = np.zeros((40, size), np.int16)
    log_odds[:row] = -10
    return log_odds


def is_closed(image, first, last):
    """Whether each column of small cells between two cells, both centres included, has wall."""
    return image[:, FINER * first + FINER // 2 : FINER * last + FINER // 2].any(axis=0).all()


@pytest.mark.parametrize("apart", [2, 3, 4, 5])
def test_a_wall_that_few_beams_hit_is_drawn_without_gaps(apart):
    log_odds = room_below()
    log_odds[20, 5:46:apart] = 8
    image = drawn(log_odds)
    assert (
        is_closed(image, 5, np.flatnonzero(log_odds[20] > 0)[-1])
        and not image[:, : FINER * 5].any()
        and not image[: FINER * 20 - 1].any()
    )


def test_a_gap_is_closed_in_turned_cells_too():
    log_odds = np.zeros((40, 60), np.int16)
    columns = np.arange(5, 50, 3)
    log_odds[(5 + 0.37 * columns).round().astype(int), columns] = 8
    assert is_closed(drawn(log_odds), 5, 47)


@pytest.mark.parametrize(("gap", "is_known"), [(7, True), (7, False), (4, True)])
def test_doors_and_openings_known_as_free_stay_open(gap, is_known):
    log_odds = room_below()
    log_odds[20, 5:45] = 8
    log_odds[20, 25 : 25 + gap] = -10 if is_known else 0
    image = drawn(log_odds)
    assert is_closed(image, 5, 24) and is_closed(image, 25 + gap, 44)
    assert not image[:, FINER * 25 + 1 : FINER * (25 + gap) - 1].any()


def test_one_or_two_missing_cells_within_a_wall_are_no_opening():
    log_odds = room_below()
    log_odds[20, 5:45] = 8
    log_odds[20, 25], log_odds[20, 30:32] = -10, -10
    assert is_closed(drawn(log_odds), 5, 44)


@pytest.mark.parametrize("turn_rad", [0.0, 0.1, 0.3, 0.6, np.pi / 4])
@pytest.mark.parametrize("thickness", [1.0, 2.0])
def test_a_straight_wall_is_drawn_straight_and_equally_thick(turn_rad, thickness):
    rows, columns = np.mgrid[0:120, 0:120] + 0.5
    along = (columns - 60) * np.cos(turn_rad) + (rows - 60) * np.sin(turn_rad)
    across = (rows - 60) * np.cos(turn_rad) - (columns - 60) * np.sin(turn_rad)
    is_wall = (np.abs(across + 0.01) <= 0.5 * thickness) & (np.abs(along) < 45)
    image = drawn(np.where(is_wall, 20, -20).astype(np.int16))
    v, u = np.nonzero(image)
    x, y = (u + 0.5) / FINER - 60, (v + 0.5) / FINER - 60
    along, across = x * np.cos(turn_rad) + y * np.sin(turn_rad), y * np.cos(turn_rad) - x * np.sin(turn_rad)
    parts = [across[np.abs(along - at) < 0.5] for at in range(-35, 36)]
    assert np.std([part.mean() for part in parts]) < 0.1
    widths = [np.ptp(part) for part in parts]
    assert np.std(widths) < 0.12 and np.mean(widths) == pytest.approx(thickness, abs=0.45)


def test_walls_are_as_thick_at_corners_as_elsewhere():
    log_odds = np.full((50, 50), -10, np.int16)
    log_odds[10:40, 10], log_odds[10, 10:40] = 8, 8
    image = drawn(log_odds)
    assert image[FINER * 10 - 2 : FINER * 12].sum(axis=0)[FINER * 13 : FINER * 38].max() <= 1.2 * FINER


def test_a_single_cell_is_a_small_square_and_every_wall_cell_is_drawn():
    log_odds = np.full((30, 30), -10, np.int16)
    log_odds[7, 12] = 8
    image = drawn(log_odds)
    v, u = np.nonzero(image)
    assert v.min() == FINER * 7 and v.max() == FINER * 8 - 1 and u.min() == FINER * 12 and u.max() == FINER * 13 - 1
    assert image.sum() > 0.9 * FINER**2  # a disc has 0.79
    random = np.where(np.random.default_rng(0).random((40, 40)) < 0.1, 8, -10).astype(np.int16)
    covered = drawn(random).reshape(40, FINER, 40, FINER).any(axis=(1, 3))
    near = np.pad(covered, 1)
    near = np.any([near[r : r + 40, c : c + 40] for r in range(3) for c in range(3)], axis=0)
    assert near[random > 0].all()
