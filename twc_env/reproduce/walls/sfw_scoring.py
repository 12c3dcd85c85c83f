"""Run the published and our structure from WiFi on one walk, and score both in the same way."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.metrics.k_visibility import (
    StructureScore,
    calibration_error,
    score_structure,
    truth_map,
    walls_crossed_map,
)
from twc_env.pictures.style import ROBOTS, legend_below, new_figure, style
from twc_env.reproduce.drawing import Pictures, save_picture
from twc_env.reproduce.walls.sfw_walks import WalkReadings
from twc_env.slam.walls import k_visibility_rules as published
from twc_env.slam.walls.k_clusters import compensate_distance, k_means, predict_walls, silhouette_k, sliding_window
from twc_env.slam.walls.k_visibility import Structure, map_structure
from twc_env.slam.walls.k_visibility_grid import FREE, FREE_BELOW, UNKNOWN, WALL, WALL_ABOVE
from twc_env.world.building.floor_cells import Cells

METHODS = ("paper", "ours")
COMPENSATED = "paper, distance"
"""The published method on readings compensated for the distance from the router."""
BY_SILHOUETTE, ALGORITHM_1, DENSE = "paper, K by silhouette", "paper, Algorithm 1", "paper, k given everywhere"
"""The published method without the truth; with its Algorithm 1; and its dense inverse, an oracle."""
LITERAL_MU, MIXTURE_MU = "paper, probability by Eq. 4", "paper, probability by Gaussians"
"""The map of the paper with its fused mu as probability of a wall: Eq. 4 as printed, or a Gaussian per wall; see the
Brier score."""
SHUFFLED, OURS_SHUFFLED = "paper, strengths shuffled", "ours, strengths shuffled"
"""The null: the same strengths at other readings of the walk, so that only the path says anything."""
FIGURES = (
    "k_accuracy", "k_cells", "k_trivial", "iou_free", "iou_trivial", "iou_wall", "coverage", "mse", "brier",
)  # fmt: skip
"""k_cells: accuracy per cell of the walk (papers.md K17). Trivial: always the most frequent k; all floor."""
RESOLUTION_M = 0.1
_FREE_SPACE_EXPONENT = 2.0
_DENSE_READINGS = 1000
"""With more readings than this the window of the paper is 25, else 7 (papers.md K6)."""


@dataclass(frozen=True, slots=True, eq=False)
class Counted:
    """How many numbers of walls k are right, of a walk's readings."""

    accuracy: float
    by_cell: float
    """Median k against the median truth, per cell of the walk (papers.md K17)."""
    trivial: float
    """Accuracy of always saying the k that is most frequent on this walk."""


@dataclass(frozen=True, slots=True, eq=False)
class Mapped:
    """The map of one method for a walk, on the grid of the truth."""

    k: Counted
    score: StructureScore
    calibration_error: float
    classes: Array
    truth: Array
    probability: Array
    structure: Structure | None = None

    @property
    def figures(self) -> dict[str, float]:
        """The columns common to all tables of maps."""
        score, all_floor = self.score, np.count_nonzero(self.truth == FREE) / np.count_nonzero(self.truth != UNKNOWN)
        k = self.k.accuracy, self.k.by_cell, self.k.trivial
        ious = score.iou_free, float(all_floor), score.iou_wall
        return dict(zip(FIGURES, (*k, *ious, score.coverage, score.mse, score.brier), strict=True))


def shuffled(walk: WalkReadings, seed: int) -> WalkReadings:
    """The walk with its strengths at other readings."""
    order = np.random.default_rng([seed, 4]).permutation(len(walk.rssi_dbm))
    return replace(walk, rssi_dbm=walk.rssi_dbm[order])


def counted_walls(walk: WalkReadings, cells: Cells, walls: Array) -> Counted:
    """Accuracy of walls (heard readings,) to the strongest router of each reading."""
    rows, focus = focus_of(walk)
    true = walk.walls[rows, focus]
    _, cell = np.unique(np.column_stack([_cells_of(walk.position_m[rows], cells), focus]), axis=0, return_inverse=True)
    right = [np.median(walls[mine]) == np.median(true[mine]) for mine in _groups(cell)]
    return Counted(float(np.mean(walls == true)), float(np.mean(right)), float(np.bincount(true).max() / len(true)))


def _groups(number: Array) -> list[Array]:
    """Indices of equal numbers."""
    order = np.argsort(number, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(number[order])) + 1)


