"""Coverage over time of several teams, as means with bands (matplotlib, extra `viz`)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.metrics.team_scores import mean_interval
from twc_env.pictures.style import BAND_OPACITY, TEAMS, legend_below, new_figure, save_figure, set_title, style

SAMPLES = 101
"""Points of a curve, from the beginning of an episode to its longest time."""
SIZE_IN = (6.4, 4.2)


def sampled(steps: Array, values: Array, steps_max: int) -> list[float]:
    """A coverage, known at these steps and constant in between, at `SAMPLES` points from 0 to steps_max; the last value
    holds to the end."""
    at = np.searchsorted(steps, np.linspace(0, steps_max, SAMPLES) + 1e-9, side="right") - 1
    return [round(float(value), 6) for value in np.where(at < 0, 0.0, np.asarray(values, float)[np.maximum(at, 0)])]


def coverage_figure(curves: Mapping[str, Any], time_max_s: float, title: str) -> Any:
    """A figure of curves (episodes, samples) by name: their means, and the 95 % intervals of these."""
    times_s = np.linspace(0.0, time_max_s, SAMPLES)
    with style():
        figure = new_figure(SIZE_IN)
        axes = figure.add_subplot(xlabel="simulated time [s]", ylabel="floor mapped correctly [%]")
        axes.set(ylim=(0, 102), xlim=(0, time_max_s))
        axes.grid(alpha=0.3, lw=0.6)
        axes.spines[["top", "right"]].set_visible(False)
        for number, (name, values) in enumerate(curves.items()):
            curve = 100 * np.asarray(values, float)
            low, high = mean_interval(curve)
            colour, line = TEAMS[number % len(TEAMS)], ("-", "--", ":")[number // len(TEAMS) % 3]
            axes.plot(times_s, curve.mean(axis=0), line, color=colour, lw=1.8, label=f"{name} ({len(curve)})")
            if np.isfinite(low).all():
                axes.fill_between(times_s, low, high, color=colour, alpha=BAND_OPACITY, lw=0)
        set_title(figure, [title])
        legend_below(figure, *axes.get_legend_handles_labels())
    return figure


def draw_coverage(
    curves: Mapping[str, Any], time_max_s: float, path: Path, title: str, dpi: float | None = None
) -> Path:
    """Write the figure, whose title says what the bands are; returns its path."""
    has_bands = any(len(values) > 1 for values in curves.values())
    told = f"{title}: mean and its 95 % interval; in brackets the number of episodes" if has_bands else title
    return save_figure(coverage_figure(curves, time_max_s, told), path, dpi)
