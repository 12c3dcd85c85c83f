"""Wall probabilities on a grid, and the classes free, unknown and wall (255, 127 and 0, papers.md K13)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import kernel
from twc_env.slam.walls.wall_candidates import WallCandidates

FREE, UNKNOWN, WALL = 255, 127, 0
BODY_RADIUS_M = 0.1
"""Cells swept by the robot's body are free (rule 1)."""
_MARGIN_M = 1.0
FREE_BELOW = 0.25
"""Cells with a lower wall probability are free ..."""
WALL_ABOVE = 0.4
"""... those with a higher one walls."""
_RAYS_MIN = 2
"""Rays through a cell from which on it is known."""
_GAP_MAX_M = 0.5
"""Between neighbouring readings closer than this, rays are interpolated."""


@dataclass(frozen=True, slots=True, eq=False)
class WallGrid:
    """Grid of wall probabilities; row 0 is the lowest y."""

    probability: Array
    """(rows, columns) probability of a wall; NaN where unknown."""
    origin_m: Array
    """(2,) lower left corner of cell [0, 0]."""
    resolution_m: float
    rays: Array
    """(rows, columns) number of rays through each cell."""

    def classes(self) -> Array:
        """(rows, columns) uint8: FREE, WALL, or UNKNOWN for probabilities in between."""
        known = np.nan_to_num(self.probability, nan=0.5 * (FREE_BELOW + WALL_ABOVE))
        return np.where(known < FREE_BELOW, FREE, np.where(known > WALL_ABOVE, WALL, UNKNOWN)).astype(np.uint8)


def cell_probabilities(
    position_m: Array, router_m: Array, is_heard: Array, candidates: WallCandidates, probability: Array,
    is_crossed: Array | None, standoff_m: float, resolution_m: float, origin_m: Array | None = None,
) -> WallGrid:  # fmt: skip
    """Draw candidates with their probabilities (candidates,) on a grid; positions (bins, 2), is_heard (bins, routers).

    With is_crossed (candidates,) bool, only candidates crossed by rays count, and space beside the path is known only
    where rays pass. None: the walls' distance from the path is constant, and all of this is known. A cell corner lies
    at origin_m (2,).
    """
    everything = np.concatenate([position_m, router_m, candidates.ends_m[probability > 0.3].reshape(-1, 2)])
    corner = np.zeros(2) if origin_m is None else np.asarray(origin_m, float)
    low = corner + np.floor((everything.min(axis=0) - _MARGIN_M - corner) / resolution_m) * resolution_m
    columns, rows = (np.ceil((everything.max(axis=0) + _MARGIN_M - low) / resolution_m).astype(int)).tolist()
    rays, swept = np.zeros((rows, columns), np.int64), np.zeros((rows, columns), np.bool_)
    likely = np.zeros((rows, columns))
    scaled = (position_m - low) / resolution_m
    for r, router in enumerate((router_m - low) / resolution_m):
        _count_rays(rays, _filled(scaled, is_heard[:, r], _GAP_MAX_M / resolution_m), router)
    _sweep(swept, scaled, BODY_RADIUS_M / resolution_m)
    ends = (candidates.ends_m - np.tile(low, 2)) / resolution_m
    seen = (rays >= _RAYS_MIN) | swept
    if is_crossed is None:
        # There is nothing between the path and the walls beside it.
        beside = np.zeros((rows, columns), np.bool_)
        _sweep(beside, scaled, standoff_m / resolution_m - 0.5)
        _stamp(likely, ends, probability)
        seen |= beside | (likely > 0.0)
    else:
        uncertain = np.zeros((rows, columns))
        _stamp(likely, ends[is_crossed], probability[is_crossed])
        _stamp(uncertain, ends[~is_crossed], probability[~is_crossed])
        seen &= swept | (uncertain <= likely)
    value = np.clip(np.where(swept, 0.02, likely), 0.02, 0.98)
    return WallGrid(np.where(seen, value, np.nan), low, resolution_m, rays)


def _filled(scaled: Array, is_heard: Array, gap_max: float) -> Array:
    """(k, 2) positions of a path (bins, 2) where the router was heard, in cells; half a cell apart between neighbours
    closer than gap_max."""
    steps = np.linalg.norm(np.diff(scaled, axis=0), axis=1)
    is_filled = is_heard[1:] & is_heard[:-1] & (steps <= gap_max)
    parts = [scaled[is_heard]]
    for count in range(2, int(2 * gap_max) + 2):  # neighbours between which `count` steps fit
        at = np.flatnonzero(is_filled & (np.ceil(2 * steps).astype(int) == count))
        share = (np.arange(1, count) / count)[None, :, None]
        parts.append((scaled[at, None] + share * (scaled[at + 1] - scaled[at])[:, None]).reshape(-1, 2))
    return np.ascontiguousarray(np.concatenate(parts))


@kernel
def _count_rays(rays, ends, start):
    """Add one to each cell on the rays from start (2,) to ends (n, 2), all in units of cells."""
    rows, columns = rays.shape
    for i in range(ends.shape[0]):
        dx, dy = ends[i, 0] - start[0], ends[i, 1] - start[1]
        steps = int(max(abs(dx), abs(dy)) * 2.0) + 1
        last = -1
        for s in range(steps + 1):
            c = int(np.floor(start[0] + dx * s / steps))
            r = int(np.floor(start[1] + dy * s / steps))
            if 0 <= r < rows and 0 <= c < columns and r * columns + c != last:
                last = r * columns + c
                rays[r, c] += 1


@kernel
def _sweep(swept, path, radius):
    """Mark the cells whose centre is within a radius of the path (n, 2), in units of cells."""
    rows, columns = swept.shape
    for i in range(path.shape[0]):
        x, y = path[i, 0], path[i, 1]
        for r in range(max(0, int(y - radius)), min(rows, int(y + radius) + 1)):
            for c in range(max(0, int(x - radius)), min(columns, int(x + radius) + 1)):
                if (c + 0.5 - x) ** 2 + (r + 0.5 - y) ** 2 <= radius * radius:
                    swept[r, c] = True


@kernel
def _stamp(likely, ends, probability):
    """Write a segment's probability to cells whose centre is within half a cell of it; the largest one counts."""
    rows, columns = likely.shape
    for j in range(ends.shape[0]):
        x1, y1, x2, y2 = ends[j, 0], ends[j, 1], ends[j, 2], ends[j, 3]
        ex, ey = x2 - x1, y2 - y1
        square = max(ex * ex + ey * ey, 1e-12)
        for r in range(max(0, int(min(y1, y2) - 1.0)), min(rows, int(max(y1, y2) + 2.0))):
            for c in range(max(0, int(min(x1, x2) - 1.0)), min(columns, int(max(x1, x2) + 2.0))):
                t = min(max(((c + 0.5 - x1) * ex + (r + 0.5 - y1) * ey) / square, 0.0), 1.0)
                gap = (c + 0.5 - x1 - t * ex) ** 2 + (r + 0.5 - y1 - t * ey) ** 2
                if gap <= 0.25:
                    likely[r, c] = max(likely[r, c], probability[j])
