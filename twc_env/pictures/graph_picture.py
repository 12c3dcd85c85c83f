"""The picture of an optimised pose graph: before and after, accepted and rejected closures. Needs matplotlib."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.exploration.drawing.palette import CLOSURE, INK, ROBOTS, TRUE_TEXT
from twc_env.pictures.style import legend_below, new_figure, save_figure, set_title, settle, style
from twc_env.records.planar_graph import PlanarGraph
from twc_env.slam.graph_optimisation.whole_graph import OptimisedGraph

ACCEPTED, REJECTED, ODOMETRY, LANDMARK = CLOSURE, ROBOTS[3], TRUE_TEXT, ROBOTS[2]
"""No robots are drawn here, so their colours are free."""
TITLE_GAP = 0.025
"""Room between the title and the panels, as a share of the height."""
FAINT_FROM = 200
"""So many lines of a kind are drawn fainter the more there are."""


def draw_graph(graph: PlanarGraph, result: OptimisedGraph, path: Path) -> None:
    """Write the picture. Raises ConfigError without matplotlib."""
    with style():
        save_figure(graph_figure(graph, result), path)


def graph_figure(graph: PlanarGraph, result: OptimisedGraph) -> Any:
    """The picture as a figure; to be called, and saved, within `style()`."""
    figure = new_figure((14.0, 7.4), 110)
    panels = figure.subplots(1, 2)
    for axes, poses, places, title in (
        (panels[0], result.start, graph.landmarks_m, "before"),
        (panels[1], result.poses, result.landmarks_m, "after"),
    ):
        _draw(axes, graph, result, poses, places)
        axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
        axes.set_title(title)
    closures = ~graph.is_odometry
    kept = int((result.accepted & closures).sum())
    text = f"{len(result.poses)} poses, {kept} of {int(closures.sum())} closures accepted"
    reasons = [reason for trust in result.trust for reason in trust.reasons]
    if reasons:
        text = f"LOST: {reasons[0]}" + (f" (and {len(reasons) - 1} more)" if len(reasons) > 1 else "")
    set_title(figure, [text])
    legend_below(figure, *panels[1].get_legend_handles_labels())
    figure.get_layout_engine().set(rect=(0, 0, 1, 1 - TITLE_GAP))
    settle(figure)
    return figure


def _draw(axes, graph: PlanarGraph, result: OptimisedGraph, poses: Array, places_m: Array) -> None:
    from matplotlib.collections import LineCollection

    closures = ~graph.is_odometry
    for mask, colour, width, label, order in (
        (closures & ~result.accepted, REJECTED, 0.8, "rejected closures", 1),
        (closures & result.accepted, ACCEPTED, 1.0, "accepted closures", 2),
        (graph.is_odometry, ODOMETRY, 0.9, "odometry", 3),
    ):
        count = int(mask.sum())
        if not count:
            continue
        shade = 1.0 if colour == ODOMETRY else max(0.12, min(1.0, FAINT_FROM / count))
        lines = poses[graph.edges[mask], :2]
        axes.add_collection(LineCollection(list(lines), colors=colour, linewidths=width, alpha=shade, zorder=order))
        axes.plot([], [], color=colour, label=f"{label} ({count})")
    axes.plot(*poses[:, :2].T, ".", color=ODOMETRY, markersize=2 if len(poses) < 3000 else 1, zorder=3)
    if len(graph.held):
        axes.plot(*poses[graph.held, :2].T, "s", color=INK, markersize=5, zorder=5, label="held (FIX)")
    if len(places_m) and np.isfinite(places_m).any():
        axes.plot(*places_m.T, "^", color=LANDMARK, markersize=4, zorder=4, label=f"landmarks ({len(places_m)})")
    axes.autoscale_view()
