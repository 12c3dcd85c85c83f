"""Maps and paths of a replayed log as a picture: one panel for each map, in metres. Needs matplotlib."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import ConfigError, DataError
from twc_env.exploration.drawing.episode_map import draw_smoothly
from twc_env.exploration.drawing.labels import place_names
from twc_env.exploration.drawing.palette import CLOSURE, FLOOR, TRUE_TEXT, UNKNOWN, WALL, rgb, robot_colour
from twc_env.exploration.drawing.path_ends import end_entries, mark_ends
from twc_env.pictures.style import legend_below, new_figure, save_figure, set_title, settle, style
from twc_env.records.messages import GridMap
from twc_env.replaying.run import groups_by_size
from twc_env.slam.places.text_similarity import text_similarity

if TYPE_CHECKING:
    from twc_env.replaying.run import Replay

PANELS_MAX = 6
"""Maps that are drawn, the largest first."""
SIGNS_MAX = 80
SIGN_M, ALIKE = 1.0, 0.5
"""Readings of one sign are so close to each other, and so similar (Levenshtein, 0 to 1)."""
_WIDTH_INCHES, _HEIGHT_MAX_INCHES, _MARGIN_M = 11.0, 14.0, 1.0


def draw_log(replay: Replay, path: Path, dpi: float | None = None) -> Path:
    """Draw the maps with paths and closures to a file of the format that its name tells; returns it.

    Raises DataError without matplotlib, or if the file cannot be written.
    """
    try:
        with style():
            figure = _figure(replay)
    except ConfigError as error:
        raise DataError(str(error)) from error
    return save_figure(figure, path, dpi)


def _figure(replay: Replay) -> Any:
    from matplotlib.lines import Line2D

    team = replay.engine.team
    groups = groups_by_size(team)
    drawn = [g for g in groups if team.grid_of(g).log_odds.size][:PANELS_MAX] or groups[:1]
    columns = min(len(drawn), 2)
    rows = math.ceil(len(drawn) / columns)
    boxes = _of_one_scale([_box(team.grid_of(group)) for group in drawn], rows)
    widths = [box[1] - box[0] for box in boxes[:columns]] if rows == 1 else [1.0] * columns
    aspect = max(
        (box[3] - box[2]) / (box[1] - box[0]) * width for box, width in zip(boxes, widths * rows, strict=False)
    )
    height = min(max(rows * aspect * (_WIDTH_INCHES - 0.6 * columns) / sum(widths), 2.5) + 1.4, _HEIGHT_MAX_INCHES)
    figure = new_figure((_WIDTH_INCHES, height))
    spec = figure.add_gridspec(rows, columns, width_ratios=widths)
    panels = [figure.add_subplot(spec[k // columns, k % columns]) for k in range(len(drawn))]
    handles: dict[str, Any] = {}
    for number, (axes, group, box) in enumerate(zip(panels, drawn, boxes, strict=True), 1):
        axes.set(xlim=box[:2], ylim=box[2:], aspect="equal", xlabel="x [m]", ylabel="y [m]", facecolor=UNKNOWN)
        grid = team.grid_of(group)
        draw_smoothly(axes, grid, np.zeros(3), rgb(FLOOR))
        title = f"map {number}" if len(drawn) > 1 else "map"
        paths = _draw_paths(axes, replay, group)
        is_seen = any(team.group_index(robot) == group for robot in range(replay.robots))
        what = "of floor seen" if is_seen else f"of floor, {replay.maps()[groups.index(group)]}"
        axes.set_title(f"{title}: {_free_m2(grid):,.0f} m² {what}")
        handles |= paths
        _draw_closures(axes, replay, group)
    handles = dict(sorted(handles.items())) | {
        "mapped walls": Line2D([], [], color=WALL, lw=2.6),
        **{name: handle for handle, name in end_entries(is_true=False)},
    }
    accepted = sum(closure.status == "accepted" for closure in team.closures)
    if accepted:
        handles["accepted closures"] = Line2D([], [], color=CLOSURE, lw=1.0)
    if any(team.signs_of(group) for group in drawn):
        handles["signs, as read"] = Line2D([], [], ls="", marker="s", color=TRUE_TEXT, ms=3.5)
    robots, maps = _counted(len(replay.paths()), "robot"), _counted(len(groups), "map")
    shown = f", {len(drawn)} shown" if len(drawn) < sum(team.grid_of(g).log_odds.size > 0 for g in groups) else ""
    counts = f"{robots} in {maps}{shown}, {_counted(accepted, 'loop closure')} accepted"
    set_title(figure, [counts])
    legend_below(figure, list(handles.values()), list(handles))
    settle(figure)
    for axes, group in zip(panels, drawn, strict=True):
        _name_signs(axes, [(sign.text, sign.position_m) for sign in team.signs_of(group)])
    return figure


def _counted(count: int, what: str) -> str:
    return f"{count:,} {what}{'s' * (count != 1)}"


def _draw_paths(axes: Any, replay: Replay, group: int) -> dict[str, Any]:
    """Draw the paths of a map's robots; returns lines by name for the legend."""
    lines = {}
    for path in replay.paths():
        name = f"{path.name or f'robot {path.robot}'}, {path.length_m:.0f} m"
        for part in np.unique(path.part[path.group == group]):
            way, colour = path.estimated[(path.part == part) & (path.group == group), :2], robot_colour(path.robot)
            (lines[name],) = axes.plot(*way.T, color=colour, lw=1.2, zorder=3)
            mark_ends(axes, way, colour, is_true=False)
    return lines


