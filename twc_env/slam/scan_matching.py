"""Match a scan to a map of lines: point-to-line Gauss-Newton near a guess, correlative search around it.

The map is a `LineField`: each cell within reach of a wall knows the straight line of the wall nearest to it, so a match
costs one look-up per beam and residuals are exact distances, not distances to cell centres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray

REACH_M = 0.45
"""Cells further from a wall than this know nothing of it."""
FAR_M = 1e3
"""Distance of a cell that knows no wall."""
SIGN_TO_WALL_M = 0.3
"""A sign hangs on the wall that is at most this far away."""
WEIGHT_MIN = 5.0
"""With less than this sum of weights nothing was matched."""
SAME_WALL_M = 0.02
"""A piece of wall this near to a line that is already known adds nothing."""
JUMP_MAX_M = 0.5
"""Neighbouring beams whose end points are further apart lie on different surfaces."""
ROBUST_SCALE_M = 0.08
"""Residual at which a beam has lost half of its weight (Cauchy)."""


@njit(cache=True, error_model="numpy")
def _stamp(distance, lines, inverse_m, ax, ay, bx, by):
    """Tell the cells around the wall piece a-b [m from the field's corner] of its line, where it is the nearest."""
    height, width = distance.shape
    ex, ey = bx - ax, by - ay
    length = math.sqrt(ex * ex + ey * ey)
    if length < 1e-6:
        return
    ex /= length
    ey /= length
    nx, ny = -ey, ex
    offset = nx * ax + ny * ay
    mx, my = 0.5 * (ax + bx), 0.5 * (ay + by)
    column, row = int(mx * inverse_m), int(my * inverse_m)
    if 0 <= row < height and 0 <= column < width and distance[row, column] < REACH_M:
        known = lines[row, column]
        is_parallel = abs(known[0] * nx + known[1] * ny) > 0.97
        gap = abs(known[0] * mx + known[1] * my - known[2])
        if is_parallel and gap < SAME_WALL_M and distance[row, column] < 1.0 / inverse_m:
            return
    cell = 1.0 / inverse_m
    first_column = max(0, int((min(ax, bx) - REACH_M) * inverse_m))
    last_column = min(width - 1, int((max(ax, bx) + REACH_M) * inverse_m))
    first_row = max(0, int((min(ay, by) - REACH_M) * inverse_m))
    last_row = min(height - 1, int((max(ay, by) + REACH_M) * inverse_m))
    for r in range(first_row, last_row + 1):
        cy = (r + 0.5) * cell
        for c in range(first_column, last_column + 1):
            cx = (c + 0.5) * cell
            along = (cx - ax) * ex + (cy - ay) * ey
            across = nx * cx + ny * cy - offset
            beyond = max(0.0, max(-along, along - length))
            d = math.sqrt(across * across + beyond * beyond)
            if d < distance[r, c]:
                distance[r, c] = d
                lines[r, c, 0] = nx
                lines[r, c, 1] = ny
                lines[r, c, 2] = offset


@njit(cache=True, error_model="numpy")
def _add_scan(distance, lines, origin_x, origin_y, inverse_m, x, y, heading, ranges, range_max):
    beams = ranges.shape[0]
    step = 2 * math.pi / beams
    have_previous = False
    px = py = 0.0
    for k in range(-1, beams):
        i = k if k >= 0 else beams - 1
        if ranges[i] >= range_max or ranges[i] < 0.0:
            have_previous = False
            continue
        angle = heading + i * step
        qx = x + ranges[i] * math.cos(angle) - origin_x
        qy = y + ranges[i] * math.sin(angle) - origin_y
        if have_previous and k >= 0 and (qx - px) ** 2 + (qy - py) ** 2 < JUMP_MAX_M**2:
            _stamp(distance, lines, inverse_m, px, py, qx, qy)
        px, py, have_previous = qx, qy, True


@njit(cache=True, error_model="numpy")
def _add_scans(distance, lines, origin_x, origin_y, inverse_m, poses, scans, range_max):
    for k in range(poses.shape[0]):
        _add_scan(
            distance, lines, origin_x, origin_y, inverse_m, poses[k, 0], poses[k, 1], poses[k, 2], scans[k], range_max
        )


@njit(cache=True, error_model="numpy")
def _points_of(ranges, range_max, points):
    """End points of the beams that returned, in the robot frame; gives their number."""
    step = 2 * math.pi / ranges.shape[0]
    n = 0
    for i in range(ranges.shape[0]):
        if 0.0 <= ranges[i] < range_max:
            points[n, 0] = ranges[i] * math.cos(i * step)
            points[n, 1] = ranges[i] * math.sin(i * step)
            n += 1
    return n


@njit(cache=True, error_model="numpy")
def _normal_equations(distance, lines, origin_x, origin_y, inverse_m, points, n, x, y, heading, distance_max, h, g):
    """Sum J^T w J (h: 6 upper entries) and J^T w e (g: 3) over the points; gives the sum of weights."""
    height, width = distance.shape
    c, s = math.cos(heading), math.sin(heading)
    h[:] = 0.0
    g[:] = 0.0
    total = 0.0
    for i in range(n):
        rx, ry = c * points[i, 0] - s * points[i, 1], s * points[i, 0] + c * points[i, 1]
        qx, qy = x + rx - origin_x, y + ry - origin_y
        if qx < 0.0 or qy < 0.0:
            continue
        column, row = int(qx * inverse_m), int(qy * inverse_m)
        if row >= height or column >= width or distance[row, column] > distance_max:
            continue
        nx, ny = lines[row, column, 0], lines[row, column, 1]
        e = nx * qx + ny * qy - lines[row, column, 2]
        if abs(e) > distance_max:
            continue
        w = 1.0 / (1.0 + (e / ROBUST_SCALE_M) ** 2)
        jt = ny * rx - nx * ry
        h[0] += w * nx * nx
        h[1] += w * nx * ny
        h[2] += w * nx * jt
        h[3] += w * ny * ny
        h[4] += w * ny * jt
        h[5] += w * jt * jt
        g[0] += w * nx * e
        g[1] += w * ny * e
        g[2] += w * jt * e
        total += w
    return total


@njit(cache=True, error_model="numpy")
def _weakest_direction(h):
    """Smallest eigenvalue of the translation part of h with the heading left free, and its direction."""
    t = max(h[5], 1e-9)
    a, b, d = h[0] - h[2] * h[2] / t, h[1] - h[2] * h[4] / t, h[3] - h[4] * h[4] / t
    mean, half = 0.5 * (a + d), 0.5 * math.sqrt((a - d) ** 2 + 4 * b * b)
    angle = 0.5 * math.atan2(2 * b, a - d) + 0.5 * math.pi
    return max(mean - half, 0.0), math.cos(angle), math.sin(angle)


@njit(cache=True, error_model="numpy")
def _solve3(h, g, damping, out):
    a00, a01, a02, a11, a12, a22 = h[0] + damping, h[1], h[2], h[3] + damping, h[4], h[5] + damping
    m0, m1, m2 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
    det = a00 * m0 + a01 * m1 + a02 * m2
    n1, n2 = a00 * a22 - a02 * a02, a01 * a02 - a00 * a12
    n3 = a00 * a11 - a01 * a01
    out[0] = -(m0 * g[0] + m1 * g[1] + m2 * g[2]) / det
    out[1] = -(m1 * g[0] + n1 * g[1] + n2 * g[2]) / det
    out[2] = -(m2 * g[0] + n2 * g[1] + n3 * g[2]) / det


@njit(cache=True, error_model="numpy")
def _refine(
    distance,
    lines,
    origin_x,
    origin_y,
    inverse_m,
    points,
    n,
    guess,
    distance_max,
    iterations,
    degenerate_share,
    pose,
    h,
):
    """Gauss-Newton from guess; steps along a direction that the walls do not fix are left out.

    Writes the pose and the final h. Gives (iterations, sum of weights, is_degenerate, direction x, direction y).
    """
    g = np.zeros(3)
    delta = np.zeros(3)
    pose[:] = guess
    total = 0.0
    vx = vy = 0.0
    degenerate = False
    it = 0
    for it in range(iterations):  # noqa: B007
        total = _normal_equations(
            distance, lines, origin_x, origin_y, inverse_m, points, n, pose[0], pose[1], pose[2], distance_max, h, g
        )
        if total < WEIGHT_MIN:
            break
        weakest, vx, vy = _weakest_direction(h)
        degenerate = weakest < degenerate_share * total
        _solve3(h, g, 1e-3 * total, delta)
        if degenerate:
            along = delta[0] * vx + delta[1] * vy
            delta[0] -= along * vx
            delta[1] -= along * vy
        pose += delta
        if abs(delta[0]) < 1e-3 and abs(delta[1]) < 1e-3 and abs(delta[2]) < 5e-4:
            break
    return it + 1, total, degenerate, vx, vy


@njit(cache=True, error_model="numpy")
def _score(distance, origin_x, origin_y, inverse_m, points, n, stride, x, y, c, s):
    height, width = distance.shape
    total = 0.0
    for i in range(0, n, stride):
        qx = x + c * points[i, 0] - s * points[i, 1] - origin_x
        qy = y + s * points[i, 0] + c * points[i, 1] - origin_y
        if qx < 0.0 or qy < 0.0:
            continue
        column, row = int(qx * inverse_m), int(qy * inverse_m)
        if row < height and column < width:
            d = distance[row, column]
            if d < 0.3:
                total += 1.0 - d / 0.3
    return total


@njit(cache=True, error_model="numpy")
def _correlate(
    distance, origin_x, origin_y, inverse_m, points, n, guess, window_m, window_rad, step_m, step_rad, stride, best
):
    """Brute force over a window around guess, nearest first; writes the best pose, gives its mean score in [0, 1]."""
    best_score = -1.0
    turns = int(window_rad / step_rad)
    moves = int(window_m / step_m)
    for k in range(-turns, turns + 1):
        heading = guess[2] + k * step_rad
        c, s = math.cos(heading), math.sin(heading)
        for j in range(-moves, moves + 1):
            for i in range(-moves, moves + 1):
                score = _score(
                    distance, origin_x, origin_y, inverse_m, points, n, stride,
                    guess[0] + i * step_m, guess[1] + j * step_m, c, s,
                )  # fmt: skip
                if score > best_score:
                    best_score = score
                    best[0], best[1], best[2] = guess[0] + i * step_m, guess[1] + j * step_m, heading
    return best_score / max((n + stride - 1) // stride, 1)


@njit(cache=True, error_model="numpy")
def _share_near(distance, origin_x, origin_y, inverse_m, points, n, pose, near_m):
    """Share of the points within near_m of a wall."""
    height, width = distance.shape
    c, s = math.cos(pose[2]), math.sin(pose[2])
    count = 0
    for i in range(n):
        qx = pose[0] + c * points[i, 0] - s * points[i, 1] - origin_x
        qy = pose[1] + s * points[i, 0] + c * points[i, 1] - origin_y
        if qx < 0.0 or qy < 0.0:
            continue
        column, row = int(qx * inverse_m), int(qy * inverse_m)
        if row < height and column < width and distance[row, column] <= near_m:
            count += 1
    return count / max(n, 1)


@njit(cache=True, error_model="numpy")
def _information(h, degenerate, vx, vy, scale, out):
    """Fill out (3, 3) with h / scale, emptied along the direction (vx, vy) where that is degenerate."""
    out[0, 0], out[0, 1], out[0, 2], out[1, 1], out[1, 2], out[2, 2] = h[0], h[1], h[2], h[3], h[4], h[5]
    out[1, 0], out[2, 0], out[2, 1] = h[1], h[2], h[4]
    out /= scale
    if degenerate:
        kxx, kxy, kyy = 1.0 - vx * vx, -vx * vy, 1.0 - vy * vy
        for j in range(3):
            a, b = out[0, j], out[1, j]
            out[0, j], out[1, j] = kxx * a + kxy * b, kxy * a + kyy * b
        for i in range(3):
            a, b = out[i, 0], out[i, 1]
            out[i, 0], out[i, 1] = kxx * a + kxy * b, kxy * a + kyy * b


@njit(cache=True, error_model="numpy")
def _match_scan(
    distance, lines, origin_x, origin_y, inverse_m, ranges, range_max, guess, distance_max, iterations,
    degenerate_share, scale, points, pose, information,
):  # fmt: skip
    """A whole scan against the field; writes pose (3,) and information (3, 3), gives (points, sum of weights)."""
    n = _points_of(ranges, range_max, points)
    h = np.zeros(6)
    _, total, degenerate, vx, vy = _refine(
        distance, lines, origin_x, origin_y, inverse_m, points, n, guess, distance_max, iterations, degenerate_share,
        pose, h,
    )  # fmt: skip
    _information(h, degenerate, vx, vy, scale, information)
    return n, total


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """Where a scan fits, and how well each direction is fixed."""

    pose: Array
    """(3,) of the scan in the frame of the field."""
    hessian: Array
    """(3, 3) sum of J^T w J over the beams [1/m2 units once divided by the beam variance]."""
    weight: float
    """Sum of the beams' weights; below WEIGHT_MIN nothing was matched."""
    is_degenerate: bool
    direction: Array
    """(2,) the direction that the walls fix least, unit length."""

    def information(self, beam_std_m: float, correlation: float) -> Array:
        """(3, 3) information of `pose`; none along a degenerate direction, as a corridor does not fix its own axis."""
        h, information = self.hessian, np.empty((3, 3))
        upper = np.array([h[0, 0], h[0, 1], h[0, 2], h[1, 1], h[1, 2], h[2, 2]])
        _information(upper, self.is_degenerate, *self.direction, beam_std_m**2 * correlation, information)
        return information


class LineField:
    """The walls of a neighbourhood, ready for matching; a square of cells in some fixed frame."""

    def __init__(self, centre_m: Array, size_m: float, resolution_m: float, range_max_m: float):
        cells = int(round(size_m / resolution_m))
        self.origin_m = np.asarray(centre_m, float)[:2] - 0.5 * cells * resolution_m
        self.range_max_m = range_max_m
        self._inverse_m = 1.0 / resolution_m
        self._distance = np.empty((cells, cells), np.float32)
        self._lines = np.zeros((cells, cells, 3), np.float32)
        self._points = np.empty((0, 2))
        self.reset(centre_m)

    def reset(self, centre_m: Array) -> None:
        """Forget all walls and move to another centre."""
        half = 0.5 * len(self._distance) / self._inverse_m
        self.origin_m = np.asarray(centre_m, float)[:2] - half
        self._distance.fill(FAR_M)

    def add(self, poses: Array, scans: Array) -> None:
        """Draw the walls seen by scans (k, beams) [m] at poses (k, 3)."""
        _add_scans(self._distance, self._lines, *self._frame, poses, scans, self.range_max_m)

    def refine(self, points: Array, guess: Array, distance_max_m: float, iterations: int, degenerate_share: float):
        """Match points (n, 2) of the robot frame from a near guess (point-to-line Gauss-Newton) -> Match."""
        pose, h = np.empty(3), np.zeros(6)
        _, weight, degenerate, vx, vy = _refine(
            self._distance,
            self._lines,
            *self._frame,
            points,
            len(points),
            guess,
            distance_max_m,
            iterations,
            degenerate_share,
            pose,
            h,
        )
        hessian = np.array([[h[0], h[1], h[2]], [h[1], h[3], h[4]], [h[2], h[4], h[5]]])
        return Match(pose, hessian, weight, degenerate, np.array([vx, vy]))

    def match_scan(
        self,
        ranges_m: Array,
        guess: Array,
        distance_max_m: float,
        iterations: int,
        degenerate_share: float,
        variance_m2: float,
    ) -> tuple[Array, Array, float]:
        """`refine` for a whole scan (beams,) in one compiled call.

        variance_m2 is the squared error of one beam, times how many beams count as one. Gives the pose (3,), its
        information (3, 3) and the share of the returned beams that the field explains.
        """
        if len(self._points) < len(ranges_m):
            self._points = np.empty((len(ranges_m), 2))
        pose, information = np.empty(3), np.empty((3, 3))
        count, weight = _match_scan(
            self._distance, self._lines, *self._frame, ranges_m, self.range_max_m, guess, distance_max_m, iterations,
            degenerate_share, variance_m2, self._points, pose, information,
        )  # fmt: skip
        return pose, information, weight / count if weight >= WEIGHT_MIN else 0.0

    def correlate(
        self, points: Array, guess: Array, window: tuple[float, float], step: tuple[float, float], stride: int = 1
    ):
        """Search a window [m, rad] around guess in steps [m, rad] -> (best pose (3,), mean score in [0, 1])."""
        best = np.array(guess, float)
        score = _correlate(
            self._distance, *self._frame, points, len(points), np.asarray(guess, float), *window, *step, stride, best
        )
        return best, score

    def share_near(self, points: Array, pose: Array, near_m: float) -> float:
        """Share of points (n, 2), seen from pose, that lie within near_m of a wall."""
        return _share_near(self._distance, *self._frame, points, len(points), pose, near_m)

    def facing_at(self, position: Array, seen_from: Array) -> float:
        """Outward normal [rad] of the wall at a position, on the side it is seen from; NaN where no wall is near."""
        column, row = ((np.asarray(position) - self.origin_m) * self._inverse_m).astype(int)
        if not (0 <= row < len(self._distance) and 0 <= column < len(self._distance)):
            return math.nan
        if self._distance[row, column] > SIGN_TO_WALL_M:
            return math.nan
        nx, ny = self._lines[row, column, :2].tolist()
        towards = nx * (seen_from[0] - position[0]) + ny * (seen_from[1] - position[1])
        return math.atan2(ny, nx) if towards >= 0 else math.atan2(-ny, -nx)

    @property
    def _frame(self) -> tuple[float, float, float]:
        return self.origin_m[0], self.origin_m[1], self._inverse_m


def scan_points(ranges_m: Array, range_max_m: float) -> Array:
    """(n, 2) end points, in the robot frame, of the beams that returned from something that stands still."""
    points = np.empty((len(ranges_m), 2))
    return points[: _points_of(ranges_m, range_max_m, points)]
