"""Run the published and our structure from WiFi on one walk, and score both in the same way."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.metrics.k_visibility import StructureScore, calibration_error, score_structure, truth_map
from twc_env.reproduce.drawing import can_draw, new_figure
from twc_env.reproduce.walls.sfw_walks import WalkReadings
from twc_env.slam.walls import k_visibility_rules as published
from twc_env.slam.walls.k_clusters import compensate_distance, k_means, predict_walls, sliding_window
from twc_env.slam.walls.k_visibility import Structure, map_structure
from twc_env.slam.walls.k_visibility_grid import FREE_BELOW, UNKNOWN, WALL, WALL_ABOVE
from twc_env.world.building.floor_cells import Cells

METHODS = ("paper", "ours")
COMPENSATED = "paper, distance"
"""The published method on readings compensated for the distance from the router."""
FIGURES = ("k_accuracy", "iou_free", "iou_wall", "coverage", "mse", "brier")
RESOLUTION_M = 0.1
_FREE_SPACE_EXPONENT = 2.0
_DENSE_READINGS = 1000
"""With more readings than this the window of the paper is 25, else 7 (papers.md K6)."""


@dataclass(frozen=True, slots=True, eq=False)
class Mapped:
    """The map of one method for a walk, on the grid of the truth."""

    k_accuracy: float
    score: StructureScore
    calibration_error: float
    classes: Array
    truth: Array
    probability: Array
    structure: Structure | None = None

    @property
    def figures(self) -> dict[str, float]:
        """The columns common to all tables of maps."""
        score = self.score
        columns = (self.k_accuracy, score.iou_free, score.iou_wall, score.coverage, score.mse, score.brier)
        return dict(zip(FIGURES, columns, strict=True))


def focus_of(walk: WalkReadings) -> tuple[Array, Array]:
    """Indices of the readings that heard any router, and the strongest router of each."""
    rows = np.flatnonzero(np.isfinite(walk.rssi_dbm).any(axis=1))
    return rows, np.argmax(np.nan_to_num(walk.rssi_dbm[rows], nan=-200.0), axis=1)


def by_paper(walk: WalkReadings, cells: Cells, is_compensated: bool = False) -> Mapped:
    """Sorted k-means on the strongest router's readings, sliding window, rules 1-5 with Eq. 4 and 5 as printed.

    The paper does not state its number of clusters: the best one in hindsight is used. `is_compensated`: the free-space
    path loss is added to the readings before clustering.
    """
    rows, focus = focus_of(walk)
    rssi = walk.rssi_dbm
    if is_compensated:
        apart_m = np.linalg.norm(walk.position_m[:, None] - walk.router_m, axis=2)
        rssi = compensate_distance(rssi, apart_m, _FREE_SPACE_EXPONENT)
    width = 25 if len(rows) > _DENSE_READINGS else 7
    smooth = np.zeros(len(rows))
    for router in range(rssi.shape[1]):
        mine = focus == router
        if mine.any():
            smooth[mine] = sliding_window(rssi[rows[mine], router], width)
    true = walk.walls[rows, focus]
    tries = [predict_walls(smooth, k_means(smooth, k + 1)) for k in range(1, max(int(true.max()), 1) + 1)]
    k = max(tries, key=lambda guess: float(np.mean(guess == true)))
    return by_rules(walk, cells, k)


def by_rules(walk: WalkReadings, cells: Cells, walls: Array) -> Mapped:
    """The published map, from the number of walls (heard readings,) to the strongest router of each reading."""
    rows, focus = focus_of(walk)
    at = np.floor((walk.position_m[rows] - cells.origin_m) / cells.resolution_m).astype(np.int64)[:, ::-1]
    routers = ((walk.router_m - cells.origin_m) / cells.resolution_m)[:, ::-1]
    settings = published.RuleSettings(equation_4="literal")
    classes, _ = published.map_by_rules(at, walls, focus, routers, cells.free.shape, settings)
    probability = np.where(classes == UNKNOWN, np.nan, (classes == WALL).astype(float))
    return _scores(
        float(np.mean(walls == walk.walls[rows, focus])), classes, probability, truth_map(cells.free, cells.wall)
    )


def by_ours(walk: WalkReadings, cells: Cells, seed: int) -> Mapped:
    """`map_structure` on the same readings."""
    structure = map_structure(
        walk.position_m, walk.rssi_dbm, walk.router_m, cells.resolution_m, seed=seed, origin_m=cells.origin_m
    )
    rows, focus = focus_of(walk)
    accuracy = float(np.mean(structure.walls[rows, focus] == walk.walls[rows, focus]))
    classes = on_grid(structure.grid.classes(), structure.grid.origin_m, cells, UNKNOWN)
    probability = on_grid(structure.grid.probability, structure.grid.origin_m, cells, np.nan)
    return _scores(accuracy, classes, probability, truth_map(cells.free, cells.wall), structure)


def at_coverage(made: Mapped, rays: Array, coverage: float) -> Mapped:
    """The map reduced to its most certain cells, so that at most `coverage` of the scored cells are known.

    IoU ignores unknown cells, which differ between methods; this allows a comparison at equal coverage. Equally certain
    cells are ordered by the number of rays (rows, columns) through them.
    """
    undecided = 0.5 * (FREE_BELOW + WALL_ABOVE)
    sureness = np.abs(np.nan_to_num(made.probability, nan=undecided) - undecided)
    surest = np.lexsort((-rays.ravel(), -sureness.ravel()))
    surest = surest[made.classes.ravel()[surest] != UNKNOWN]
    is_scored = made.truth.ravel()[surest] != UNKNOWN
    kept = surest[np.cumsum(is_scored) <= coverage * np.sum(made.truth != UNKNOWN)]
    classes = np.full(made.classes.shape, UNKNOWN, np.uint8)
    classes.flat[kept] = made.classes.flat[kept]
    probability = np.where(classes == UNKNOWN, np.nan, made.probability)
    return _scores(made.k_accuracy, classes, probability, made.truth, made.structure)


def on_grid(values: Array, origin_m: Array, cells: Cells, outside) -> Array:
    """Values of a grid with the same cells but another extent, transferred to the grid of the truth."""
    placed = np.full(cells.free.shape, outside, values.dtype)
    column, row = np.round((origin_m - cells.origin_m) / cells.resolution_m).astype(int)
    r0, c0 = max(row, 0), max(column, 0)
    r1, c1 = min(row + values.shape[0], placed.shape[0]), min(column + values.shape[1], placed.shape[1])
    placed[r0:r1, c0:c1] = values[r0 - row : r1 - row, c0 - column : c1 - column]
    return placed


def _scores(
    accuracy: float, classes: Array, probability: Array, truth: Array, structure: Structure | None = None
) -> Mapped:
    told = np.isfinite(probability) & (truth != UNKNOWN)
    error = calibration_error(probability[told], truth[told] == WALL)
    score = score_structure(classes, truth, probability)
    return Mapped(accuracy, score, error, classes, truth, probability, structure)


def draw_maps(path: Path, title: str, walk: WalkReadings, cells: Cells, maps: dict[str, Mapped]) -> None:
    """Draw the truth and the map of each method. Does nothing without matplotlib."""
    if not can_draw():
        return
    rows, columns = cells.free.shape
    figure = new_figure(5.0 * (len(maps) + 1), 5.0 * rows / columns + 1.2)
    figure.suptitle(f"{title} (walls black, floor white, unknown grey; green: the path, red: routers)")
    axes = figure.subplots(1, len(maps) + 1)
    x0, y0 = cells.origin_m
    extent = (x0, x0 + columns * cells.resolution_m, y0, y0 + rows * cells.resolution_m)
    shown = {"truth": next(iter(maps.values())).truth, **{name: made.classes for name, made in maps.items()}}
    for axis, (name, image) in zip(axes, shown.items(), strict=True):
        axis.imshow(image, origin="lower", extent=extent, cmap="gray", vmin=0, vmax=255)
        axis.plot(*walk.position_m.T, color="tab:green", linewidth=0.4)
        axis.plot(*walk.router_m.T, "r^", markersize=5)
        if name in maps:
            score = maps[name].score
            name += (
                f"\nk {maps[name].k_accuracy:.1%}, free IoU {score.iou_free:.3f}, wall IoU {score.iou_wall:.2f}, "
                f"coverage {score.coverage:.2f}"
            )
        axis.set_title(name, fontsize=9)
        axis.set_xlabel("x [m]")
        axis.set_aspect("equal")
    axes[0].set_ylabel("y [m]")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)