def _of_one_scale(boxes: list[tuple[float, float, float, float]], rows: int) -> list[tuple[float, float, float, float]]:
    """Boxes of maps beside each other are made equally high, so that they have the same scale."""
    if rows > 1:
        return boxes
    high = max(box[3] - box[2] for box in boxes)
    more = [(high - (box[3] - box[2])) / 2 for box in boxes]
    return [(left, right, low - m, top + m) for (left, right, low, top), m in zip(boxes, more, strict=True)]


def _box(grid: GridMap) -> tuple[float, float, float, float]:
    """Left, right, low and high end of what is known [m], with a margin."""
    rows, columns = (np.flatnonzero((grid.log_odds != 0).any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return -_MARGIN_M, _MARGIN_M, -_MARGIN_M, _MARGIN_M
    x, y = grid.origin_m
    cell = grid.resolution_m
    return (
        float(x + columns[0] * cell - _MARGIN_M), float(x + (columns[-1] + 1) * cell + _MARGIN_M),
        float(y + rows[0] * cell - _MARGIN_M), float(y + (rows[-1] + 1) * cell + _MARGIN_M),
    )  # fmt: skip


def _free_m2(grid: GridMap) -> float:
    return float((grid.log_odds < 0).sum() * grid.resolution_m**2)


def one_name_per_sign(signs: Sequence[tuple[str, Array]]) -> list[tuple[str, Array]]:
    """Readings of one sign as one: that which is most similar to the others (the median of texts), with their number.

    They are within SIGN_M of the first, and each is at least half like another.
    """
    heaps: list[list[tuple[str, Array]]] = []
    for text, place_m in signs:
        near = (heap for heap in heaps if math.dist(place_m[:2], heap[0][1][:2]) < SIGN_M)
        heap = next((heap for heap in near if max(text_similarity(text, other) for other, _ in heap) >= ALIKE), None)
        if heap is None:
            heaps.append([(text, place_m)])
        else:
            heap.append((text, place_m))
    names = []
    for heap in heaps:
        texts = [text for text, _ in heap]
        best = max(range(len(texts)), key=lambda k: (sum(text_similarity(texts[k], other) for other in texts), -k))
        more = f" (and {len(texts) - 1} like it)" if len(texts) > 1 else ""
        names.append((texts[best] + more, heap[best][1]))
    return names


def _name_signs(axes: Any, signs: list[tuple[str, Array]]) -> None:
    signs = one_name_per_sign(signs)[:SIGNS_MAX]
    if signs:
        places_m = np.array([position_m for _, position_m in signs], float)
        axes.plot(*places_m.T, "s", color=TRUE_TEXT, mec=FLOOR, mew=0.5, ms=4, zorder=5)
        place_names(axes, [text for text, _ in signs], places_m, [np.pi / 2] * len(signs))


def _draw_closures(axes: Any, replay: Replay, group: int) -> None:
    from matplotlib.collections import LineCollection

    team = replay.engine.team
    own = set(team.groups[group].robots)
    paths_m = {segment: team.segment_path(segment)[0][:, :2] for segment in own}
    lines = [
        [paths_m[segment][index] for segment, index in (c.candidate.target, c.candidate.source)]
        for c in team.closures
        if c.status == "accepted" and {c.candidate.target[0], c.candidate.source[0]} <= own
    ]
    axes.add_collection(LineCollection(lines, colors=CLOSURE, linewidths=0.8, zorder=2.5))
