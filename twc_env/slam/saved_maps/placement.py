"""The placement of one saved map in another, refined, tested, and compared with the second best.

Refinement is iterative closest points to lines (Censi 2008) on walls of the same direction. Of a refined placement
counts, both ways, how many metres of wall lie on a wall of the same direction and how many lie in the free floor of the
other map; walls in what the other map does not know count neither way, nor do those near shapes of the other map that
are too small for a wall: where a run saw a wall in pieces, each may be as small as a thing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array
from scipy import ndimage

from twc_env.records.geometry import between, compose, inverse, transform_points, wrap_angle
from twc_env.slam.saved_maps.placement_search import candidate_poses
from twc_env.slam.saved_maps.saved_map import THING_M, ComparedMap, SavedMap, cell_of, compared

REACHES_M = (0.6, 0.4, 0.3, 0.2, 0.2, 0.15, 0.15)
"""Largest distance of a pair of points, by round of refinement."""
ROUNDS_FINE = 6
"""Further rounds, for the placements that are left."""
PAIRS_MIN = 15
PARALLEL_MIN = np.cos(np.radians(25.0))
"""Walls whose directions differ by more are not the same."""
AGREE_M, CONTRADICT_M = 0.2, 0.35
"""A wall agrees up to the first distance from a wall; in free floor beyond the second it contradicts."""
CONTRADICTION = 3.0
"""Weight of a metre of wall in free floor against a metre of wall on wall."""
OTHER_M, OTHER_RAD = 1.0, np.radians(10.0)
"""Placements that differ by more are different ones."""
FINE_COUNT = 12
FLOOR = 0.15
"""Metres of evidence that a square metre of common floor is worth where placements are compared: no wall stands in it.
Rows of like rooms have false placements of many walls around little floor."""
EVIDENCE_MIN_M, RATIO_MAX = 13.0, 0.6
"""A placement is believed from this evidence on, if the second best has at most this share, floor included, ..."""
CONTRADICTION_MAX, CONTRADICTION_PER_RATIO = 0.08, 0.1
"""... and if a smaller share of its walls contradicts than the first, less the second times the share of the second
best: buildings whose rooms repeat have false placements with few contradictions, and a strong second best."""
PLAIN_EVIDENCE_MIN_M = 20.0
"""From this evidence on, placements whose share of contradictions exceeds CONTRADICTION_MAX do not compete. With less,
they show how much agrees by chance."""
LOG_ODDS = (2.1, 0.7, -7.9, -46.0)
"""Logistic regression of right placements: constant, logarithm of the evidence [m], second evidence / first, share of
contradicting walls."""


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """How well two maps agree at a placement."""

    pose: Array
    """(3,) of the source's frame in the target's."""
    agreeing_m: float
    """Length of wall that both show at the same place, the mean of both ways."""
    contradicting_m: float
    """Length of wall in the other's free floor, the mean of both ways."""
    overlap_m2: float
    """Floor that both know to be free."""
    overlap: float
    """Share of it in the smaller map's free floor."""

    @property
    def evidence_m(self) -> float:
        """Metres of wall that speak for the placement."""
        return self.agreeing_m - CONTRADICTION * self.contradicting_m

    @property
    def weight_m(self) -> float:
        """The evidence and what the common floor adds, at least 0, by which placements are compared."""
        return max(self.evidence_m + FLOOR * self.overlap_m2, 0.0)

    @property
    def contradiction(self) -> float:
        """Share of walls in free floor among those that speak."""
        return self.contradicting_m / max(self.agreeing_m + self.contradicting_m, 1e-9)


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """The best placement of one map in another, and whether it is believed."""

    best: Agreement | None
    """None if no placement was found at all."""
    second: Agreement | None
    """The best one at another place."""
    certainty: float
    """Estimated probability that the best one is right, in [0, 1]."""
    reason: str
    """Why it is not believed; empty if it is."""

    @property
    def is_believed(self) -> bool:
        """Whether the maps may be merged at `best`."""
        return not self.reason


def place(target: SavedMap, source: SavedMap) -> Placement:
    """Where the source lies in the target; its pose joins the frames of the maps.

    Raises MapError for a map with hardly a wall.
    """
    return checked(ranked_placements(target, source))


