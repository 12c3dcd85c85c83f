"""Names in pictures that never cover each other: adjustText moves them apart, and those without room are left out."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.exploration.drawing.palette import FLOOR, TRUE_TEXT

MOVES_MAX = 40
"""Rounds in which names are moved apart; not seconds, so that a picture is the same on every machine."""

PADDING = 1.0
"""Pixels that stay free around a name."""
GAP = 10.0
"""Pixels between a place and its name."""
LEAD_POINTS = 9.0
"""A name farther away than this from its place gets a line to it."""


def place_names(
    axes: Any, names: Sequence[str], places_m: Array, facing_rad: Sequence[float], taken: Sequence[Any] = (),
    avoided_m: Any = (), points: float = 5.5,
) -> list[Any]:  # fmt: skip
    """Write names in front of their places (k, 2), in a figure that is laid out; returns the texts that remain.

    facing_rad: direction of the free side of each place. taken: texts that are there already and stay. avoided_m:
    points (n, 2) to leave free. A name that would still cover another text, or leave the axes, is left out.
    """
    from adjustText import adjust_text
    from matplotlib.patheffects import withStroke

    if not len(names):
        return []
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
        x, y = np.vstack([places_m, np.asarray(avoided_m, float).reshape(-1, 2)]).T
        adjust_text(
            texts, x=x, y=y, ax=axes, objects=list(taken) or None, iter_lim=MOVES_MAX, ensure_inside_axes=True,
            expand=(1.06, 1.2), force_text=(0.2, 0.5), force_static=(0.02, 0.05), max_move=8,
        )  # fmt: skip
    kept = _without_overlaps(axes, texts, taken)
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


def _without_overlaps(axes: Any, texts: Sequence[Any], taken: Sequence[Any]) -> list[Any]:
    """Remove texts that cover an earlier one or leave the axes."""
    renderer, frame = axes.figure.canvas.get_renderer(), axes.get_window_extent()
    boxes = [text.get_window_extent(renderer) for text in taken]
    kept = []
    for text in texts:
        box = text.get_window_extent(renderer)
        is_inside = frame.x0 <= box.x0 and box.x1 <= frame.x1 and frame.y0 <= box.y0 and box.y1 <= frame.y1
        if not is_inside or any(box.overlaps(other) for other in boxes):
            text.remove()
            continue
        boxes.append(box.padded(PADDING))
        kept.append(text)
    return kept
