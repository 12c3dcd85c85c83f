"""Colours: told apart with colour blindness, one meaning each, and texts that can be read."""

import itertools

import numpy as np
import pytest

from twc_env.exploration.drawing import palette
from twc_env.pictures.style import TEAMS

# Matrices for linear RGB at full severity: Machado, Oliveira and Fernandes, IEEE TVCG 15(6), 2009.
SIGHT = {
    "normal": np.eye(3),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
}
APART = 16.0
"""Least distance in CIELAB; 2.3 is just noticeable (Mahy et al., 1994)."""


FLOORS_APART = 7.0
"""The same of floors, which are pale so that texts on them can be read: three times what is just noticeable."""


def linear(colour: str) -> np.ndarray:
    share = palette.rgb(colour) / 255
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def lab(light: np.ndarray) -> np.ndarray:
    xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]) @ light
    x, y, z = (v ** (1 / 3) if v > 0.008856 else 7.787 * v + 16 / 116 for v in xyz / [0.9505, 1.0, 1.089])
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def distance(a: str, b: str, sight: str) -> float:
    first, second = (lab(np.clip(SIGHT[sight] @ linear(colour), 0, 1)) for colour in (a, b))
    return float(np.linalg.norm(first - second))


def contrast(a: str, b: str) -> float:
    """WCAG 2.1, 1.4.3."""
    low, high = sorted(float(linear(colour) @ [0.2126, 0.7152, 0.0722]) for colour in (a, b))
    return (high + 0.05) / (low + 0.05)


def test_distances_and_contrasts_are_those_of_the_standards():
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)
    assert distance("#000000", "#ffffff", "normal") == pytest.approx(100.0, abs=0.1)
    assert distance("#ff0000", "#00a000", "deuteranopia") < 0.6 * distance("#ff0000", "#00a000", "normal")


@pytest.mark.parametrize("sight", SIGHT)
def test_colours_of_different_meaning_are_told_apart(sight):
    pairs = itertools.combinations(palette.MEANINGS.items(), 2)
    near = {(a, b): round(distance(first, second, sight), 1) for (a, first), (b, second) in pairs}
    assert {pair: away for pair, away in near.items() if away < APART} == {}


@pytest.mark.parametrize("sight", SIGHT)
def test_colours_of_teams_are_told_apart(sight):
    pairs = list(itertools.combinations(TEAMS, 2))
    assert {pair: distance(*pair, sight) for pair in pairs if distance(*pair, sight) < APART} == {}


@pytest.mark.parametrize("sight", SIGHT)
def test_floors_of_the_maps_of_eight_robots_are_told_apart(sight):
    floors = [palette.hex_of(palette.tinted_floor(robot)) for robot in range(8)]
    pairs = list(itertools.combinations([*floors, palette.UNKNOWN], 2))
    assert min(distance(*pair, sight) for pair in pairs) > FLOORS_APART


def test_no_colour_has_two_meanings():
    assert len(set(palette.MEANINGS.values())) == len(palette.MEANINGS)


def test_texts_have_the_contrast_that_wcag_asks_for():
    grounds = [palette.FLOOR, palette.UNKNOWN]
    grounds += [palette.hex_of(palette.tinted_floor(k)) for k in range(len(palette.ROBOTS))]
    for text, ground in itertools.product((palette.INK, palette.TRUE_TEXT), grounds):
        assert contrast(text, ground) >= 4.5, (text, ground)


def test_walls_and_closures_stand_out_as_wcag_asks_of_graphics():
    for colour in (palette.WALL, palette.TRUE_WALL, palette.CLOSURE):
        assert contrast(colour, palette.FLOOR) >= 3.0
