"""The k-visibility authors' own logs (their experiments 3 and 5), scored against their LiDAR map.

Path and map have no common frame: the map is registered to the path by a similarity transform, whose fit is printed.
The true number of walls is the number of runs of non-free map cells along a ray. `authors` uses the thresholds of the
authors' program where they apply (one router), `paper` k-means as published, `ours` all columns jointly. `ours, as
covered` reports no more cells than `paper`, the most certain ones first.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array
from scipy.ndimage import binary_closing, binary_dilation

from twc_env.datasets.buildings.raster import largest_part
from twc_env.datasets.surveys.sfw_authors import (
    FLOOR_M2,
    ROUTERS_PX,
    THRESHOLDS_DBM,
    AuthorsWalk,
    read_authors_walk,
    read_lidar_map,
)
from twc_env.metrics.k_visibility import walls_crossed_in_raster
from twc_env.reproduce.drawing import Pictures, pictures_of
from twc_env.reproduce.runner import Runner, data_folder
from twc_env.reproduce.walls import sfw_scoring as scoring
from twc_env.reproduce.walls.sfw_registration import Registration, register
from twc_env.reproduce.walls.sfw_walks import WalkReadings
from twc_env.running.options import add_folder, add_pictures
from twc_env.world.building.floor_cells import Cells

AS_COVERED = "ours, as covered"
_PRINTED = {1: (3, 85.32, 0.8321), 2: (5, 95.73, 0.8364)}
_MARGIN_CELLS = 10
_GAP_CELLS = 5.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `reproduce sfw-authors`."""
    add_folder(parser, "--out", "runs/sfw-authors", "folder for pictures")
    add_pictures(parser)


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """One row per walk and method."""
    folder = data_folder() / "sfw_authors"
    walks = runner.each(
        (1, 2),
        lambda routers: measure(routers, folder, pictures_of(options)),
        lambda n: f"walk {n}, drawn in {options.out}",
    )
    return [row for walk in walks for row in walk]


def remarks(table: list[dict]) -> list[str]:
    """One sentence per registration."""
    return [
        f"experiment {row['experiment']}: map laid on the walk with scale {row['fit_scale']:.4f}, turned "
        f"{row['fit_angle_deg']:.2f} degrees; {row['fit_free_share']:.1%} of the path in free space, mean gap of the "
        f"rim to the path {row['fit_wall_gap_m']:.2f} m"
        for row in table
        if row["method"] == "ours"
    ]


def measure(routers: int, folder: Path, pictures: Pictures | None) -> list[dict]:
    """The rows of one walk."""
    laid = lay(folder, routers)
    walk, fit, cells, placed = laid.walk, laid.fit, laid.cells, laid.placed
    strongest = _strongest_column_each(placed, walk.router_of)
    maps = {"paper": scoring.by_paper(strongest, cells)}
    if routers == 1:
        thresholds = np.array(THRESHOLDS_DBM)
        k = (placed.rssi_dbm[:, 0, None] <= thresholds).sum(axis=1)
        maps["authors"] = scoring.by_rules(strongest, cells, k)
    ours = maps["ours"] = scoring.by_ours(placed, cells, seed=0)
    if ours.structure is not None:
        rays = scoring.on_grid(ours.structure.grid.rays, ours.structure.grid.origin_m, cells, 0)
        maps[AS_COVERED] = scoring.at_coverage(ours, rays, maps["paper"].score.coverage)
    experiment, accuracy, iou = _PRINTED[routers]
    title = f"authors' log, {('one router', 'two routers')[routers - 1]}"
    scoring.draw_maps(pictures, f"experiment-{experiment}", title, placed, cells, maps)
    return [
        {
            "experiment": experiment,
            "routers": routers,
            "points": len(walk.position_px),
            "method": method,
            **made.figures,
            "paper_k_accuracy": accuracy / 100,
            "paper_iou": iou,
            "seeds": 1,
            "sd": 0.0,
            "fit_scale": fit.scale,
            "fit_angle_deg": float(np.rad2deg(fit.angle_rad)),
            "fit_free_share": fit.free_share,
            "fit_wall_gap_m": fit.wall_gap_px / laid.pixels_per_m,
        }
        for method, made in maps.items()
    ]


