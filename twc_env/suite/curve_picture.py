"""The learning curve of a run as a picture, with lines for scripted teams."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from twc_env.suite.references import TEAMS

SIZE_IN = (6.4, 4.2)
FEW = 10
"""Points of a curve up to which each is marked."""


def draw_curve(folder: Path, means: Mapping[str, float], title: str) -> Path | None:
    """Write curve.png from metrics.csv; returns its path, None without matplotlib (extra `viz`) or rows.

    means: of `references`.
    """
    if find_spec("matplotlib") is None:
        return None
    with (folder / "metrics.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["mean_coverage"] != "nan"]
    if not rows:
        return None
    from twc_env.pictures import style as pictures

    decisions, values = (np.array([float(row[key]) for row in rows]) for key in ("decisions", "mean_coverage"))
    lines = {"random": (pictures.TRUE_WALL, ":"), "information-gain": (pictures.TEAMS[1], "--")}
    with pictures.style():
        figure = pictures.new_figure(SIZE_IN)
        axes = figure.add_subplot(xlabel="decisions", ylabel="floor mapped, mean over time [%]")
        mark = "o" if len(rows) <= FEW else ""  # a line through one point would be seen as none at all
        label = f"in training, last {min(int(rows[-1]['episodes']), 100)} episodes"
        axes.plot(decisions, 100 * values, color=pictures.TEAMS[0], lw=1.8, marker=mark, clip_on=False, label=label)
        for team, mean in means.items():
            colour, line = lines.get(team, (pictures.INK, "--"))
            axes.axhline(100 * mean, color=colour, ls=line, lw=1.4, label=f"{TEAMS[team]}: {100 * mean:.1f} %")
        axes.set(ylim=(0, 102), xlim=(0, decisions[-1]))
        axes.grid(alpha=0.3, lw=0.6)
        axes.spines[["top", "right"]].set_visible(False)
        pictures.set_title(figure, [title, "lines: scripted teams in validation buildings"])
        pictures.legend_below(figure, *axes.get_legend_handles_labels())
    return pictures.save_figure(figure, folder / "curve.png")
