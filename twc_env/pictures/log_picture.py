"""Maps and paths of a replayed log as a picture: one panel for each map, in metres. Needs matplotlib."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import DataError
from twc_env.exploration.drawing.palette import robot_colour
from twc_env.records.geometry import travelled_m
from twc_env.records.messages import GridMap
from twc_env.records.whole_file import whole_file
from twc_env.replaying.run import groups_by_size

if TYPE_CHECKING:
    from twc_env.replaying.run import Replay

FORMATS = ("png", "pdf", "svg")
PANELS_MAX = 6
"""Maps that are drawn, the largest first."""
SIGNS_MAX = 80
_LETTER_SHARE = 0.007
"""Width of a letter as a share of that of the picture."""
_WIDTH_INCHES, _HEIGHT_MAX_INCHES, _MARGIN_M = 11.0, 14.0, 1.0


def draw_log(replay: Replay, paths: list[Path]) -> list[Path]:
    """Draw the maps with paths and closures to files of the formats that their names tell; returns them.

    Raises DataError without matplotlib, or if a file cannot be written.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise DataError("a picture of the map needs matplotlib; run `pip install 'twc_env[viz]'`") from error
    team, robots = replay.engine.team, replay.paths()
    groups = groups_by_size(team)
    drawn = [g for g in groups if team.grid_of(g).log_odds.size][:PANELS_MAX] or groups[:1]
    columns = min(len(drawn), 2 if len(drawn) > 1 else 1)
    rows = math.ceil(len(drawn) / columns)
    boxes = [_box(team.grid_of(group)) for group in drawn]
    aspect = max((box[3] - box[2]) / (box[1] - box[0]) for box in boxes)
    height = min(max(rows * aspect * _WIDTH_INCHES / columns, 3.0) + 1.0, _HEIGHT_MAX_INCHES)
    figure = Figure(figsize=(_WIDTH_INCHES, height), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)
    for number, (group, box) in enumerate(zip(drawn, boxes, strict=True), 1):
        axes = figure.add_subplot(rows, columns, number)
        _draw_map(axes, team.grid_of(group))
        _draw_closures(axes, replay, group)
        own = [path for path in robots if team.group_index(path.robot) == group]
        for path in own:
            colour = robot_colour(path.robot)
            length_m = travelled_m(path.estimated)[-1]
            label = f"{path.name or f'robot {path.robot}'}, {length_m:.0f} m"
            axes.plot(*path.estimated[:, :2].T, color=colour, linewidth=1.0, label=label)
            axes.plot(*path.estimated[0, :2], "o", color=colour, markersize=5, markeredgecolor="white")
            axes.plot(*path.estimated[-1, :2], "s", color=colour, markersize=5, markeredgecolor="white")
        _name_signs(axes, [(sign.text, sign.position_m) for sign in team.signs_of(group)], box)
        axes.set(xlim=box[:2], ylim=box[2:], aspect="equal", xlabel="x [m]", ylabel="y [m]")
        title = f"map {number}" if len(drawn) > 1 else "map"
        axes.set_title(f"{title}: {_free_m2(team.grid_of(group)):,.0f} m² of floor seen", fontsize=10)
        if own:
            axes.legend(loc="upper right", fontsize=7, framealpha=0.9)
    figure.supxlabel("dot: start, square: end, green: accepted loop closures", fontsize=8)
    for file in paths:
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            with whole_file(file) as beside:
                figure.savefig(beside, format=file.suffix[1:], metadata=_METADATA[file.suffix[1:]])
        except OSError as error:
            raise DataError(
                f"cannot write the picture {file}: {error.strerror or error}; choose another place"
            ) from error
    return paths


_METADATA: dict[str, dict] = {"png": {"Software": None}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}
"""No dates: equal logs give equal files."""


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


def _draw_map(axes, grid: GridMap) -> None:
    """Walls dark, floor white, unknown cells grey."""
    if not grid.log_odds.size:
        return
    shown = np.where(grid.log_odds > 0, 0.12, np.where(grid.log_odds < 0, 1.0, 0.86))
    (left, low), (right, top) = grid.origin_m, grid.origin_m + np.array(shown.shape[::-1]) * grid.resolution_m
    axes.set_facecolor("0.86")
    axes.imshow(
        shown, cmap="gray", vmin=0, vmax=1, origin="lower", extent=(left, right, low, top), interpolation="none"
    )


def _name_signs(axes, signs: list[tuple[str, Array]], box: tuple[float, float, float, float]) -> None:
    """Write the texts of signs; one that would cover an earlier one is left out."""
    taken: list[tuple[float, float, float]] = []
    letter_m = _LETTER_SHARE * (box[1] - box[0])
    for text, (x, y) in signs:
        width, line = letter_m * len(text), 2.0 * letter_m
        if len(taken) < SIGNS_MAX and not any(abs(y - v) < line and u - width < x < u + w for u, v, w in taken):
            taken.append((float(x), float(y), width))
            axes.plot(x, y, ".", color="tab:purple", markersize=3)
            axes.annotate(text, (float(x), float(y)), fontsize=6, color="tab:purple", parse_math=False, clip_on=True)


def _draw_closures(axes, replay: Replay, group: int) -> None:
    from matplotlib.collections import LineCollection

    team = replay.engine.team
    own = set(team.groups[group].robots)
    lines = [
        [team.segment_path(robot)[0][index][:2] for robot, index in (c.candidate.target, c.candidate.source)]
        for c in team.closures
        if c.status == "accepted" and {c.candidate.target[0], c.candidate.source[0]} <= own
    ]
    axes.add_collection(LineCollection(lines, colors="tab:green", linewidths=0.5, alpha=0.6))