@dataclass(frozen=True, slots=True, eq=False)
class LaidWalk:
    """A log of the authors, registered on the cells of their LiDAR map."""

    walk: AuthorsWalk
    fit: Registration
    cells: Cells
    placed: WalkReadings
    """In metres on the cells, with the columns of the log."""
    pixels_per_m: float


def lay(folder: Path, routers: int) -> LaidWalk:
    """The walk with this number of routers, registered on the map. DataError for invalid files."""
    walk = read_authors_walk(folder, routers)
    free, wall = read_lidar_map(folder)
    free = largest_part(free)
    fit = register(walk.position_px, free)
    pixels_per_m = float(np.sqrt(free.sum() / FLOOR_M2))
    cells = _cells(free, wall, pixels_per_m)
    return LaidWalk(walk, fit, cells, _placed(walk, fit, cells, free.shape[0], pixels_per_m), pixels_per_m)


def _cells(free: Array, wall: Array, pixels_per_m: float) -> Cells:
    """The picture as cells of the scoring grid, y up: free if most pixels are, wall if dark and next to free cells."""
    size = scoring.RESOLUTION_M * pixels_per_m
    rows, columns = (np.ceil(np.array(free.shape) / size)).astype(int)
    row, column = (np.floor(np.arange(n) / size).astype(int) for n in free.shape)
    flat = (row[:, None] * columns + column).ravel()
    count = np.bincount(flat, minlength=rows * columns)
    share = np.bincount(flat, free.ravel(), minlength=rows * columns) / np.maximum(count, 1)
    dark = np.bincount(flat, wall.ravel(), minlength=rows * columns) > 0
    is_free = binary_closing((share > 0.5).reshape(rows, columns)) | (share > 0.5).reshape(rows, columns)
    is_wall = dark.reshape(rows, columns) & ~is_free & binary_dilation(is_free, np.ones((3, 3)))
    is_free, is_wall = (np.pad(a[::-1], _MARGIN_CELLS) for a in (is_free, is_wall))
    return Cells(is_free, is_wall, np.full(2, -_MARGIN_CELLS * scoring.RESOLUTION_M), scoring.RESOLUTION_M)


def _placed(walk: AuthorsWalk, fit: Registration, cells: Cells, height_px: int, pixels_per_m: float) -> WalkReadings:
    rows = np.ceil(height_px / (scoring.RESOLUTION_M * pixels_per_m)) * scoring.RESOLUTION_M

    def in_metres(points_px: Array) -> Array:
        metres = fit.apply(points_px) / pixels_per_m
        return np.column_stack([metres[:, 0], rows - metres[:, 1]])

    position, routers = in_metres(walk.position_px), in_metres(ROUTERS_PX)[walk.router_of]
    crossed = np.column_stack([_walls_between(cells, router, position) for router in routers])
    return WalkReadings(position, walk.rssi_dbm, routers, crossed)


def _walls_between(cells: Cells, router_m: Array, position_m: Array) -> Array:
    """Number of runs of non-free cells; those that contain a router or reading because of misfit do not count."""
    blocked = ~cells.free
    at = np.floor((np.vstack([router_m, position_m]) - cells.origin_m) / cells.resolution_m).astype(int)
    standing = np.zeros(blocked.shape, bool)
    standing[at[:, 1], at[:, 0]] = blocked[at[:, 1], at[:, 0]]
    blocked &= ~binary_dilation(standing, np.ones((3, 3)))
    start = ((router_m - cells.origin_m) / cells.resolution_m)[::-1]
    return walls_crossed_in_raster(
        blocked, start, ((position_m - cells.origin_m) / cells.resolution_m)[:, ::-1], _GAP_CELLS
    )


def _strongest_column_each(walk: WalkReadings, router_of: Array) -> WalkReadings:
    """One column per router, the strongest of its bands, as in the last column of the authors."""
    numbers = np.unique(router_of)
    first = [int(np.flatnonzero(router_of == n)[0]) for n in numbers]
    rssi = np.column_stack([walk.rssi_dbm[:, router_of == n].max(axis=1) for n in numbers])
    return WalkReadings(walk.position_m, rssi, walk.router_m[first], walk.walls[:, first])
