"""The map of an episode as a figure: estimated maps over the true building, paths, signs and closures (extra `viz`)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import ConfigError
from twc_env.exploration.drawing import palette
from twc_env.exploration.drawing.extent import extent_m
from twc_env.exploration.drawing.figures import fit_height, legend_below, new_figure, set_title, settle, style
from twc_env.exploration.drawing.labels import building_name, place_names
from twc_env.exploration.drawing.path_ends import end_entries, mark_ends
from twc_env.exploration.drawing.primitives import OUTSIDE, raise_to_strokes
from twc_env.exploration.drawing.smooth_map import BORDER, KNOWN_LEVEL, known_field, wall_strokes
from twc_env.records.geometry import compose, transform_points
from twc_env.records.messages import GridMap

MARGIN_M, GAP_M = 1.0, 0.2
"""Around the building, and around walls of a map that lie outside it."""
WIDE_IN, NARROW_IN, HEIGHT_MAX_IN = 11.0, 8.0, 12.0
NAMES_MAX = 80
"""Signs beyond these get no name, as there is no room for more."""
LINES_CLEAR = 30
"""More closures of a kind than this are drawn below the paths, and fainter the more there are."""
BELOW_PATHS = 1.999
"""Their order: odometry is at 2, the walls of the topmost map at 1.995."""
FINER = 3
"""Small cells per cell of a map along each axis, in which walls are drawn before their outlines are traced."""
TRUE_WIDTH, ESTIMATED_WIDTH, ODOMETRY_WIDTH = 3.2, 1.1, 0.8
TRUE_OPACITY = 0.35


def map_figure(result: Any, dpi: float | None = None) -> Any:
    """The figure of an `EpisodeResult`. Raises ConfigError without matplotlib, and unless dpi is a number."""
    if dpi is not None and not (isinstance(dpi, (int, float)) and dpi > 0):
        raise ConfigError(f"dpi must be a number of dots per inch; got {dpi!r}: plot().savefig(FILE) writes a file")
    with style():
        (x_min, y_min), (x_max, y_max) = _shown_m(result)
        width_m, height_m = x_max - x_min, y_max - y_min
        inches = WIDE_IN if width_m > 1.2 * height_m else NARROW_IN
        figure = new_figure((inches, min(inches * height_m / width_m, HEIGHT_MAX_IN) + 1.5))
        if dpi:
            figure.set_dpi(dpi)
        axes = figure.add_subplot()
        axes.set(xlim=(x_min, x_max), ylim=(y_min, y_max), xlabel="x [m]", ylabel="y [m]", facecolor=palette.UNKNOWN)
        floors = _draw_grids(axes, result)
        entries = [*floors, *_draw_building(axes, result), *_draw_paths(axes, result), *_draw_closures(axes, result)]
        set_title(figure, _title(result))
        legend_below(figure, [handle for handle, _ in entries], [name for _, name in entries])
        fit_height(figure, axes, height_m / width_m, HEIGHT_MAX_IN)
        axes.set_aspect("equal")
        settle(figure)
        numbers = _number_robots(axes, result)
        signs = result.floorplan.signs[:NAMES_MAX]
        places_m = np.array([sign.position_m for sign in signs]).reshape(-1, 2)
        facing_rad = [sign.facing_rad for sign in signs]
        points_m = np.array([point.position_m for point in result.floorplan.access_points]).reshape(-1, 2)
        marks_m = np.vstack([points_m, result.true_poses[[0, -1], :, :2].reshape(-1, 2)])
        place_names(axes, [sign.text for sign in signs], places_m, facing_rad, numbers, marks_m)
    return figure


def _shown_m(result: Any) -> Array:
    """(2, 2) lower left and upper right corner [m] of the building and the walls of maps that lie askew."""
    corners = np.reshape(result.floorplan.bounds_m, (2, 2)) + [[-MARGIN_M], [MARGIN_M]]
    placed = zip(result.grids, result.pose_building_map, strict=True)
    ends_m = [_wall_ends_m(grid, wall_strokes(grid.log_odds), pose) for grid, pose in placed]
    return extent_m(corners, np.vstack([corners, *(own + gap_m for own in ends_m for gap_m in (-GAP_M, GAP_M))]))


def _wall_ends_m(grid: GridMap, strokes: Array, pose_building_map: Array) -> Array:
    """(n, 2) ends of the strokes of a map's walls, in the building frame."""
    ends_m = strokes[:, :4].reshape(-1, 2) * grid.resolution_m + np.asarray(grid.origin_m)
    return transform_points(np.asarray(pose_building_map, float), ends_m)


