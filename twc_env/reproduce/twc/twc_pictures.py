"""Pictures of maps of TWC-SLAM's scenes: trajectories, merged maps, accepted and rejected closures (papers.md T21)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env import metrics
from twc_env.config import EnvConfig
from twc_env.maps import load_map
from twc_env.pictures.style import INK, ROBOTS, legend_below, new_figure, robot_colour
from twc_env.records.geometry import compose
from twc_env.reproduce.drawing import Kind, save_picture
from twc_env.reproduce.routes import Walk
from twc_env.reproduce.twc.offline_mapping import Matched, OfflineMap, point_cloud, wall_thickness_m
from twc_env.reproduce.twc.twc_scenes import SCENES

METHODS = ("lidar", "text", "wifi", "twc", "fused")
BACKENDS = ("plain", "ours")
MARGIN_M, PANEL_INCHES = 3.0, 4.2
"""Margin around the building, and size of a panel; a folded map may exceed it."""
POINT_STRIDE = 3
"""Point clouds are drawn with every third point."""

Entry = tuple[str, str, list[Matched], OfflineMap]


def draw_scene(scene: str, walks: Sequence[Walk], maps: Sequence[Entry], folder: Path, kind: Kind | None) -> list[Path]:
    """Draw three pictures of one walk, with a row per method and a column per back end; returns their paths."""
    drawings: dict[str, Callable] = {"trajectories": _paths, "maps": _map, "closures": _closures}
    return [
        save_picture(_sheet(scene, walks, maps, draw), folder / f"twc-{scene.lstrip('#')}-{what}", kind)
        for what, draw in drawings.items()
    ]


def _sheet(scene: str, walks: Sequence[Walk], maps: Sequence[Entry], draw: Callable) -> Any:
    plan = load_map(SCENES[scene][0])
    x0, y0, x1, y1 = plan.bounds_m
    height = PANEL_INCHES * (y1 - y0 + 2 * MARGIN_M) / (x1 - x0 + 2 * MARGIN_M) + 0.3
    shown = [name for name in METHODS if any(method == name for method, *_ in maps)]
    figure = new_figure((PANEL_INCHES * len(BACKENDS), height * len(shown) + 0.4), dpi=130)
    panels = figure.subplots(len(shown), len(BACKENDS), squeeze=False)
    for method, backend, matched, built in maps:
        if method not in METHODS or backend not in BACKENDS:
            continue
        axes = panels[shown.index(method), BACKENDS.index(backend)]
        for wall in plan.walls_m:
            axes.plot(wall[:, 0], wall[:, 1], color="0.75", linewidth=0.7, zorder=1)
        title = draw(axes, scene, walks, matched, built)
        axes.set(xlim=(x0 - MARGIN_M, x1 + MARGIN_M), ylim=(y0 - MARGIN_M, y1 + MARGIN_M), aspect="equal")
        axes.set_title(f"{method}, {backend}: {title}", fontsize=8)
        axes.set_xticks([])
        axes.set_yticks([])
    named = {label: line for axes in panels.flat for line, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    if named:
        legend_below(figure, list(named.values()), list(named))
    return figure


def _paths(axes, scene: str, walks: Sequence[Walk], matched: Sequence[Matched], built: OfflineMap) -> str:
    """Draw the path of each robot, its true start, and its estimated start and end."""
    for group in built.groups:
        true = np.concatenate([np.array(walks[robot].poses) for robot in group])
        pose = metrics.align_team(np.concatenate([built.poses[robot] for robot in group]), true)
        for robot in group:
            path = compose(pose, built.poses[robot])
            colour = robot_colour(robot)
            axes.plot(path[:, 0], path[:, 1], color=colour, linewidth=0.9, zorder=2, label=f"robot {robot}")
            axes.plot(*walks[robot].poses[0][:2], "*", markersize=6, color=INK, zorder=3, label="true starts")
            axes.plot(*path[0, :2], "o", markersize=4, color=colour, zorder=4)
            axes.plot(*path[-1, :2], "s", markersize=4, color=colour, zorder=4)
    errors = [metrics.end_point_error_m(p, np.array(w.poses)) for p, w in zip(built.poses, walks, strict=True)]
    return f"EPE {np.mean(errors):.2f} m, {len(built.groups)} map{'s' * (len(built.groups) > 1)}"


def _map(axes, scene: str, walks: Sequence[Walk], matched: Sequence[Matched], built: OfflineMap) -> str:
    """Draw the point cloud of the largest group; errors of the map appear as ghost walls."""
    points_m = point_cloud(walks, built, EnvConfig().lidar.range_max_m)
    axes.plot(points_m[::POINT_STRIDE, 0], points_m[::POINT_STRIDE, 1], ",", color="black", alpha=0.3, zorder=2)
    return f"walls {wall_thickness_m(points_m, load_map(SCENES[scene][0]).walls_m):.2f} m thick"


def _closures(axes, scene: str, walks: Sequence[Walk], matched: Sequence[Matched], built: OfflineMap) -> str:
    """Draw closures between the true poses; what is wrong stands out: false ones believed, right ones refused."""
    counts = {}
    for is_believed, is_right, colour, name in (
        (False, False, "0.82", "false, refused"),
        (True, False, ROBOTS[1], "false, believed"),
        (True, True, ROBOTS[0], "right, believed"),
        (False, True, ROBOTS[3], "right, refused"),
    ):
        shown = [
            m.closure.candidate
            for m, believed in zip(matched, built.accepted, strict=True)
            if believed == is_believed and m.is_right == is_right
        ]
        counts[name] = len(shown)
        ends = [[walks[robot].poses[index][:2] for robot, index in (c.target, c.source)] for c in shown]
        broken = np.array([[*pair, (np.nan, np.nan)] for pair in ends]).reshape(-1, 2)
        order = 2 + is_believed + (is_believed == is_right)
        axes.plot(*broken.T, ".-", color=colour, linewidth=0.6, markersize=2.5, zorder=order, label=name)
    believed = f"{counts['right, believed']} right and {counts['false, believed']} false believed"
    return f"{believed}, {counts['right, refused']} and {counts['false, refused']} refused"


def draw_curves(
    recall: Array, curves: dict[str, dict[str, dict[str, list[float]]]], folder: Path, kind: Kind | None
) -> Path:
    """Draw precision over recall of every method, a row per scene, before (left) and after (right) verification."""
    figure = new_figure((10.0, 4.0 * len(curves)), dpi=90)
    panels = figure.subplots(len(curves), 2, squeeze=False, sharex=True, sharey=True)
    for row, (scene, methods) in zip(panels, curves.items(), strict=True):
        for axes, when in zip(row, ("before", "after"), strict=True):
            for method, precision in methods.items():
                reached = np.array(precision[when]) > 0
                axes.plot(recall[reached], np.array(precision[when])[reached], label=method)
            axes.set(xlabel="recall", ylabel="precision", xlim=(0, 1.02), ylim=(0, 1.02))
            axes.set_title(f"{scene}, {when} scan matching", fontsize=10)
            axes.grid(alpha=0.3)
    panels[0, 0].legend(loc="lower left")
    return save_picture(figure, folder / "twc-table1-curves", kind)
