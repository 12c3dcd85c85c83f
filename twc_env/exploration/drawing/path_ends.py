"""Where paths start and end, in figures: a plus, then a disc for a true pose and a ring for an estimated one, as in
films."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray as Array

from twc_env.exploration.drawing.palette import ANY_ROBOT, FLOOR


def mark_ends(axes: Any, path_m: Array, colour: str, is_true: bool) -> None:
    """Mark the start and the end of a path (steps, 2)."""
    axes.plot(*path_m[0], zorder=5, **_start(colour))
    axes.plot(*path_m[-1], zorder=5, **_end(colour, is_true))


def end_entries(is_true: bool) -> list[tuple[Any, str]]:
    """Entries of a legend for `mark_ends`; no wall has their colour, as a single wall cell is a disc too."""
    from matplotlib.lines import Line2D

    last = f"{'true' if is_true else 'estimated'} pose at the end"
    return [(Line2D([], [], **_start(ANY_ROBOT)), "start"), (Line2D([], [], **_end(ANY_ROBOT, is_true)), last)]


def _start(colour: str) -> dict[str, Any]:
    return {"ls": "", "marker": "P", "ms": 7, "color": colour, "mec": FLOOR, "mew": 0.7}


def _end(colour: str, is_true: bool) -> dict[str, Any]:
    look = {"color": colour, "mec": FLOOR, "mew": 0.6} if is_true else {"mfc": FLOOR, "mec": colour, "mew": 1.3}
    return {"ls": "", "marker": "o", "ms": 6, **look}
