"""Which cells of a believed map lie on the building's floor: kept while the map lies where it lay.

With them, judging a map is a comparison of two grids, cell by cell, instead of looking up every cell of the floor; and
only of those blocks of cells that scans touched since the last time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twc_env import metrics
from twc_env.messages import GridMap
from twc_env.world.floor_cells import Cells

Array = NDArray

PLACE_M, TURN_RAD = 0.02, 0.001
"""A map's place in the building is rounded to these, so that its mask holds for long."""


class _Held(NamedTuple):
    """What is kept of a map. A grid that has grown is another one."""

    grid: GridMap
    place: tuple[int, int, int]
    """Where it lies, in steps of `PLACE_M` and `TURN_RAD`."""
    mask: Array
    """(rows, columns) bool: its cells that lie on the floor there."""
    known: Array
    """(blocks, blocks) `GridMap.touched` when these were counted last; -1 for never."""
    counts: Array
    """(blocks, blocks) free cells of the floor in each."""


class FloorMasks:
    """The mask of each map; they follow from what they are asked for, so copies may begin without any."""

    def __init__(self) -> None:
        self._held: dict[int, tuple[_Held, ...]] = {}
        """Of each map the latest two: often it goes back and forth between two places."""

    def __reduce__(self):
        return FloorMasks, ()

    def correct_area_m2(self, owner: int, grid: GridMap, pose_building_map: Array, cells: Cells) -> float:
        """`metrics.correct_area_m2` with a rounded pose, counting cells of the map instead of the floor.

        owner: whose map it is, of those whose masks are kept.
        """
        touched = grid.touched
        assert touched is not None
        x, y, turn = pose_building_map.tolist()
        place = round(x / PLACE_M), round(y / PLACE_M), round(turn / TURN_RAD)
        kept = self._held.get(owner, ())
        for held in kept:
            if held.place == place and held.grid is grid:
                break
        else:
            held = _hold(grid, place, touched, cells)
            self._held[owner] = (held, *kept[:1])
        count = metrics.recount_free(grid.log_odds, held.mask, touched, held.known, held.counts)
        return count * grid.resolution_m**2


def _hold(grid: GridMap, place: tuple[int, int, int], touched: Array, cells: Cells) -> _Held:
    rounded = np.array([place[0] * PLACE_M, place[1] * PLACE_M, place[2] * TURN_RAD])
    mask = metrics.floor_mask(
        grid.log_odds.shape, grid.origin_m, grid.resolution_m, rounded, cells.free, cells.origin_m, cells.resolution_m
    )
    return _Held(grid, place, mask, np.full(touched.shape, -1), np.zeros(touched.shape, np.int64))
