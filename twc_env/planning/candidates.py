"""Goal candidates of one robot: reachable frontiers by path length, or the views that tell most for their way; the
nearest known sign and the nearest teammate."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.planning.path_finder import Disc, PathFinder
from twc_env.planning.terrain import Terrain
from twc_env.planning.views import ViewGain
from twc_env.records.geometry import inverse
from twc_env.records.messages import Belief

CELLS_MIN = 3
"""Minimum frontier size [cells]; smaller ones are noise."""
SIGN_AWAY_M = 2.0
"""Minimum distance of a sign that is a goal."""
HALF_GAIN_M2, HALF_AWAY_M = 10.0, 10.0
"""Areas a are shown as a / (a + this), and so are distances to other maps."""
DECAY_PER_M = 0.15
"""Views are ranked by gain times exp(-this times the way) (Gonzalez-Banos and Latombe, IJRR 2002)."""
SPACING_M, APART_M = 1.5, 2.0
"""Spacing of the lattice of places for views, and the least distance between two views that are offered."""
GAIN_MIN_M2 = 0.3
"""Views that show less are not worth a way."""
SPENT_M = 0.8
"""Views nearer than this to one that was taken are not offered again."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Goals that one robot may choose from, in its map frame."""

    frontiers_m: Array
    """(k, 2) nearest cell of each frontier, sorted by path length; or the places of views, the best first."""
    lengths_m: Array
    """(k,) path length to it, weighted by the traversal cost."""
    sizes_m: Array
    """(k,) number of cells of the frontier times the cell size; 0 for a view from within the known floor."""
    is_teammate_nearer: Array
    """(k,) bool: the Euclidean distance of some teammate is less than this robot's path length."""
    sign_m: Array | None
    """(2,) nearest known sign at least `SIGN_AWAY_M` away."""
    teammate_m: Array | None
    """(2,) nearest robot in the same map."""
    gains_m2: Array
    """(k,) unknown area that a scan from there would show (`ViewGain`); 0 if it was not asked for."""
    are_views: bool = False
    """Whether they are views, which robots drive to, rather than frontiers, which are reached once they are gone."""
    other_maps_m: Array = field(default_factory=lambda: np.zeros(0))
    """(k,) expected distance to what robots of other maps have seen (`OtherMaps`); empty if it was not asked for."""


NOTHING = Candidates(np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros(0, bool), None, None, np.zeros(0))


def find_candidates(
    belief: Belief, terrain: Terrain, finder: PathFinder, count_max: int, range_m: float = 0.0
) -> Candidates:
    """At most `count_max` reachable frontiers, the nearest sign and the nearest teammate.

    range_m: of the scanner, to compute `gains_m2`; 0: do not.
    """
    here = belief.pose_map_robot
    sizes = terrain.frontier_sizes
    if not finder.spread_to_frontiers(terrain, here[:2], sizes >= CELLS_MIN, count_max):
        return NOTHING
    lengths_m, places_m = finder.nearest_of_labels(terrain, terrain.labels, len(sizes) - 1)
    usable = np.flatnonzero(np.isfinite(lengths_m) & (sizes >= CELLS_MIN))
    chosen = usable[np.lexsort((usable, lengths_m[usable]))][:count_max]
    gains_m2 = ViewGain(terrain, range_m).area_m2(places_m[chosen]) if range_m > 0.0 else np.zeros(len(chosen))
    return _beside(belief, places_m[chosen], lengths_m[chosen], sizes[chosen] * terrain.resolution_m, gains_m2)