def focus_of(walk: WalkReadings) -> tuple[Array, Array]:
    """Indices of the readings that heard any router, and the strongest router of each."""
    rows = np.flatnonzero(np.isfinite(walk.rssi_dbm).any(axis=1))
    return rows, np.argmax(np.nan_to_num(walk.rssi_dbm[rows], nan=-200.0), axis=1)


def by_paper(
    walk: WalkReadings, cells: Cells, is_compensated: bool = False, k_by_silhouette: bool = False, mu: str = ""
) -> Mapped:
    """Sorted k-means on the strongest router's readings, sliding window, rules 1-5 with Eq. 4 and 5 as printed.

    The paper does not state its number of clusters: the best one in hindsight is used, or with `k_by_silhouette` one
    that needs no truth. `is_compensated`: the free-space path loss is added to the readings before clustering. `mu`:
    see `by_rules`.
    """
    return by_rules(walk, cells, _clustered(walk, is_compensated, k_by_silhouette), mu)


def by_algorithm_1(walk: WalkReadings, cells: Cells) -> Mapped:
    """The published Algorithm 1 instead of its rules, from the same number of walls at each reading (papers.md K13)."""
    rows, _ = focus_of(walk)
    walls = _clustered(walk)
    levels = published.map_by_algorithm_1(
        _cells_of(walk.position_m[rows], cells), walls, walk.rssi_dbm[rows], _routers_in(walk, cells), cells.free.shape
    )
    classes = np.select([levels > UNKNOWN, levels < UNKNOWN], [FREE, WALL], UNKNOWN).astype(np.uint8)
    probability = np.where(classes == UNKNOWN, np.nan, 1.0 - levels / FREE)
    return _scores(counted_walls(walk, cells, walls), classes, probability, truth_map(cells.free, cells.wall))


def by_dense_inverse(walk: WalkReadings, cells: Cells) -> Mapped:
    """Walls from the true number of walls in every free cell: what a perfect predictor would give (papers.md K2, K3).

    An oracle: all free cells are given, so only walls say something.
    """
    walls = np.zeros(cells.free.shape, bool)
    for router in _routers_in(walk, cells):
        walls |= published.walls_from_k_map(walls_crossed_map(cells.wall, cells.free, router), router)
    classes = np.select([cells.free, walls], [FREE, WALL], UNKNOWN).astype(np.uint8)
    probability = np.where(classes == UNKNOWN, np.nan, (classes == WALL).astype(float))
    rows, focus = focus_of(walk)
    k = counted_walls(walk, cells, walk.walls[rows, focus])
    return _scores(k, classes, probability, truth_map(cells.free, cells.wall))


def _clustered(walk: WalkReadings, is_compensated: bool = False, k_by_silhouette: bool = False) -> Array:
    """The number of walls (heard readings,) to the strongest router of each reading (Eq. 1 to 3), see `by_paper`."""
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
    if k_by_silhouette:
        return predict_walls(smooth, k_means(smooth, silhouette_k(smooth) + 1))
    true = walk.walls[rows, focus]
    tries = [predict_walls(smooth, k_means(smooth, k + 1)) for k in range(1, max(int(true.max()), 1) + 1)]
    return max(tries, key=lambda guess: float(np.mean(guess == true)))


def _cells_of(position_m: Array, cells: Cells) -> Array:
    """(n, 2) row and column of positions (n, 2)."""
    return np.floor((position_m - cells.origin_m) / cells.resolution_m).astype(np.int64)[:, ::-1]


def _routers_in(walk: WalkReadings, cells: Cells) -> Array:
    """(routers, 2) row and column of the routers, in fractional cells."""
    return ((walk.router_m - cells.origin_m) / cells.resolution_m)[:, ::-1]


def by_rules(walk: WalkReadings, cells: Cells, walls: Array, mu: str = "") -> Mapped:
    """The published map, from the number of walls (heard readings,) to the strongest router of each reading.

    All cells seen only through walls are walls (rule 3). The probability of these is 1, or with `mu` ("literal" or
    "mixture") that of Eq. 4 in that form, fused by Eq. 5.
    """
    rows, focus = focus_of(walk)
    settings = published.RuleSettings(equation_4=mu or "literal")
    places, routers = _cells_of(walk.position_m[rows], cells), _routers_in(walk, cells)
    classes, found = published.map_by_rules(places, walls, focus, routers, cells.free.shape, settings)
    likely = np.where(np.isfinite(found), found, 1.0) if mu else 1.0  # the outer box has no mu
    probability = np.where(classes == UNKNOWN, np.nan, np.where(classes == WALL, likely, 0.0))
    return _scores(counted_walls(walk, cells, walls), classes, probability, truth_map(cells.free, cells.wall))


