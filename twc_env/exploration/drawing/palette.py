"""Colours of all pictures: each has one meaning, and all can be told apart with colour blindness.

Robots have the hues of Okabe and Ito ("Color Universal Design", 2008) that are not needed elsewhere, and three dark or
reddish ones; what is true of the building is grey, what is estimated is black on white, closures are violet, people
yellow. Robots are numbered wherever there is room, and closures differ by line style, so that no statement rests on
colour alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

ROBOTS = ("#0072b2", "#d55e00", "#009e73", "#e69f00", "#56b4e9", "#3b1f8f", "#7a2e0e", "#ee0044")
"""Of robots 0, 1, ..., and of the floor of groups, by their first robot; with more robots they repeat."""
TRUE_WALL = "#858c98"
TRUE_TEXT = "#434a56"
"""Signs, access points and their names; all texts have a contrast of 4.5 or more to floor and unknown space."""
WALL = "#14181f"
FLOOR = "#ffffff"
UNKNOWN = "#e9ebee"
CLOSURE = "#aa00ff"
PERSON = "#f0e442"
ANY_ROBOT = TRUE_WALL
"""Samples of legends that stand for all robots; black ones would look like single wall cells."""
INK = "#1f2430"
"""Titles, axes and captions."""
MEANINGS = {
    **{f"robot {k}": colour for k, colour in enumerate(ROBOTS)},
    "true wall": TRUE_WALL, "sign": TRUE_TEXT, "wall": WALL, "floor": FLOOR, "closure": CLOSURE, "person": PERSON,
}  # fmt: skip
"""What each colour stands for."""
TINTS = (0.22, 0.21, 0.3, 0.26, 0.5, 0.33, 0.36, 0.35)
"""Share of a robot's colour in the floor of its group, while the team has several maps: those by which eight floors are
told apart best, and texts on them can be read."""
SIGNAL_MAP = "viridis"
"""Colour map of signal strength, from weak to strong."""
SIGNAL = ("#440154", "#3b528b", "#21918c", "#5ec962", "#fde725")
"""Five colours of it."""


def rgb(colour: str) -> Array:
    """(3,) float64, 0 to 255, of #rrggbb."""
    return np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)], np.float64)


def hex_of(colour: Array) -> str:
    """#rrggbb of a colour (3,) from 0 to 255."""
    return "#" + bytes(np.round(colour).astype(np.uint8)).hex()


def robot_colour(robot: int) -> str:
    """The colour of a robot."""
    return ROBOTS[robot % len(ROBOTS)]


def tinted_floor(robot: int) -> Array:
    """(3,) float64, 0 to 255: the floor of the group whose first robot this is."""
    share = TINTS[robot % len(TINTS)]
    return (1 - share) * rgb(FLOOR) + share * rgb(robot_colour(robot))
