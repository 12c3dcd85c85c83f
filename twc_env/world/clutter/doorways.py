"""The doorways of a floor plan: gaps of a door's width between the ends of two walls on one line."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.world.building.floorplan import Floorplan
from twc_env.world.building.wall_index import is_blocked

WIDTH_MIN_M, WIDTH_MAX_M = 0.75, 1.6
"""Gaps that can have a door (ours): narrower ones let no robot pass, and a leaf as long as a wider one is rare."""
EGRESS_M = 0.94
"""An open leaf leaves this much of the way that it stands in, also to a leaf opposite, or to somebody who sits: doors
may take 0.18 m of the 1.12 m that a corridor has at least (International Building Code 2021, 1005.7.1 and 1020.3)."""
_COS_MIN = 0.99
"""The gap continues both walls."""
_BESIDE_M = 0.35
"""Free floor on both sides of the middle."""


@lru_cache(maxsize=8)
def doorways_of(home: Floorplan) -> Array:
    """(doorways, 4) both ends x, y [m] of each gap."""
    walls = home.walls_m.reshape(-1, 4)
    ends = np.concatenate([walls[:, :2], walls[:, 2:]])
    along = np.concatenate([walls[:, :2] - walls[:, 2:], walls[:, 2:] - walls[:, :2]])  # out of the wall, at each end
    along /= np.maximum(np.hypot(*along.T), 1e-9)[:, None]
    order = np.argsort(ends[:, 0], kind="stable")
    found: dict[tuple[float, ...], Array] = {}
    cells, buckets = home.cells(), home.wall_index.buckets()
    for at, i in enumerate(order.tolist()):
        near = order[at + 1 : np.searchsorted(ends[order, 0], ends[i, 0] + WIDTH_MAX_M, "right")]
        gaps = ends[near] - ends[i]
        widths = np.hypot(*gaps.T)
        is_near = (widths >= WIDTH_MIN_M) & (widths <= WIDTH_MAX_M)
        near, directions = near[is_near], gaps[is_near] / widths[is_near, None]
        faces = (directions @ along[i] > _COS_MIN) & (-(directions * along[near]).sum(axis=1) > _COS_MIN)
        for j, direction in zip(near[faces].tolist(), directions[faces], strict=True):
            middle, inset = 0.5 * (ends[i] + ends[j]), 0.02 * direction
            beside = _BESIDE_M * np.array([[-direction[1], direction[0]], [direction[1], -direction[0]]])
            inner = (*(ends[i] + inset), *(ends[j] - inset))
            if cells.is_free(middle + beside).all() and not is_blocked(*buckets, *inner):
                ends_m = np.concatenate([ends[i], ends[j]])
                found[tuple(np.round(ends_m, 3))] = ends_m
    return np.array(list(found.values())).reshape(-1, 4)