def checked(ranked: list[Agreement]) -> Placement:
    """The best of different placements, best first, believed only if it stands out."""
    if not ranked or ranked[0].evidence_m <= 0:
        return Placement(next(iter(ranked), None), None, 0.0, "no placement at which walls agree")
    among_all = _checked(ranked, EVIDENCE_MIN_M)
    plausible = [one for one in ranked if one.contradiction <= CONTRADICTION_MAX]
    if among_all.is_believed or len(plausible) in (0, len(ranked)):
        return among_all
    among_plausible = _checked(plausible, PLAIN_EVIDENCE_MIN_M)
    return among_plausible if among_plausible.is_believed else among_all


def _checked(ranked: list[Agreement], evidence_min_m: float) -> Placement:
    best, second = ([*sorted(ranked, key=lambda one: -one.weight_m), None])[:2]
    assert best is not None
    ratio = 0.0 if second is None else second.weight_m / max(best.weight_m, 1e-9)
    log_odds = float(np.dot(LOG_ODDS, [1.0, np.log(max(best.evidence_m, 1e-9)), ratio, best.contradiction]))
    certainty = 1.0 / (1.0 + np.exp(-log_odds))
    reason = ""
    if best.evidence_m < evidence_min_m:
        reason = f"too little in common: {best.agreeing_m:.1f} m of wall agree, {best.contradicting_m:.1f} m contradict"
    elif second is not None and ratio > RATIO_MAX:
        away = between(second.pose, best.pose)
        reason = (
            f"two placements explain the overlap about equally: {best.evidence_m:.0f} and {second.evidence_m:.0f} m of "
            f"wall and {best.overlap_m2:.0f} and {second.overlap_m2:.0f} m2 of floor speak for them, "
            f"{np.hypot(away[0], away[1]):.1f} m and {abs(np.degrees(away[2])):.0f} degrees apart"
        )
    elif best.contradiction > CONTRADICTION_MAX - CONTRADICTION_PER_RATIO * ratio:
        reason = f"{best.contradicting_m:.1f} m of wall stand in the other's free floor ({best.agreeing_m:.1f} m agree)"
    return Placement(best, second, certainty, reason)


def ranked_placements(target: SavedMap, source: SavedMap) -> list[Agreement]:
    """Different placements of the source in the target, best first; poses join the frames of the maps, not grids."""
    cell_m = cell_of([target, source])
    a, b = compared(target, cell_m), compared(source, cell_m)
    rough = _different([agreement_at(a, b, refined(a, b, pose, REACHES_M)) for pose in candidate_poses(a, b)], b)
    fine = [agreement_at(a, b, refined(a, b, one.pose, REACHES_M[-1:] * ROUNDS_FINE)) for one in rough[:FINE_COUNT]]
    return [
        Agreement(
            compose(compose(target.origin, one.pose), inverse(source.origin)),
            one.agreeing_m, one.contradicting_m, one.overlap_m2, one.overlap,
        )
        for one in _different(fine, b)
    ]  # fmt: skip


def _different(placements: list[Agreement], source: ComparedMap) -> list[Agreement]:
    """Best first, without those near a better one."""
    out: list[Agreement] = []
    centre = np.array([*source.centre_m, 0.0])
    for one in sorted(placements, key=lambda one: -one.evidence_m):
        place = compose(one.pose, centre)
        for better in out:
            away = place - compose(better.pose, centre)
            if np.hypot(away[0], away[1]) < OTHER_M and abs(wrap_angle(away[2])) < OTHER_RAD:
                break
        else:
            out.append(one)
    return out


