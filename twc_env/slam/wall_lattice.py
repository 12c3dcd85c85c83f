"""Where walls may stand when the path says little: all short pieces of a square lattice that it has not passed.

A robot that crosses rooms freely has no wall beside it, but rules out all that it has driven through.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twc_env.geometry import points_along, travelled_m

Array = NDArray

LINES_BESIDE = 3
"""So many lines on either side of a piece are kept as those beside it."""
_SPACING_M, _PIECES_MAX = 0.2, 20_000
"""Length of a piece; longer in buildings that would have more pieces."""
_MARGIN_M = 0.3
_BODY_M = 0.1
"""No wall stands nearer to the path than the robot's body reaches."""
_GAP_MAX_M, _STEP_M = 0.4, 0.02
"""Between places further apart the way is not known."""
_ALONG = np.linspace(0.05, 0.95, 5)
"""Shares of a piece at which its distance from the path is taken."""


@dataclass(frozen=True, slots=True, eq=False)
class WallLattice:
    """Pieces of the lines of a lattice; those of upright lines come first."""

    ends_m: Array
    """(pieces, 4) x1, y1, x2, y2."""
    is_open: Array
    """(pieces,) bool: the path has not passed there."""
    before: Array
    """(pieces,) the piece that it continues, -1 at a line's start."""
    after: Array
    """(pieces,) the piece that continues it, -1 at a line's end."""
    beside: Array
    """(pieces, 2 LINES_BESIDE) the pieces of the next lines on either side, -1 outside."""


def wall_lattice(path_m: Array, router_m: Array, shift: Array) -> WallLattice:
    """The lattice around a path (k, 2) and routers (routers, 2), moved by a share (2,) of its spacing."""
    places = np.concatenate([path_m, router_m])
    size = np.ptp(places, axis=0) + 2 * _MARGIN_M
    spacing_m = max(_SPACING_M, float(np.sqrt(2 * size.prod() / _PIECES_MAX)))
    columns, rows = (np.ceil(size / spacing_m).astype(int) + 1).tolist()
    low = places.min(axis=0) - _MARGIN_M - shift * spacing_m
    upright, level = (columns + 1) * rows, (rows + 1) * columns
    before, after = np.full((2, upright + level), -1)
    beside = np.full((upright + level, 2 * LINES_BESIDE), -1)
    ends = np.empty((upright + level, 4))
    for axis, lines, along, first in ((0, columns + 1, rows, 0), (1, rows + 1, columns, upright)):
        pieces = first + np.arange(lines * along).reshape(lines, along)
        before[pieces[:, 1:]], after[pieces[:, :-1]] = pieces[:, :-1], pieces[:, 1:]
        for off in range(1, LINES_BESIDE + 1):
            beside[pieces[off:], 2 * off - 2], beside[pieces[:-off], 2 * off - 1] = pieces[:-off], pieces[off:]
        line, place = np.divmod(np.arange(lines * along), along)
        start = np.column_stack([line, place] if axis == 0 else [place, line])
        ends[pieces.ravel()] = np.hstack([start, start + [axis, 1 - axis]]) * spacing_m + np.tile(low, 2)
    return WallLattice(ends, _is_open(ends, path_m), before, after, beside)


def _is_open(ends_m: Array, path_m: Array) -> Array:
    """(pieces,) whether the path, joined where places are near, keeps away from each piece."""
    from scipy.spatial import cKDTree

    travel_m = travelled_m(path_m)
    fine_m = np.arange(0.0, travel_m[-1], _STEP_M)
    step = np.clip(np.searchsorted(travel_m, fine_m, side="right") - 1, 0, max(len(path_m) - 2, 0))
    is_known = np.diff(travel_m)[step] < _GAP_MAX_M
    tree = cKDTree(np.concatenate([path_m, points_along(path_m, fine_m[is_known])]))
    spots = ends_m[:, None, :2] + _ALONG[:, None] * (ends_m[:, None, 2:] - ends_m[:, None, :2])
    return tree.query(spots, distance_upper_bound=_BODY_M)[0].min(axis=1) > _BODY_M