def _title(result: Any) -> list[str]:
    f = result.figures
    return [
        f"{building_name(str(f['map']))}, seed {f['seed']}: {f['merged_robots']} of {f['robots']} robots in one map, "
        f"{f['wrong_merges']} wrong merges",
        f"team ATE {f['team_ate_m']:.3f} m (odometry {f['odometry_ate_m']:.3f} m"
        f"{', which knows the true starts' if f['merged_robots'] < f['robots'] else ''}), "
        f"{100 * f['coverage_correct']:.1f} % mapped correctly in {f['sim_time_s']:.0f} s",
    ]


def _draw_grids(axes: Any, result: Any) -> list[tuple[Any, str]]:
    """Draw the map of each group in the building frame, the largest on top; floor is tinted if there are several."""
    from matplotlib.patches import Patch

    for k in range(len(result.grids) - 1, -1, -1):
        grid, pose = result.grids[k], result.pose_building_map[k]
        floor = palette.rgb(palette.FLOOR) if len(result.grids) == 1 else palette.tinted_floor(result.groups[k][0])
        draw_smoothly(axes, grid, pose, floor, 1 + 0.01 * (99 - min(k, 98)))
    if len(result.grids) == 1:
        return []
    return [
        (Patch(color=tuple(palette.tinted_floor(own[0]) / 255)), f"map of robot{'s' * (len(own) > 1)} {_listed(own)}")
        for own in result.groups
    ]


def _listed(robots: Sequence[int]) -> str:
    return ", ".join(map(str, robots))


def draw_smoothly(axes: Any, grid: GridMap, pose: Array, floor: Array, order: float = 1.0) -> None:
    """Draw a map whose frame has this pose in the axes. floor: its colour, (3,) from 0 to 255."""
    from matplotlib.transforms import Affine2D

    if not grid.log_odds.any():
        return
    known, cell = known_field(grid.log_odds), grid.resolution_m
    rows, columns = known.shape
    x = grid.origin_m[0] + (np.arange(columns) - BORDER + 0.5) * cell
    y = grid.origin_m[1] + (np.arange(rows) - BORDER + 0.5) * cell
    place = Affine2D().rotate(pose[2]).translate(pose[0], pose[1]) + axes.transData
    look: dict[str, Any] = {"antialiased": True, "zorder": order}
    axes.contourf(x, y, known, [KNOWN_LEVEL, 99.0], colors=[tuple(floor / 255)], transform=place, **look)
    field, left_m, bottom_m = wall_field(grid, pose)
    if field.max() > 0.0:
        x, y = (start + (np.arange(n) + 0.5) * cell / FINER for start, n in
                ((left_m, field.shape[1]), (bottom_m, field.shape[0])))  # fmt: skip
        axes.contourf(x, y, field, [0.0, 99.0], colors=[palette.WALL], **{**look, "zorder": order + 0.005})


def wall_field(grid: GridMap, pose_building_map: Array) -> tuple[Array, float, float]:
    """(rows, columns) how far each small cell, `FINER` to a cell, lies within the walls of a map, in small cells and
    negative outside, in the building frame with the lowest y first; and the x and y [m] of its lower left corner."""
    strokes, cell = wall_strokes(grid.log_odds), grid.resolution_m / FINER
    ends_m = _wall_ends_m(grid, strokes, pose_building_map)
    if not len(ends_m):
        return np.full((2, 2), OUTSIDE), 0.0, 0.0
    corner_m = ends_m.min(axis=0) - 2 * grid.resolution_m
    columns, rows = np.ceil((ends_m.max(axis=0) + 2 * grid.resolution_m - corner_m) / cell).astype(int)
    field = np.full((rows, columns), OUTSIDE)
    pixels = np.column_stack([((ends_m - corner_m) / cell - 0.5).reshape(-1, 4), strokes[:, 4] * FINER])
    raise_to_strokes(field, pixels)
    return field, float(corner_m[0]), float(corner_m[1])


def _draw_building(axes: Any, result: Any) -> list[tuple[Any, str]]:
    from matplotlib.collections import LineCollection
    from matplotlib.lines import Line2D

    plan = result.floorplan
    axes.add_collection(LineCollection(list(plan.walls_m), colors=palette.TRUE_WALL, linewidths=1.6, zorder=0.5))
    entries = [
        (Line2D([], [], color=palette.WALL, lw=2.6), "mapped walls"),
        (Line2D([], [], color=palette.TRUE_WALL, lw=1.6), "true walls"),
    ]
    marks = (("signs", "s", 3.2, plan.signs), ("access points", "^", 4.6, plan.access_points))
    for name, marker, size, things in marks:
        if things:
            places = np.array([thing.position_m for thing in things])
            look: dict[str, Any] = {
                "ls": "",
                "marker": marker,
                "ms": size,
                "color": palette.TRUE_TEXT,
                "mec": palette.FLOOR,
                "mew": 0.4,
            }
            axes.plot(*places.T, zorder=4, **look)
            entries.append((Line2D([], [], **look), name))
    return entries


