"""One occupancy grid of several saved maps in one frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import MapError
from twc_env.records.geometry import compose, inverse, transform_points
from twc_env.records.messages import GridMap
from twc_env.slam.saved_maps.saved_map import SavedMap

CELLS_MAX = 100_000_000
WALL_VOTES = 2
"""A map that saw a wall counts as so many that saw free floor: things move, walls stay."""
MARGIN_M = 0.5


def merged_grid(maps: list[SavedMap], poses: Array) -> GridMap:
    """The maps at the poses (n, 3) of their frames, at the finest of their resolutions.

    Each map votes for what it shows. Raises MapError if the grid would be too large.
    """
    resolution_m = min(saved.resolution_m for saved in maps)
    placed = [compose(pose, saved.origin) for pose, saved in zip(poses, maps, strict=True)]
    corners = np.concatenate(
        [transform_points(pose, _known_corners(saved)) for pose, saved in zip(placed, maps, strict=True)]
    )
    low = np.floor((corners.min(axis=0) - MARGIN_M) / resolution_m) * resolution_m
    columns, rows = np.ceil((corners.max(axis=0) + MARGIN_M - low) / resolution_m).astype(np.int64).tolist()
    if rows * columns > CELLS_MAX:
        raise MapError(f"the merged map would have {columns} x {rows} cells, more than {CELLS_MAX}; merge fewer maps")
    votes, is_known = np.zeros((rows, columns), np.int16), np.zeros((rows, columns), bool)
    for pose, saved in zip(placed, maps, strict=True):
        free, walls = _drawn(saved, pose, low, resolution_m, (rows, columns))
        votes += WALL_VOTES * walls.astype(np.int16) - (free & ~walls)
        is_known |= free | walls
    votes[is_known & (votes == 0)] = -1
    return GridMap(log_odds=votes, origin_m=low, resolution_m=resolution_m)


def _drawn(
    saved: SavedMap, pose: Array, low: Array, resolution_m: float, shape: tuple[int, int]
) -> tuple[Array, Array]:
    """Free floor and walls of a map at the pose (3,) of its grid."""
    free, walls = np.zeros(shape, bool), np.zeros(shape, bool)
    box = transform_points(pose, _known_corners(saved))
    (c0, r0), (c1, r1) = (np.floor((edge - low) / resolution_m).astype(np.int64) for edge in (box.min(0), box.max(0)))
    r0, c0, r1, c1 = max(r0, 0), max(c0, 0), min(r1 + 1, shape[0]), min(c1 + 1, shape[1])
    column, row = np.meshgrid(np.arange(c0, c1), np.arange(r0, r1))
    centres = low + (np.stack([column, row], axis=-1).reshape(-1, 2) + 0.5) * resolution_m
    there = np.floor(transform_points(inverse(pose), centres) / saved.resolution_m).astype(np.int64)
    is_inside = np.all((there >= 0) & (there < saved.free.shape[::-1]), axis=1)
    column, row = np.where(is_inside[:, None], there, 0).T
    for out, mask in ((free, saved.free), (walls, saved.walls)):
        out[r0:r1, c0:c1] = (is_inside & mask[row, column]).reshape(r1 - r0, c1 - c0)
    # A wall one cell wide, turned, has gaps where no centre of a new cell hits it.
    cells = transform_points(pose, (np.argwhere(saved.walls)[:, ::-1] + 0.5) * saved.resolution_m)
    column, row = np.floor((cells - low) / resolution_m).astype(np.int64).T
    walls[np.clip(row, 0, shape[0] - 1), np.clip(column, 0, shape[1] - 1)] = True
    return free, walls


def _known_corners(saved: SavedMap) -> Array:
    """(4, 2) corners of the box around what the map knows, in its grid [m]."""
    at = np.concatenate([np.argwhere(saved.free), np.argwhere(saved.walls)])
    low, high = at.min(axis=0)[::-1], at.max(axis=0)[::-1] + 1
    return np.array([(x, y) for x in (low[0], high[0]) for y in (low[1], high[1])]) * saved.resolution_m