def refined(target: ComparedMap, source: ComparedMap, pose: Array, reaches_m) -> Array:
    """The pose (3,) after one round of iterative closest points for each reach."""
    pose = np.array(pose, float)
    normals = np.column_stack([-np.sin(target.directions_rad), np.cos(target.directions_rad)])
    for reach_m in reaches_m:
        moved, direction = _placed(source, pose)
        row, column, is_inside = target.cells_of(moved)
        near = target.nearest[row, column]
        is_pair = is_inside & (target.wall_distance_m[row, column] <= reach_m + target.cell_m)
        is_pair &= _are_same(source, direction, target, near)
        if np.count_nonzero(is_pair) < PAIRS_MIN:
            break
        moved, normal, there = moved[is_pair], normals[near[is_pair]], target.points[near[is_pair]]
        centre = moved.mean(axis=0)
        arm = moved - centre
        jacobian = np.column_stack([normal, normal[:, 1] * arm[:, 0] - normal[:, 0] * arm[:, 1]])
        error = ((there - moved) * normal).sum(axis=1)
        weight = 1.0 / (1.0 + (error / (0.5 * reach_m)) ** 2)
        hessian = jacobian.T @ (jacobian * weight[:, None])
        hessian[np.diag_indices(3)] += 1e-3 * np.trace(hessian[:2, :2]) * np.array([1.0, 1.0, 1.0])
        step = np.linalg.solve(hessian, jacobian.T @ (weight * error))
        about = np.array([*centre, 0.0])
        pose = compose(compose(about, step), between(about, pose))
    return pose


def agreement_at(target: ComparedMap, source: ComparedMap, pose: Array) -> Agreement:
    """How well the maps agree with the source at this pose (3,) in the target."""
    back = inverse(pose)
    forth, against = (_agreeing(target, source, pose), _agreeing(source, target, back))
    row, column, is_inside = target.cells_of(transform_points(pose, source.free_points))
    both = int(np.count_nonzero(target.free[row, column] & is_inside))
    smaller = max(min(int(target.free.sum()), int(source.free.sum())), 1)
    return Agreement(
        pose=pose,
        agreeing_m=0.5 * (forth[0] + against[0]),
        contradicting_m=0.5 * (forth[1] + against[1]),
        overlap_m2=both * target.cell_m**2,
        overlap=both / smaller,
    )


def _agreeing(target: ComparedMap, source: ComparedMap, pose: Array) -> tuple[float, float]:
    """Metres of the source's walls on walls of the target, and in its free floor."""
    moved, direction = _placed(source, pose)
    row, column, is_inside = target.cells_of(moved)
    distance_m = target.wall_distance_m[row, column]
    agrees = is_inside & _are_same(source, direction, target, target.nearest[row, column])
    agrees &= distance_m <= max(AGREE_M, 1.5 * target.cell_m)
    is_bare = target.anything_m[row, column] > max(CONTRADICT_M, 2.5 * target.cell_m)
    contradicts = is_inside & target.free[row, column] & is_bare
    return float(agrees.sum()) * source.cell_m, _long_count(source, contradicts) * source.cell_m


def _long_count(source: ComparedMap, is_chosen: Array) -> int:
    """How many of the chosen wall points (n,) belong to connected stretches that are longer than a thing.

    Furniture against a wall is drawn together with it, and is not there for the other run.
    """
    if not is_chosen.any():
        return 0
    row, column, _ = source.cells_of(source.points[is_chosen])
    low_row, low_column = row.min() - 1, column.min() - 1
    picture = np.zeros((row.max() - low_row + 2, column.max() - low_column + 2), bool)
    picture[row - low_row, column - low_column] = True
    labels, _ = ndimage.label(ndimage.binary_dilation(picture, np.ones((3, 3))), np.ones((3, 3)))
    longest = [max(side.stop - side.start for side in box) - 2 for box in ndimage.find_objects(labels)]
    is_long = np.array([False, *(cells * source.cell_m > THING_M for cells in longest)])
    return int(is_long[labels[row - low_row, column - low_column]].sum())


def _are_same(source: ComparedMap, direction: Array, target: ComparedMap, near: Array) -> Array:
    """(n,) bool: the source's walls run as the target's walls `near` (n,), with the floor on the same side."""
    cosine = np.cos(direction - target.directions_rad[near])
    return np.asarray(np.where(source.is_thin | target.is_thin[near], np.abs(cosine), cosine) > PARALLEL_MIN)


def _placed(source: ComparedMap, pose: Array) -> tuple[Array, Array]:
    """The wall points (n, 2) and directions (n,) of the source at a pose."""
    return transform_points(pose, source.points), source.directions_rad + pose[2]