def by_ours(walk: WalkReadings, cells: Cells, seed: int) -> Mapped:
    """`map_structure` on the same readings."""
    structure = map_structure(
        walk.position_m, walk.rssi_dbm, walk.router_m, cells.resolution_m, seed=seed, origin_m=cells.origin_m
    )
    rows, focus = focus_of(walk)
    k = counted_walls(walk, cells, structure.walls[rows, focus])
    classes = on_grid(structure.grid.classes(), structure.grid.origin_m, cells, UNKNOWN)
    probability = on_grid(structure.grid.probability, structure.grid.origin_m, cells, np.nan)
    return _scores(k, classes, probability, truth_map(cells.free, cells.wall), structure)


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
    return _scores(made.k, classes, probability, made.truth, made.structure)


def on_grid(values: Array, origin_m: Array, cells: Cells, outside) -> Array:
    """Values of a grid with the same cells but another extent, transferred to the grid of the truth."""
    placed = np.full(cells.free.shape, outside, values.dtype)
    column, row = np.round((origin_m - cells.origin_m) / cells.resolution_m).astype(int)
    r0, c0 = max(row, 0), max(column, 0)
    r1, c1 = min(row + values.shape[0], placed.shape[0]), min(column + values.shape[1], placed.shape[1])
    placed[r0:r1, c0:c1] = values[r0 - row : r1 - row, c0 - column : c1 - column]
    return placed


def _scores(k: Counted, classes: Array, probability: Array, truth: Array, structure: Structure | None = None) -> Mapped:
    told = np.isfinite(probability) & (truth != UNKNOWN)
    error = calibration_error(probability[told], truth[told] == WALL)
    score = score_structure(classes, truth, probability)
    return Mapped(k, score, error, classes, truth, probability, structure)


def draw_maps(
    pictures: Pictures | None, name: str, title: str, walk: WalkReadings, cells: Cells, maps: dict[str, Mapped]
) -> None:
    """Draw the truth and the map of each method, if there are to be pictures."""
    if pictures is not None:
        with style():
            save_picture(_maps_figure(title, walk, cells, maps), pictures.folder / name, pictures.kind)


def _maps_figure(title: str, walk: WalkReadings, cells: Cells, maps: dict[str, Mapped]) -> Any:
    rows, columns = cells.free.shape
    across = 2 if columns > rows else 3
    down = -(-(len(maps) + 1) // across)
    figure = new_figure((5.0 * across, (5.0 * rows / columns + 0.6) * down + 0.6), dpi=130)
    figure.suptitle(f"{title}: walls black, floor white, unknown grey")
    panels = figure.subplots(down, across, squeeze=False)
    axes = panels.ravel()
    for axis in axes[len(maps) + 1 :]:
        axis.set_visible(False)
    x0, y0 = cells.origin_m
    extent = (x0, x0 + columns * cells.resolution_m, y0, y0 + rows * cells.resolution_m)
    shown = {"truth": next(iter(maps.values())).truth, **{name: made.classes for name, made in maps.items()}}
    for axis, (name, image) in zip(axes, shown.items(), strict=False):
        axis.imshow(image, origin="lower", extent=extent, cmap="gray", vmin=0, vmax=255)
        axis.plot(*walk.position_m.T, color=ROBOTS[0], linewidth=0.6, label="path")
        axis.plot(*walk.router_m.T, "^", color=ROBOTS[1], markersize=6, label="router")
        if name in maps:
            score = maps[name].score
            name += (
                f"\nk {maps[name].k.accuracy:.1%}, free IoU {score.iou_free:.3f}, wall IoU {score.iou_wall:.2f}, "
                f"coverage {score.coverage:.2f}"
            )
        axis.set_title(name, fontsize=9)
        axis.set_aspect("equal")
    for axis in panels[:, 0]:
        axis.set_ylabel("y [m]")
    for k, axis in enumerate(axes[: len(maps) + 1]):
        if k + across > len(maps):
            axis.set_xlabel("x [m]")
    legend_below(figure, *axes[0].get_legend_handles_labels())
    return figure
