"""Pictures of a leaderboard: coverage over time, and performance profiles (matplotlib, extra `viz`)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from twc_env.agents.roster import display_name
from twc_env.pictures.curves import MERGED
from twc_env.pictures.style import INK, TEAMS, TRUE_WALL, legend_below, new_figure, save_figure
from twc_env.suite.entries import REFERENCES
from twc_env.suite.standings import THRESHOLDS, Standings
from twc_env.suite.tables import title_of

REFERENCE_STYLE: dict[str, tuple[str, Any]] = {"random": (TRUE_WALL, "dotted"), "informed": (INK, "dashed")}
"""Colour and line of the teams with the scores 0 and 1."""
LINES = "solid", "dashdot", (0, (1, 1)), (0, (4, 1, 1, 1, 1, 1))
"""Of other teams: when all colours are taken, they begin again with the next kind of line."""
COLUMNS = 2
PANEL_IN = (3.4, 2.4)
"""Small, so that their print can be read where a page is as wide as the picture."""
DPI = 200


def draw_curves(standings: Standings, path: Path, dpi: float | None = None) -> None:
    """Floor in a correctly merged map over time, one panel per task: mean over buildings with its 95 % interval."""
    figure, panels = _panels(len(standings.tasks))
    for panel, task in zip(panels, standings.tasks, strict=True):
        for team in standings.teams:
            colour, line = _style(team, standings.teams)
            curve = standings.curves[task][team]
            panel.plot(curve["time_s"], curve["mean"], ls=line, color=colour, lw=1.6, label=display_name(team))
            if all(map(math.isfinite, curve["low"])):
                panel.fill_between(curve["time_s"], curve["low"], curve["high"], color=colour, alpha=0.15, lw=0)
        panel.set(title=title_of(task), ylim=(0, 1.02), xlim=(0, curve["time_s"][-1]))
    for k, panel in enumerate(panels):
        if k % COLUMNS == 0:
            panel.set_ylabel(MERGED)
        if k + COLUMNS >= len(panels):
            panel.set_xlabel("simulated time [s]")
    _finish(figure, panels, path, dpi)


def draw_profiles(standings: Standings, path: Path, dpi: float | None = None) -> None:
    """Performance profiles: the share of episodes that score above a threshold, averaged over tasks, with its 95 %
    interval."""
    figure, panels = _panels(1, (6.8, 4.2))
    (panel,) = panels
    for team in standings.teams:
        colour, line = _style(team, standings.teams)
        profile = standings.profiles[team]
        panel.step(THRESHOLDS, profile["share"], ls=line, where="mid", color=colour, lw=1.6, label=display_name(team))
        if all(map(math.isfinite, profile["low"])):
            band = {"step": "mid", "color": colour, "alpha": 0.12, "lw": 0}
            panel.fill_between(THRESHOLDS, profile["low"], profile["high"], **band)
    what = "normalised score" if standings.is_normalised else "area under the coverage curve (not normalised)"
    panel.set(xlabel=f"threshold of the {what}", ylabel="share of the episodes above it", ylim=(0, 1.02))
    panel.set_xlim(0, THRESHOLDS[-1] if standings.is_normalised else 1.0)
    _finish(figure, panels, path, dpi)


def _style(team: str, teams: Sequence[str]) -> tuple[str, Any]:
    """Colour and line of a team; as many as there are colours times LINES differ."""
    if team in REFERENCE_STYLE:
        return REFERENCE_STYLE[team]
    number = [name for name in teams if name not in REFERENCES].index(team)
    return TEAMS[number % len(TEAMS)], LINES[number // len(TEAMS) % len(LINES)]


def _panels(count: int, size_in: tuple[float, float] = PANEL_IN) -> tuple[Any, list[Any]]:
    columns = min(count, COLUMNS)
    rows = math.ceil(count / columns)
    figure = new_figure((size_in[0] * columns, size_in[1] * rows), DPI)
    grid = figure.subplots(rows, columns, squeeze=False)
    panels = list(grid.ravel())
    for panel in panels[count:]:
        panel.set_visible(False)
    for panel in panels[:count]:
        panel.grid(alpha=0.3)
        panel.spines[["top", "right"]].set_visible(False)
    return figure, panels[:count]


def _finish(figure: Any, panels: list[Any], path: Path, dpi: float | None) -> None:
    handles, labels = panels[0].get_legend_handles_labels()
    legend = legend_below(figure, handles, labels)
    width_in, height_in = figure.get_size_inches()
    legend_in = legend.get_window_extent(figure.canvas.get_renderer()).height / figure.dpi
    figure.set_size_inches(width_in, height_in + legend_in)
    save_figure(figure, path, dpi or DPI)
