"""The learning curve of a run as a picture, with lines for scripted teams."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from .references import TEAMS

COLOURS = {"random": "0.6", "information-gain": "tab:orange", "informed": "tab:green"}


def draw_curve(folder: Path, means: Mapping[str, float], title: str) -> Path | None:
    """Write curve.png from metrics.csv; returns its path, None without matplotlib (extra `viz`) or rows.

    means: of `references`.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        return None
    with (folder / "metrics.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["mean_coverage"] != "nan"]
    if not rows:
        return None
    decisions, values = (np.array([float(row[key]) for row in rows]) for key in ("decisions", "mean_coverage"))
    figure = Figure(figsize=(7.0, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.plot(decisions, values, color="tab:blue", label="in training (last 100 episodes)")
    for team, mean in means.items():
        axes.axhline(mean, color=COLOURS[team], linestyle="--", label=f"{TEAMS[team]}, validation: {mean:.3f}")
    axes.set(xlabel="decisions", ylabel="mapped floor, mean over time", title=title)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, loc="lower right")
    path = folder / "curve.png"
    figure.savefig(path, dpi=110)
    return path
