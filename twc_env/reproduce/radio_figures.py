"""Figures 3 and 4 of the radio SLAM paper from a walk of ours: models, trajectories, occupancy map."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from twc_env.config import RadioSlamConfig
from twc_env.errors import MapError
from twc_env.geometry import compose
from twc_env.maps import load_map
from twc_env.slam import radio_slam


def draw(folder: Path, name: str, place, seed: int, record: Callable, lidar: Callable | None = None) -> None:
    """Write `NAME-models.png`, `NAME-trajectories.png` and, where there is a laser, `NAME-map.png`.

    `record(place, kind, seed)` gives the walk; `lidar(place, walk, seed)` its result with laser and the true first
    pose. Raises MapError when matplotlib is missing.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.collections import LineCollection
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MapError("drawing needs matplotlib: pip install 'twc_env[viz]'") from error
    folder.mkdir(parents=True, exist_ok=True)
    walks = {kind: record(place, kind, seed) for kind in ("wifi", "lte")}
    results = {
        kind: radio_slam.solve(radio_slam.RadioLog(w.motions, w.turned_rad, w.fingerprints), RadioSlamConfig())
        for kind, w in walks.items()
    }

    figure = Figure(figsize=(8, 4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    for kind, colour in (("wifi", "tab:blue"), ("lte", "tab:orange")):
        model = results[kind].models[kind]
        std = np.sqrt(model.variance_m2)
        axes.plot(model.centre, model.mean_m, color=colour, label=kind)
        axes.fill_between(model.centre, model.mean_m - std, model.mean_m + std, color=colour, alpha=0.2, lw=0)
    axes.set(xlabel="similarity", ylabel="distance [m], mean and deviation", title=name, ylim=(0, None))
    axes.legend()
    figure.savefig(folder / f"{name}-models.png", dpi=110)

    figure = Figure(figsize=(10, 7), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.add_collection(LineCollection(list(load_map(place.twin).walls_m), colors="0.75", linewidths=0.8))
    walk = walks["wifi"]
    start = walk.true_poses[0]
    paths = {
        "truth": (walk.true_poses, "k"),
        "odometry": (walk.odometry, "0.5"),
        "lte": (compose(start, results["lte"].poses), "tab:orange"),
        "wifi": (compose(start, results["wifi"].poses), "tab:blue"),
    }
    for label, (poses, colour) in paths.items():
        axes.plot(poses[:, 0], poses[:, 1], color=colour, lw=0.9, label=label)
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]", title=name)
    axes.legend(loc="upper right")
    figure.savefig(folder / f"{name}-trajectories.png", dpi=110)

    if lidar is None:
        return
    grid = lidar(place, walk, seed).grid
    figure = Figure(figsize=(10, 7), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    width, height = np.array(grid.log_odds.shape[::-1]) * grid.resolution_m
    shown = 1.0 / (1.0 + np.exp(np.clip(grid.log_odds / 10.0, -6, 6)))
    axes.imshow(shown, cmap="gray", origin="lower", extent=(0, width, 0, height), vmin=0, vmax=1)
    axes.set(xlabel="x [m]", ylabel="y [m]", title=f"{name}: occupancy map of WiFi+LiDAR")
    figure.savefig(folder / f"{name}-map.png", dpi=110)
