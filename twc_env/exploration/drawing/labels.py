"""Names in pictures that cover neither each other nor a mark: adjustText moves them apart, then those that are still in
the way go to the nearest free place before their own mark, or else around it; those without any are left out."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.exploration.drawing.palette import FLOOR, TRUE_TEXT

MOVES_MAX = 40
"""Rounds in which names are moved apart; not seconds, so that a picture is the same on every machine."""

PADDING = 1.0
"""Pixels that stay free around a name."""
MARK = 6.0
"""Half the size of a mark, in pixels."""
RINGS = (0.0, 4.0, 9.0, 16.0, 25.0, 36.0)
"""Distances from a mark at which a name without room is tried [pixels]."""
TURNS = np.pi / 8 * np.array([0, 1, -1, 2, -2, 3, -3]), np.pi / 8 * np.array([4, -4, 5, -5, 6, -6, 7, -7, 8])
"""Directions in which it is tried, first those to the free side: a sign hangs on a wall, which no name should cover."""
GAP = 10.0
"""Pixels between a place and its name."""
LEAD_POINTS = 9.0
"""A name farther away than this from its place gets a line to it."""


def building_name(name: str) -> str:
    """The name of a building in captions: of a file without its folder, of others whole (`gen:ring:300:test/0001`)."""
    return Path(name).name if Path(name).suffix else name


def place_names(
    axes: Any, names: Sequence[str], places_m: Array, facing_rad: Sequence[float], taken: Sequence[Any] = (),
    avoided_m: Any = (), points: float = 5.5,
) -> list[Any]:  # fmt: skip
    """Write names in front of their places (k, 2), in a figure that is laid out; returns the texts that remain.

    facing_rad: direction of the free side of each place. taken: texts that are there already and stay. avoided_m:
    points (n, 2) of other marks. A name that would still cover a text or a mark, or leave the axes, is left out.
    """
    from adjustText import adjust_text
    from matplotlib.patheffects import withStroke

    if not len(names):
        return []
    marks_m = np.vstack([places_m, np.asarray(avoided_m, float).reshape(-1, 2)])
    halo = [withStroke(linewidth=1.6, foreground=FLOOR)]
    renderer, to_data = axes.figure.canvas.get_renderer(), axes.transData.inverted()
    texts = []
    for name, place, angle in zip(names, places_m, facing_rad, strict=True):
        text = axes.text(*place, name, fontsize=points, color=TRUE_TEXT, ha="center", va="center", zorder=6,
                         parse_math=False, path_effects=halo)  # fmt: skip
        box = text.get_window_extent(renderer)
        ahead = np.cos(angle) * (GAP + box.width / 2), np.sin(angle) * (GAP + box.height / 2)
        text.set_position(to_data.transform(axes.transData.transform(place) + ahead))
        texts.append(text)
    if find_spec("adjustText") is not None:
        x, y = marks_m.T
        adjust_text(
            texts, x=x, y=y, ax=axes, objects=list(taken) or None, iter_lim=MOVES_MAX, ensure_inside_axes=True,
            expand=(1.06, 1.2), force_text=(0.2, 0.5), force_static=(0.02, 0.05), max_move=8,
        )  # fmt: skip
    kept = _in_free_places(axes, texts, marks_m, facing_rad, taken)
    for text, place in zip(texts, places_m, strict=True):
        if text in kept:
            _lead(axes, text, place)
    return kept


def _lead(axes: Any, text: Any, place_m: Array) -> None:
    """Draw a line from a name to its place, if they are apart."""
    box = text.get_window_extent(axes.figure.canvas.get_renderer())
    place = axes.transData.transform(place_m)
    nearest = np.clip(place, (box.x0, box.y0), (box.x1, box.y1))
    if np.hypot(*(nearest - place)) > LEAD_POINTS / 72 * axes.figure.dpi:
        ends_m = axes.transData.inverted().transform([place, nearest])
        axes.plot(*ends_m.T, color=TRUE_TEXT, lw=0.5, alpha=0.8, zorder=5.5)


def _in_free_places(
    axes: Any, texts: Sequence[Any], marks_m: Array, facing_rad: Sequence[float], taken: Sequence[Any]
) -> list[Any]:
    """Move texts that cover an earlier one or a mark (n, 2), or leave the axes, to the nearest free place beside their
    own mark, which has the same number; remove those for which there is none."""
    renderer, frame = axes.figure.canvas.get_renderer(), axes.get_window_extent()
    boxes = np.array([_ends(text.get_window_extent(renderer)) for text in taken]).reshape(-1, 2, 2)
    marks = axes.transData.transform(marks_m)
    boxes = np.concatenate([boxes, np.stack([marks - MARK, marks + MARK], axis=1)])
    kept = []
    for number, text in enumerate(texts):
        box = _ends(text.get_window_extent(renderer))
        half_size = 0.5 * np.ptp(box, axis=0)
        for middle in (box.mean(axis=0), *_beside(marks[number], half_size, facing_rad[number])):
            place = middle + 0.5 * (box - box[::-1])
            is_inside = (place[0] >= [frame.x0, frame.y0]).all() and (place[1] <= [frame.x1, frame.y1]).all()
            if is_inside and not ((boxes[:, 0] < place[1]) & (boxes[:, 1] > place[0])).all(axis=1).any():
                text.set_position(axes.transData.inverted().transform(middle))
                boxes = np.concatenate([boxes, [place + [[-PADDING], [PADDING]]]])
                kept.append(text)
                break
        else:
            text.remove()
    return kept


def _ends(box: Any) -> Array:
    """(2, 2) lower left and upper right corner of a box."""
    return np.array([[box.x0, box.y0], [box.x1, box.y1]])


def _beside(mark: Array, half_size: Array, facing_rad: float) -> Iterator[Array]:
    """Middles of boxes of this half size beside a mark, those before it first, then the nearest."""
    for turns, away in itertools.product(TURNS, RINGS):
        for angle in facing_rad + turns:
            direction = np.array([np.cos(angle), np.sin(angle)])
            yield mark + direction * (half_size + MARK + PADDING + away) / np.abs(direction).max()
