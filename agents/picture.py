"""Pictures of an episode: an annotated map and an animated GIF."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env import ConfigError, EpisodeResult
from twc_env.pictures.map_picture import name_sign
from twc_env.pictures.video import film_frame, write_film
from twc_env.records.geometry import compose
from twc_env.records.whole_file import whole_file

ROBOT_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#785e3c", "#6e6edc")
LINES_CLEAR = 100
"""More closures of a kind than this are drawn below the paths, and fainter the more there are."""
FRAME_COUNT_MAX = 160
GIF_WIDTH_PX = 640


def require_libraries(gif: bool = True) -> None:
    """Raise ConfigError if a library for pictures is missing."""
    missing = [name for name, module in (("matplotlib", "matplotlib"), ("pillow", "PIL")) if not find_spec(module)]
    if missing and (gif or "matplotlib" in missing):
        raise ConfigError(
            f"pictures need {' and '.join(missing)}: run `pip install 'twc_env[viz]'`, or add --no-pictures"
        )


class Film:
    """Frames of an episode of unknown length: when there are too many, every second one is dropped."""

    def __init__(self, every: int = 5):
        self.every = every
        self._frames: list[Any] = []
        self._steps: list[int] = []

    def wants(self, step: int) -> bool:
        """Whether the frame of this step should be added."""
        return step % self.every == 0

    def add(self, step: int, frame: Array, caption: str) -> None:
        """Add a frame (height, width, 3) uint8 with a caption."""
        self._frames.append(film_frame(frame, caption, GIF_WIDTH_PX))
        self._steps.append(step)
        if len(self._frames) > FRAME_COUNT_MAX and self.wants(step):  # the last frame may be at any step
            self.every *= 2
            kept = [k for k, s in enumerate(self._steps) if s % self.every == 0]
            self._frames, self._steps = [self._frames[k] for k in kept], [self._steps[k] for k in kept]

    def write(self, path: Path) -> None:
        """Save as a looping GIF with a pause on its last frame."""
        if not self._frames:
            return
        write_film(path, self._frames, [80] * (len(self._frames) - 1) + [2000])


def draw_map(result: EpisodeResult, path: Path) -> None:
    """Write the map picture: true walls below the estimated maps, paths, signs, access points and closures."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    x_min, y_min, x_max, y_max = result.floorplan.bounds_m
    width, height = x_max - x_min + 2.0, y_max - y_min + 2.0
    inches = 13.0 if width > 1.2 * height else 10.0
    figure, axes = plt.subplots(figsize=(inches, min(inches * height / width, 14.0) + 1.3), layout="constrained")
    _draw_grids(axes, result)
    _draw_building(axes, result)
    _draw_paths(axes, result)
    _draw_closures(axes, result)
    axes.set(xlim=(x_min - 1, x_max + 1), ylim=(y_min - 1, y_max + 1), xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.set_facecolor("#dbdee3")
    axes.tick_params(labelsize=7)
    axes.set_title(_title(result), fontsize=9, loc="left", parse_math=False)
    figure.legend(*_unique_legend(axes), loc="outside lower center", ncols=5, fontsize=7.5, frameon=False)
    with whole_file(path) as beside:
        figure.savefig(beside, dpi=110)
    plt.close(figure)


def _title(result: EpisodeResult) -> str:
    f = result.figures
    return (
        f"{Path(str(f['map'])).name}, seed {f['seed']}: {f['merged_robots']} of {f['robots']} robots in one map, "
        f"{f['wrong_merges']} wrong merges\nteam ATE {f['team_ate_m']:.3f} m (odometry {f['odometry_ate_m']:.3f} m), "
        f"{100 * f['coverage_correct']:.1f} % mapped correctly in {f['sim_time_s']:.0f} s"
    )


def _draw_grids(axes, result: EpisodeResult) -> None:
    """Draw the map of each group in the building frame; floor is tinted by group if there are several."""
    from matplotlib.colors import to_rgb
    from matplotlib.transforms import Affine2D

    for k in range(len(result.grids) - 1, -1, -1):
        grid, pose = result.grids[k], result.pose_building_map[k]
        if grid.log_odds.size == 0:
            continue
        rows, columns = grid.log_odds.shape
        picture = np.zeros((rows, columns, 4))
        floor = np.ones(3)
        if len(result.grids) > 1:
            floor = 0.82 * floor + 0.18 * np.array(to_rgb(_colour(result.groups[k][0])))
        picture[grid.log_odds < 0] = [*floor, 1.0]
        picture[grid.log_odds > 0] = [0.13, 0.15, 0.19, 1.0]
        x, y = grid.origin_m
        extent = (x, x + columns * grid.resolution_m, y, y + rows * grid.resolution_m)
        image = axes.imshow(picture, origin="lower", extent=extent, interpolation="nearest", zorder=1 + 0.01 * (9 - k))
        image.set_transform(Affine2D().rotate(pose[2]).translate(pose[0], pose[1]) + axes.transData)


def _draw_building(axes, result: EpisodeResult) -> None:
    from matplotlib.collections import LineCollection

    plan = result.floorplan
    axes.add_collection(
        LineCollection(list(plan.walls_m), colors="#8d949f", linewidths=2.2, zorder=0.5, label="true walls")
    )
    if plan.access_points:
        places = np.array([point.position_m for point in plan.access_points])
        axes.scatter(*places.T, marker="^", s=22, color="#7b3294", lw=0, alpha=0.8, zorder=4, label="access points")
    if plan.signs:
        places = np.array([sign.position_m for sign in plan.signs])
        axes.scatter(*places.T, marker="s", s=10, color="#b8860b", lw=0, zorder=4, label="signs")
    for sign in plan.signs[:80]:
        name_sign(axes, sign.text, sign.position_m, sign.facing_rad, 4.0, fontsize=5, color="#6b5210")


def _draw_paths(axes, result: EpisodeResult) -> None:
    placed = placed_in_building(result)
    for robot in range(result.true_poses.shape[1]):
        colour, name = _colour(robot), f"robot {robot}"
        odometry, true = result.odometry_poses[:, robot, :2].T, result.true_poses[:, robot, :2].T
        axes.plot(*odometry, ":", lw=0.6, color=colour, alpha=0.7, zorder=2, label="odometry alone")
        axes.plot(*true, lw=2.6, color=colour, alpha=0.35, zorder=2.5, label=f"{name}, true")
        axes.plot(*placed[:, robot, :2].T, lw=0.9, color=colour, zorder=3, label=f"{name}, estimated")
        axes.plot(*true[:, 0], "o", ms=5, mfc="white", mec=colour, zorder=5, label="start")
        axes.plot(*true[:, -1], "o", ms=6, color=colour, zorder=5, label="end")


def placed_in_building(result: EpisodeResult) -> Array:
    """Estimated poses (steps + 1, robots, 3) in the building frame, aligned with the map that they are in."""
    placed = result.estimated_poses.copy()
    for robots, pose in zip(result.viewers, result.pose_building_map, strict=True):
        placed[:, list(robots)] = compose(pose, result.estimated_poses[:, list(robots)])
    return placed


def _draw_closures(axes, result: EpisodeResult) -> None:
    from matplotlib.collections import LineCollection

    styles = {
        "accepted closure, correct": ("#1a9641", 0.9, 6.2),
        "accepted closure, false": ("#e60000", 1.6, 6.3),
        "closure not accepted": ("#f0a030", 0.6, 6.0),
    }
    lines: dict[str, list[tuple]] = {name: [] for name in styles}
    for closure in result.closures:
        name = "closure not accepted"
        if closure["status"] == "accepted":
            name = f"accepted closure, {'correct' if closure['correct'] else 'false'}"
        lines[name].append((closure["target_m"], closure["source_m"]))
    for name, (colour, width, order) in styles.items():
        if lines[name]:
            faint = {"alpha": max(0.1, LINES_CLEAR / len(lines[name])), "zorder": 1.9}
            style = faint if len(lines[name]) > LINES_CLEAR and "false" not in name else {"zorder": order}
            axes.add_collection(LineCollection(lines[name], colors=colour, linewidths=width, **style))
            axes.plot([], [], color=colour, lw=width, label=f"{name} ({len(lines[name])})")


def _unique_legend(axes) -> tuple[list, list[str]]:
    handles, labels = axes.get_legend_handles_labels()
    first = {label: handle for handle, label in reversed(list(zip(handles, labels, strict=True)))}
    names = sorted(first, key=labels.index)
    return [first[name] for name in names], names


def _colour(robot: int) -> str:
    return ROBOT_COLOURS[robot % len(ROBOT_COLOURS)]
