"""The style of all pictures, for those who draw their own: one palette, one legend, files of any format.

from twc_env.pictures.style import legend_below, new_figure, robot_colour, save_figure, style

with style():
    figure = new_figure((6, 4))
    axes = figure.add_subplot()
    ...
    legend_below(figure, *axes.get_legend_handles_labels())
    save_figure(figure, "coverage.pdf")
"""

from __future__ import annotations

from twc_env.exploration.drawing.figures import (
    DPI,
    FORMATS,
    fit_height,
    legend_below,
    new_figure,
    save_figure,
    set_title,
    settle,
    style,
)
from twc_env.exploration.drawing.labels import place_names
from twc_env.exploration.drawing.palette import (
    CLOSURE,
    FLOOR,
    INK,
    MEANINGS,
    PERSON,
    ROBOTS,
    SIGNAL_MAP,
    TRUE_TEXT,
    TRUE_WALL,
    UNKNOWN,
    WALL,
    robot_colour,
)

TEAMS = ROBOTS
"""Colours of teams or methods in one figure, where no robots are; with more, lines are dashed."""
BAND_OPACITY = 0.16
"""Of intervals around a curve."""

__all__ = [
    "BAND_OPACITY", "CLOSURE", "DPI", "FLOOR", "FORMATS", "INK", "MEANINGS", "PERSON", "ROBOTS", "SIGNAL_MAP", "TEAMS",
    "TRUE_TEXT", "TRUE_WALL", "UNKNOWN", "WALL", "fit_height", "legend_below", "new_figure", "place_names",
    "robot_colour", "save_figure", "set_title", "settle", "style",
]  # fmt: skip
