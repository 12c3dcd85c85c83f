"""Coverage over time of several teams, as means with bands (matplotlib, extra `viz`)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.metrics.team_scores import mean_interval
from twc_env.pictures.style import BAND_OPACITY, INK, TEAMS, legend_below, new_figure, save_figure, set_title, style

SAMPLES = 101
"""Points of a curve, from the beginning of an episode to its longest time."""
FEW = 5
"""With fewer episodes than this the legend says of how many the interval is: it hardly tells anything."""
SIZE_IN = (6.4, 4.2)
MERGED, MAPPED = "floor in a correctly merged map", "floor mapped correctly"
"""What curves show: the `coverage` of the rewards, or `coverage_correct` of reports (docs/figures.md)."""


def sampled(steps: Array, values: Array, steps_max: int) -> list[float | None]:
    """A coverage, known at these steps and constant in between, at `SAMPLES` points from 0 to steps_max; the last value
    holds to the end, and before the first one it is None."""
    at = np.searchsorted(steps, np.linspace(0, steps_max, SAMPLES) + 1e-9, side="right") - 1
    return [None if k < 0 else round(float(values[k]), 6) for k in at]


def coverage_figure(curves: Mapping[str, Any], time_max_s: float, title: str, what: str = MERGED) -> Any:
    """A figure of curves (episodes, samples) by name: their means, and the 95 % intervals of these, from where all
    episodes are known."""
    times_s = np.linspace(0.0, time_max_s, SAMPLES)
    with style():
        from matplotlib.patches import Patch

        figure = new_figure(SIZE_IN)
        axes = figure.add_subplot(xlabel="simulated time [s]", ylabel=f"{what} [%]")
        axes.set(ylim=(0, 102), xlim=(0, time_max_s))
        axes.grid(alpha=0.3, lw=0.6)
        axes.spines[["top", "right"]].set_visible(False)
        for number, (name, values) in enumerate(curves.items()):
            curve = 100 * np.asarray(values, float)
            is_known = np.isfinite(curve).all(axis=0)
            shown, at_s = curve[:, is_known], times_s[is_known]
            colour, line = TEAMS[number % len(TEAMS)], ("-", "--", ":")[number // len(TEAMS) % 3]
            axes.plot(at_s, shown.mean(axis=0), line, color=colour, lw=1.8, label=f"{name} ({_episodes(len(curve))})")
            if len(curve) > 1:
                low, high = mean_interval(shown)
                axes.fill_between(at_s, low, high, color=colour, alpha=BAND_OPACITY, lw=0)
        handles, names = axes.get_legend_handles_labels()
        if counts := [len(values) for values in curves.values() if len(values) > 1]:
            handles.append(Patch(color=INK, alpha=BAND_OPACITY, lw=0))
            names.append(f"95 % interval of {'the mean' if min(counts) >= FEW else _episodes(min(counts))}")
        set_title(figure, [title])
        legend_below(figure, handles, names)
    return figure


def _episodes(count: int) -> str:
    return f"{count} episode{'s' * (count != 1)}"


def draw_coverage(
    curves: Mapping[str, Any], time_max_s: float, path: Path, title: str, dpi: float | None = None, what: str = MERGED
) -> Path:
    """Write the figure; returns its path."""
    return save_figure(coverage_figure(curves, time_max_s, title, what), path, dpi)