def _draw_paths(axes: Any, result: Any) -> list[tuple[Any, str]]:
    from matplotlib.lines import Line2D

    placed, robots = placed_in_building(result), range(result.true_poses.shape[1])
    entries: list[tuple[Any, str]] = []
    for robot in robots:
        colour = palette.robot_colour(robot)
        odometry, true = result.odometry_poses[:, robot, :2].T, result.true_poses[:, robot, :2].T
        axes.plot(*odometry, ":", lw=ODOMETRY_WIDTH, color=colour, alpha=0.8, zorder=2)
        axes.plot(*true, lw=TRUE_WIDTH, color=colour, alpha=TRUE_OPACITY, zorder=2.5)
        axes.plot(*placed[:, robot, :2].T, lw=ESTIMATED_WIDTH, color=colour, zorder=3)
        mark_ends(axes, true.T, colour, is_true=True)
        both = (
            Line2D([], [], lw=2 * TRUE_WIDTH, color=colour, alpha=TRUE_OPACITY, solid_capstyle="butt"),
            Line2D([], [], lw=1.5 * ESTIMATED_WIDTH, color=colour),
        )
        first = robot == 0
        entries.append((both, f"robot {robot}{': true (wide), estimated (thin)' if first else ''}"))
    dotted = Line2D([], [], ls=":", lw=1.4 * ODOMETRY_WIDTH, color=palette.INK)
    return [*entries, (dotted, "odometry alone"), *end_entries(is_true=True)]


def placed_in_building(result: Any) -> Array:
    """Estimated poses (steps + 1, robots, 3) in the building frame, aligned with the map that they are in."""
    placed = result.estimated_poses.copy()
    for robots, pose in zip(result.viewers, result.pose_building_map, strict=True):
        placed[:, list(robots)] = compose(pose, result.estimated_poses[:, list(robots)])
    return placed


def _draw_closures(axes: Any, result: Any) -> list[tuple[Any, str]]:
    """Draw closures: accepted ones solid, rejected ones dashed, undecided ones dotted; false accepted ones thick, with
    crosses."""
    from matplotlib.collections import LineCollection
    from matplotlib.lines import Line2D

    styles: dict[str, dict[str, Any]] = {
        "undecided closures": {"lw": 0.9, "ls": ":", "zorder": 6.0},
        "rejected closures": {"lw": 0.9, "ls": "--", "zorder": 6.0},
        "accepted closures, correct": {"lw": 0.9, "ls": "-", "zorder": 6.2},
        "accepted closures, false": {"lw": 2.4, "ls": "-", "zorder": 6.3, "marker": "X", "ms": 7},
    }
    lines: dict[str, list[tuple]] = {name: [] for name in styles}
    for closure in result.closures:
        name = "rejected closures" if closure["status"] == "rejected" else "undecided closures"
        if closure["status"] == "accepted":
            name = f"accepted closures, {'correct' if closure['correct'] else 'false'}"
        lines[name].append((closure["target_m"], closure["source_m"]))
    entries = []
    for name, look in styles.items():
        if not lines[name]:
            continue
        entries.append((Line2D([], [], color=palette.CLOSURE, **look), f"{name} ({len(lines[name])})"))
        faint = {"alpha": max(0.1, LINES_CLEAR / len(lines[name])), "zorder": BELOW_PATHS}
        drawn = {"zorder": look["zorder"]} | (faint if len(lines[name]) > LINES_CLEAR and "marker" not in look else {})
        axes.add_collection(
            LineCollection(lines[name], colors=palette.CLOSURE, linewidths=look["lw"], linestyles=look["ls"], **drawn)
        )
        if "marker" in look:
            ends = np.array(lines[name]).reshape(-1, 2)
            axes.plot(*ends.T, ls="", marker="X", ms=7, color=palette.CLOSURE, mec=palette.FLOOR, zorder=6.4)
    return entries


def _number_robots(axes: Any, result: Any) -> list[Any]:
    """Write the number of each robot beside its last true place."""
    from matplotlib.patheffects import withStroke

    centre = np.array([np.mean(axes.get_xlim()), np.mean(axes.get_ylim())])
    texts = []
    for robot, place in enumerate(result.true_poses[-1, :, :2]):
        away = centre - place  # towards the middle of the picture, where there is room
        u, v = 9.0 * away / max(math.hypot(*away), 1e-9)
        texts.append(
            axes.annotate(
                str(robot),
                place,
                (u, v),
                textcoords="offset points",
                ha="center",
                va="center",
                fontsize=8,
                fontweight="bold",
                color=palette.INK,
                zorder=7,
                annotation_clip=True,
                path_effects=[withStroke(linewidth=2.2, foreground=palette.FLOOR)],
            )
        )
    return texts
