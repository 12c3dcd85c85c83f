"""Cells of the radio map that rays from transmitters to positions would clear, given the walls known from scans."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.planning import Terrain
from twc_env.records.messages import GridMap

WALL_DENSITY = 0.04
"""Prior density of walls per cell: a ray with more walls clears nothing."""
SURE_LEVELS = 4.0
"""A cell with lower log-odds than minus this is certainly free."""
FAN = (-0.6, -0.3, 0.0, 0.3, 0.6)
"""Lateral offsets of rays at a position, in units of the spacing: readings are taken between positions too."""


class RayGain:
    """Computes which uncertain cells the rays from the transmitters to a position would clear."""

    def __init__(self, radio: GridMap, seen: GridMap, transmitter_m: Array, spacing_m: float):
        """Uncertain cells are floor in `seen` (from scans) that is not certainly free in the radio map."""
        self._transmitter_m, self._cell_m, self._spacing_m = transmitter_m, seen.resolution_m, spacing_m
        self._origin_m = np.asarray(seen.origin_m, float)
        rows, columns = seen.log_odds.shape
        centres = seen.centre_of(np.moveaxis(np.indices((rows, columns)), 0, -1))
        self._is_wall = np.pad(seen.log_odds > Terrain.WALL_ABOVE, 1)
        is_uncertain = (seen.log_odds < Terrain.FREE_BELOW) & (radio.level_at(centres) > -SURE_LEVELS)
        self._number = np.full((rows + 2, columns + 2), -1)
        self._number[1:-1, 1:-1][is_uncertain] = np.arange(is_uncertain.sum())

    def cells_cleared(self, places_m: Array, walked_m: Array) -> Array:
        """(places, cells) bool: cells that rays to each position would clear, except those cleared on the walk so
        far."""
        held = self._cleared(walked_m).any(axis=0)
        return self._cleared(places_m) & ~held

    def _cleared(self, places_m: Array) -> Array:
        """(places, uncertain cells) bool: cells cleared by rays to each position."""
        cleared = np.zeros((len(places_m), max(int(self._number.max()) + 1, 1)), np.bool_)
        for transmitter_m in self._transmitter_m:
            away = places_m - transmitter_m
            distance = np.maximum(np.linalg.norm(away, axis=1), 1e-6)
            across = np.column_stack([-away[:, 1], away[:, 0]]) * (self._spacing_m / distance[:, None])
            share = np.linspace(0.0, 1.0, max(int(1.5 * distance.max(initial=0.0) / self._cell_m), 2))[:, None]
            is_clear = self._is_clear(*self._cells(transmitter_m + share * away[:, None]), distance)
            for side in FAN:
                number = self._number[self._cells(transmitter_m + share * (away + side * across)[:, None])]
                is_told = (number >= 0) & is_clear[:, None]
                place = np.broadcast_to(np.arange(len(places_m))[:, None], number.shape)
                cleared[place[is_told], number[is_told]] = True
        return cleared

    def _cells(self, points_m: Array) -> tuple[Array, Array]:
        """Rows and columns of points (..., 2) on the padded grid; points outside are on the border."""
        at = np.floor((points_m - self._origin_m) / self._cell_m).astype(int) + 1
        rows, columns = self._number.shape
        return np.clip(at[..., 1], 0, rows - 1), np.clip(at[..., 0], 0, columns - 1)

    def _is_clear(self, row: Array, column: Array, distance_m: Array) -> Array:
        """(rays,) whether rays with samples in these cells (rays, samples) cross few walls for their length."""
        walls = self._is_wall[row, column]
        runs = walls[:, 0].astype(int) + (walls[:, 1:] & ~walls[:, :-1]).sum(axis=1)
        return runs < WALL_DENSITY * distance_m / self._cell_m
