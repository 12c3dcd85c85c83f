"""Position constraints from local linear models of signal strength.

Around each place the strength of every transmitter is a plane fitted to the readings of other visits nearby. The
gradient of these planes turns the difference between measured and predicted strengths into a displacement with
direction and information: far more than a single similarity. The weight of a difference is learned on the path itself,
at neighbouring places whose displacement odometry knows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import kernel
from twc_env.records.geometry import wrap_angle

REACH = 2.5
"""Neighbours lie within this many bandwidths."""
NEIGHBOURS_MIN, NEIGHBOURS_MAX = 4, 64
SLOPE_RIDGE = 1.0
"""Ridge [m2] on the spread of neighbours, which shrinks poorly determined gradients to zero."""
VISITS = 3
"""A displacement constrains a place relative to the nearest places of at most this many other visits ..."""
VISIT_APART_M = 15.0
"""... which are further apart than this along the path."""
MOVED_PER_BANDWIDTH = 1.5
"""Longer displacements are outside the validity of a linear model and are dropped."""
PRIOR_STD_M = 5.0
"""Prior standard deviation of displacements."""
BEST_STD_M = 2.0
"""Lower bound of a constraint's standard deviation: errors of the field are common to all constraints of a place."""
MEDIAN_SQUARED = 0.455
"""Median of chi-squared with one degree of freedom."""


@dataclass(frozen=True, slots=True, eq=False)
class FieldConstraints:
    """Relative positions from the field: pairs (k, 2) of places, and the offset of the second from the first."""

    pairs: Array
    offset_m: Array
    """(k, 2) in the map frame."""
    information: Array
    """(k, 2, 2) in the map frame."""

    def relative(self, poses: Array) -> tuple[Array, Array]:
        """As relative poses (k, 3) with zero heading information, and information (k, 3, 3)."""
        first, second = poses[self.pairs[:, 0]], poses[self.pairs[:, 1]]
        c, s = np.cos(first[:, 2]), np.sin(first[:, 2])
        turn = wrap_angle(second[:, 2] - first[:, 2])
        dx, dy = self.offset_m.T
        relative = np.column_stack([c * dx + s * dy, -s * dx + c * dy, turn])
        # The residual is in the second pose's frame (g2o), so the information is rotated into that.
        c, s = np.cos(second[:, 2]), np.sin(second[:, 2])
        rotation = np.stack([np.stack([c, s], axis=1), np.stack([-s, c], axis=1)], axis=1)
        information = np.zeros((len(turn), 3, 3))
        information[:, :2, :2] = rotation @ self.information @ np.swapaxes(rotation, 1, 2)
        return relative, information


def field_constraints(
    feature: Array, positions_m: Array, travel_m: Array, bandwidth_m: float, apart_m: float, weight: float
) -> FieldConstraints:
    """Constraints between places from features (n, transmitters) at estimated positions (n, 2).

    Only places further apart than apart_m along the path are compared.
    """
    curvature, pull, near = _fit_all(feature, positions_m, travel_m, bandwidth_m, apart_m, np.inf)
    known = np.flatnonzero(near[:, 0] >= 0)
    curvature, pull, near = weight * curvature[known], weight * pull[known], near[known]
    moved = np.linalg.solve(curvature + np.eye(2) / PRIOR_STD_M**2, pull[..., None])[..., 0]
    kept = np.hypot(moved[:, 0], moved[:, 1]) <= MOVED_PER_BANDWIDTH * bandwidth_m
    known, curvature, moved, near = known[kept], curvature[kept], moved[kept], near[kept]
    ceiling = np.eye(2) / BEST_STD_M**2
    information = curvature @ np.linalg.inv(curvature + ceiling) @ ceiling
    information = (information + np.swapaxes(information, 1, 2)) / 2
    count = (near >= 0).sum(axis=1)
    row, column = np.nonzero(near >= 0)
    place, other = known[row], near[row, column]
    offset = positions_m[place] + moved[row] - positions_m[other]
    return FieldConstraints(np.column_stack([other, place]), offset, information[row] / count[row, None, None])


def learn_weight(feature: Array, positions_m: Array, travel_m: Array, bandwidth_m: float) -> float:
    """Weight of a squared strength difference, from neighbouring places along the path, where odometry is accurate."""
    curvature, pull, near = _fit_all(feature, positions_m, travel_m, bandwidth_m, 0.5 * bandwidth_m, 3.0 * bandwidth_m)
    known = near[:, 0] >= 0
    value, vector = np.linalg.eigh(curvature[known])
    along = (vector[:, :, 1] * pull[known]).sum(axis=1)
    steep = value[:, 1] > 0
    if np.count_nonzero(steep) < NEIGHBOURS_MIN:
        return 0.0
    squared = along[steep] ** 2 / value[steep, 1]
    return float(MEDIAN_SQUARED / max(np.median(squared), 1e-12))