def find_views(
    belief: Belief,
    terrain: Terrain,
    finder: PathFinder,
    count_max: int,
    range_m: float,
    claimed_m: Array,
    spent_m: Array,
    discs: Iterable[Disc] = (),
) -> Candidates:
    """At most `count_max` views with the greatest gain for their way, the nearest sign and the nearest teammate.

    A view is a place on a lattice of open floor, or the nearest cell of a frontier; those nearer than `APART_M` to a
    better one are left out. Looked for as far as the `count_max` nearest frontiers.

    claimed_m (k, 2): places to which others go; what they will show does not count. spent_m (k, 2): where the robot
    was for a view or could not go: what it did not see there, it will not see. discs: as in `PathFinder.cheapest`.
    """
    here = belief.pose_map_robot
    sizes = terrain.frontier_sizes
    if not finder.spread_to_frontiers(terrain, here[:2], sizes >= CELLS_MIN, count_max, discs):
        return NOTHING
    lengths_m, places_m = finder.nearest_of_labels(terrain, terrain.labels, len(sizes) - 1)
    usable = np.flatnonzero(np.isfinite(lengths_m) & (sizes >= CELLS_MIN))
    stride = max(1, round(SPACING_M / terrain.resolution_m))
    open_rows = np.nonzero(terrain.cost[stride // 2 :: stride, stride // 2 :: stride])
    cells = np.column_stack([stride * each + stride // 2 for each in open_rows])
    ways_m = finder.ways_to(terrain, cells)
    last_m = np.sort(lengths_m[usable])[count_max - 1] if len(usable) >= count_max else np.inf
    near, usable = np.flatnonzero(np.isfinite(ways_m) & (ways_m <= last_m)), usable[lengths_m[usable] <= last_m]
    places_m = np.vstack([terrain.to_metres(cells[near] + 0.5), places_m[usable]])
    is_free = np.ones(len(places_m), bool)
    for place in spent_m:
        is_free &= np.hypot(*(places_m - place).T) >= SPENT_M
    places_m = places_m[is_free]
    lengths_m = np.concatenate([ways_m[near], lengths_m[usable]])[is_free]
    sizes_m = np.concatenate([np.zeros(len(near)), sizes[usable] * terrain.resolution_m])[is_free]
    views = ViewGain(terrain, range_m, closes_walls=True)
    for place in claimed_m:
        views.claim(place)
    chosen, gains_m2 = views.best(places_m, np.exp(-DECAY_PER_M * lengths_m), GAIN_MIN_M2, count_max, APART_M)
    if not len(chosen):  # nothing is worth a look: the frontiers that are left
        left = np.flatnonzero(sizes_m > 0.0)
        chosen = left[np.argsort(lengths_m[left], kind="stable")][:count_max]
        gains_m2 = views.area_m2(places_m[chosen])
    return _beside(belief, places_m[chosen], lengths_m[chosen], sizes_m[chosen], gains_m2, True)


def _beside(
    belief: Belief, places_m: Array, lengths_m: Array, sizes_m: Array, gains_m2: Array, are_views: bool = False
) -> Candidates:
    """Goals with what else a robot may choose."""
    here = belief.pose_map_robot
    teammates_m = np.array([pose[:2] for pose in belief.teammates.values()]).reshape(-1, 2)
    away_m = np.linalg.norm(places_m[:, None] - teammates_m[None], axis=-1)  # (goals, teammates)
    return Candidates(
        places_m,
        lengths_m,
        sizes_m,
        (away_m < lengths_m[:, None]).any(axis=1),
        _nearest([s.position_m for s in belief.signs], here, SIGN_AWAY_M),
        _nearest([pose[:2] for pose in belief.teammates.values()], here, 0.0),
        gains_m2,
        are_views,
    )


def can_tell_places(theirs: Belief, mine: Belief) -> bool:
    """Whether one robot can tell another places now: in contact, and with a map that begins in the same frame."""
    return (
        theirs.robot in mine.teammates
        and mine.contact_steps.get(theirs.robot, mine.step) == mine.step
        and min([theirs.robot, *theirs.teammates]) == min([mine.robot, *mine.teammates])
    )


def _nearest(places_m: list[Array], here: Array, away_m: float) -> Array | None:
    """The place nearest to a pose (3,) of those at least away_m from it."""
    mine = here[:2].tolist()
    far = [(math.dist(place, mine), k) for k, place in enumerate(np.reshape(places_m, (-1, 2)).tolist())]
    far = [pair for pair in far if pair[0] >= away_m]
    return np.asarray(places_m[min(far)[1]], float) if far else None


def gains_of(candidates: Candidates, count_max: int) -> Array:
    """(count_max,) float32 in [0, 1]: unknown area a that each frontier would show, as a / (a + 10 m2); then zeros."""
    return _shares(candidates.gains_m2, HALF_GAIN_M2, count_max)


def ways_to_others_of(candidates: Candidates, count_max: int) -> Array:
    """(count_max,) float32 in [0, 1]: distance d of each frontier to other maps, as d / (d + 10 m); then zeros."""
    return _shares(candidates.other_maps_m, HALF_AWAY_M, count_max)


def _shares(values: Array, half: float, count_max: int) -> Array:
    """(count_max,) float32: each value as value / (value + half), then zeros."""
    shares = np.zeros(count_max, np.float32)
    shares[: len(values)] = values / (values + half)
    return shares


def features_of(candidates: Candidates, pose_map_robot: Array, count_max: int) -> Array:
    """(count_max, 6) float32 in [-1, 1], one row per frontier, then zero rows.

    Columns: 1; bearing / pi; distance d / (d + 10 m); path length l / (l + 10 m); size s / (s + 5 m);
    whether a teammate is nearer.
    """
    rows = np.zeros((count_max, 6), np.float32)
    columns = candidates.lengths_m.tolist(), candidates.sizes_m.tolist(), candidates.is_teammate_nearer.tolist()
    x_here, y_here, heading = inverse(pose_map_robot).tolist()
    c, s = math.cos(heading), math.sin(heading)
    found = []
    for (x_map, y_map), length, size, nearer in zip(candidates.frontiers_m.tolist(), *columns, strict=True):
        x, y = x_here + c * x_map - s * y_map, y_here + s * x_map + c * y_map
        away = math.hypot(x, y)
        shares = away / (away + 10.0), length / (length + 10.0), size / (size + 5.0)
        found.append((1.0, math.atan2(y, x) / math.pi, *shares, nearer))
    if found:
        rows[: len(found)] = found
    return rows