def _fit_all(feature, positions_m, travel_m, bandwidth_m, apart_m, together_m):
    return _planes(
        np.ascontiguousarray(feature, np.float32), np.ascontiguousarray(positions_m, float),
        np.ascontiguousarray(travel_m, float), bandwidth_m, apart_m, together_m,
    )  # fmt: skip


@kernel
def _planes(feature, positions, travel, bandwidth, apart, together):
    """Per place: sum of gradient outer products (n, 2, 2), of gradient * difference (n, 2), nearest other visits (n,
    3)."""
    count, width = feature.shape
    curvature, pull = np.zeros((count, 2, 2)), np.zeros((count, 2))
    near = np.full((count, VISITS), -1, np.int64)
    member, away2 = np.empty(count, np.int64), np.empty(count)
    level, slope_x, slope_y = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    reach2 = (REACH * bandwidth) ** 2
    for i in range(count):
        found = 0
        for j in range(count):
            gap = abs(travel[i] - travel[j])
            if gap <= apart or gap > together:
                continue
            d2 = (positions[j, 0] - positions[i, 0]) ** 2 + (positions[j, 1] - positions[i, 1]) ** 2
            if d2 < reach2:
                member[found], away2[found] = j, d2
                found += 1
        if found < NEIGHBOURS_MIN:
            continue
        order = np.argsort(away2[:found])
        found = min(found, NEIGHBOURS_MAX)
        normal = np.zeros((3, 3))
        weights, dx, dy = np.empty(found), np.empty(found), np.empty(found)
        total = 0.0
        for k in range(found):
            j = member[order[k]]
            weights[k] = np.exp(-0.5 * away2[order[k]] / bandwidth**2)
            dx[k], dy[k] = positions[j, 0] - positions[i, 0], positions[j, 1] - positions[i, 1]
            w = weights[k]
            total += w
            normal[0, 0] += w
            normal[0, 1] += w * dx[k]
            normal[0, 2] += w * dy[k]
            normal[1, 1] += w * dx[k] * dx[k]
            normal[1, 2] += w * dx[k] * dy[k]
            normal[2, 2] += w * dy[k] * dy[k]
        normal[0, 0] += 1e-6 * total
        normal[1, 1] += SLOPE_RIDGE * total
        normal[2, 2] += SLOPE_RIDGE * total
        normal[1, 0], normal[2, 0], normal[2, 1] = normal[0, 1], normal[0, 2], normal[1, 2]
        inverse = np.linalg.inv(normal)
        level[:] = 0.0
        slope_x[:] = 0.0
        slope_y[:] = 0.0
        for k in range(found):
            row, w = feature[member[order[k]]], weights[k]
            a0 = np.float32(w * (inverse[0, 0] + inverse[0, 1] * dx[k] + inverse[0, 2] * dy[k]))
            a1 = np.float32(w * (inverse[1, 0] + inverse[1, 1] * dx[k] + inverse[1, 2] * dy[k]))
            a2 = np.float32(w * (inverse[2, 0] + inverse[2, 1] * dx[k] + inverse[2, 2] * dy[k]))
            for t in range(width):
                level[t] += a0 * row[t]
                slope_x[t] += a1 * row[t]
                slope_y[t] += a2 * row[t]
        xx = xy = yy = gx = gy = 0.0
        for t in range(width):
            difference = feature[i, t] - level[t]
            xx += slope_x[t] * slope_x[t]
            xy += slope_x[t] * slope_y[t]
            yy += slope_y[t] * slope_y[t]
            gx += slope_x[t] * difference
            gy += slope_y[t] * difference
        curvature[i, 0, 0], curvature[i, 1, 1] = xx, yy
        curvature[i, 0, 1] = curvature[i, 1, 0] = xy
        pull[i, 0], pull[i, 1] = gx, gy
        chosen = 0
        for k in range(found):
            j = member[order[k]]
            is_new = True
            for c in range(chosen):
                if abs(travel[j] - travel[near[i, c]]) <= VISIT_APART_M:
                    is_new = False
            if is_new:
                near[i, chosen] = j
                chosen += 1
                if chosen == VISITS:
                    break
    return curvature, pull, near
