"""Match a scan to a map of lines: point-to-line Gauss-Newton near a guess, correlative search around it.

The map is a `LineField`: each cell within reach of a wall knows the straight line of the wall nearest to it, so a match
costs one look-up per beam and residuals are exact distances, not distances to cell centres.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twc_env.config import LocalMapConfig
from twc_env.errors import DataError
from twc_env.geometry import beam_directions
from twc_env.kernels import borrowing_kernel
from twc_env.slam.line_equations import line_scratch, normal_equations
from twc_env.slam.wall_cells import LINES_MAX, NO_WALL, distance_in, told_by
from twc_env.slam.wall_drawing import BLOCK_CELLS, draw_scans

Array = NDArray

NOTHING_DRAWN = np.array([2**31, 2**31, 0, 0, 0])
SIGN_TO_WALL_M = 0.3
"""A sign hangs on the wall that is at most this far away."""
WEIGHT_MIN = 5.0
"""With less than this sum of weights nothing was matched."""
STOP_M, STOP_RAD = 1e-3, 5e-4
"""A smaller step ends a match ..."""
TRACKING_STOP_M, TRACKING_STOP_RAD = 2e-3, 1e-3
"""... or one smaller than this where the robot is only tracked: the next would be lost in the noise of the scan."""
INNOVATION_MAX_M, INNOVATION_MAX_RAD = 0.4, 0.25
"""A match that jumps further than this from the prediction is not believed."""
MATCHED_SHARE_MIN = 0.3
"""Nor is one that explains fewer of the beams."""


@borrowing_kernel
def _points_of(ranges, range_max, directions, points):
    """End points of the beams that returned, in the robot frame; gives their number."""
    n = 0
    for i in range(ranges.shape[0]):
        if 0.0 <= ranges[i] < range_max:
            points[n, 0] = ranges[i] * directions[i, 0]
            points[n, 1] = ranges[i] * directions[i, 1]
            n += 1
    return n


@borrowing_kernel
def _weakest_direction(h):
    """Smallest eigenvalue of the translation part of h with the heading left free, and its direction."""
    t = max(h[5], 1e-9)
    a, b, d = h[0] - h[2] * h[2] / t, h[1] - h[2] * h[4] / t, h[3] - h[4] * h[4] / t
    mean, half = 0.5 * (a + d), 0.5 * math.sqrt((a - d) ** 2 + 4 * b * b)
    angle = 0.5 * math.atan2(2 * b, a - d) + 0.5 * math.pi
    return max(mean - half, 0.0), math.cos(angle), math.sin(angle)


@borrowing_kernel
def _solve3(h, damping):
    """The step that the normal equations h (9,) ask for."""
    a00, a01, a02, a11, a12, a22 = h[0] + damping, h[1], h[2], h[3] + damping, h[4], h[5] + damping
    g0, g1, g2 = h[6], h[7], h[8]
    m0, m1, m2 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
    det = a00 * m0 + a01 * m1 + a02 * m2
    n1, n2 = a00 * a22 - a02 * a02, a01 * a02 - a00 * a12
    n3 = a00 * a11 - a01 * a01
    return (
        -(m0 * g0 + m1 * g1 + m2 * g2) / det,
        -(m1 * g0 + n1 * g1 + n2 * g2) / det,
        -(m2 * g0 + n2 * g1 + n3 * g2) / det,
    )


@borrowing_kernel
def _refine(
    cells, lines, origin, inverse_m, points, n, guess, distance_max, iterations, degenerate_share, stop_m, stop_rad,
    scratch, pose, h,
):  # fmt: skip
    """Gauss-Newton from guess; steps along a direction that the walls do not fix are left out.

    Writes the pose and the final h. Gives (sum of weights, points near walls, is_degenerate, direction x, direction y).
    """
    pose[0], pose[1], pose[2] = guess[0], guess[1], guess[2]
    total, near = 0.0, 0
    vx = vy = 0.0
    degenerate = False
    for _ in range(iterations):
        total, near = normal_equations(
            cells, lines, origin, inverse_m, points, n, pose[0], pose[1], pose[2], distance_max, scratch, h
        )  # fmt: skip
        if total < WEIGHT_MIN:
            break
        weakest, vx, vy = _weakest_direction(h)
        degenerate = weakest < degenerate_share * total
        dx, dy, turn = _solve3(h, 1e-3 * total)
        if degenerate:
            along = dx * vx + dy * vy
            dx -= along * vx
            dy -= along * vy
        pose[0] += dx
        pose[1] += dy
        pose[2] += turn
        if abs(dx) < stop_m and abs(dy) < stop_m and abs(turn) < stop_rad:
            break
    return total, near, degenerate, vx, vy


@borrowing_kernel
def _score(cells, origin, inverse_m, points, n, stride, x, y, c, s):
    height, width = cells.shape
    total = 0.0
    for i in range(0, n, stride):
        qx = x + c * points[i, 0] - s * points[i, 1] - origin[0]
        qy = y + s * points[i, 0] + c * points[i, 1] - origin[1]
        if qx < 0.0 or qy < 0.0:
            continue
        column, row = int(qx * inverse_m), int(qy * inverse_m)
        if row < height and column < width:
            total += max(1.0 - distance_in(cells[row, column]) / 0.3, 0.0)
    return total


@borrowing_kernel
def _correlate(cells, origin, inverse_m, points, n, guess, window_m, window_rad, step_m, step_rad, stride, best):
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
                    cells, origin, inverse_m, points, n, stride, guess[0] + i * step_m, guess[1] + j * step_m, c, s
                )
                if score > best_score:
                    best_score = score
                    best[0], best[1], best[2] = guess[0] + i * step_m, guess[1] + j * step_m, heading
    return best_score / max((n + stride - 1) // stride, 1)


@borrowing_kernel
def _share_near(cells, origin, inverse_m, points, n, pose, near_m):
    """Share of the points within near_m of a wall."""
    height, width = cells.shape
    c, s = math.cos(pose[2]), math.sin(pose[2])
    count = 0
    for i in range(n):
        qx = pose[0] + c * points[i, 0] - s * points[i, 1] - origin[0]
        qy = pose[1] + s * points[i, 0] + c * points[i, 1] - origin[1]
        if qx < 0.0 or qy < 0.0:
            continue
        column, row = int(qx * inverse_m), int(qy * inverse_m)
        if row < height and column < width and distance_in(cells[row, column]) <= near_m:
            count += 1
    return count / max(n, 1)


@borrowing_kernel
def _information(h, degenerate, vx, vy, scale, out):
    """Fill out (3, 3) with h / scale, emptied along the direction (vx, vy) where that is degenerate."""
    out[0, 0], out[0, 1], out[0, 2], out[1, 1], out[1, 2], out[2, 2] = h[0], h[1], h[2], h[3], h[4], h[5]
    out[1, 0], out[2, 0], out[2, 1] = h[1], h[2], h[4]
    for i in range(3):
        for j in range(3):
            out[i, j] /= scale
    if degenerate:
        kxx, kxy, kyy = 1.0 - vx * vx, -vx * vy, 1.0 - vy * vy
        for j in range(3):
            a, b = out[0, j], out[1, j]
            out[0, j], out[1, j] = kxx * a + kxy * b, kxy * a + kyy * b
        for i in range(3):
            a, b = out[i, 0], out[i, 1]
            out[i, 0], out[i, 1] = kxx * a + kxy * b, kxy * a + kyy * b


@borrowing_kernel
def match_scan(cells, lines, origin, scan, directions, rule, guess, points, h, scratch, pose, information):
    """Lay a scan (beams,) on a field near a guess: writes the pose (3,) and its information (3, 3), zeros for none.

    rule: as `LineFields` has it; points (beams, 2), h (9,) and scratch (`line_scratch`) are room to work in. Gives
    whether the pose is to be believed (it is near the guess, and enough beams speak for it), and the share of the beams
    that returned which end near walls.
    """
    range_max, inverse_m, distance_max, degenerate_share, variance = rule[0], rule[1], rule[2], rule[3], rule[4]
    n = _points_of(scan, range_max, directions, points)
    total, near, degenerate, vx, vy = _refine(
        cells, lines, origin, inverse_m, points, n, guess, distance_max, int(rule[5]), degenerate_share,
        TRACKING_STOP_M, TRACKING_STOP_RAD, scratch, pose, h,
    )  # fmt: skip
    jump_x, jump_y = pose[0] - guess[0], pose[1] - guess[1]
    is_matched = (
        total >= WEIGHT_MIN
        and total >= MATCHED_SHARE_MIN * n
        and math.sqrt(jump_x * jump_x + jump_y * jump_y) <= INNOVATION_MAX_M
        and abs(pose[2] - guess[2]) <= INNOVATION_MAX_RAD
    )
    if is_matched:
        _information(h, degenerate, vx, vy, variance, information)
    else:
        for i in range(3):
            for j in range(3):
                information[i, j] = 0.0
    return is_matched, near / max(n, 1)


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """Where a scan fits, and how well each direction is fixed."""

    pose: Array
    """(3,) of the scan in the frame of the field."""
    sums: Array
    """(9,) over the beams, see `normal_equations`."""
    weight: float
    """Sum of the beams' weights; below WEIGHT_MIN nothing was matched."""
    is_degenerate: bool
    direction: Array
    """(2,) the direction that the walls fix least, unit length."""

    @property
    def hessian(self) -> Array:
        """(3, 3) sum of J^T w J over the beams [1/m2 units once divided by the beam variance]."""
        xx, xy, xt, yy, yt, tt = self.sums[:6].tolist()
        return np.array([[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]])

    def information(self, beam_std_m: float, correlation: float) -> Array:
        """(3, 3) information of `pose`, along the field's axes.

        None along a degenerate direction, as a corridor does not fix its own axis.
        """
        information = np.empty((3, 3))
        vx, vy = self.direction.tolist()
        _information(self.sums, self.is_degenerate, vx, vy, beam_std_m**2 * correlation, information)
        return information


class LineField:
    """The walls of a neighbourhood, ready for matching; a square of cells in some fixed frame."""

    def __init__(
        self,
        size_m: float,
        resolution_m: float,
        range_max_m: float,
        storage: tuple[Array, Array, Array, Array] | None = None,
    ):
        """Empty and centred on 0, 0. storage: as of `field_storage`, to use instead of new arrays."""
        self.range_max_m = range_max_m
        self._inverse_m = 1.0 / resolution_m
        self._cells, self._lines, self._origin_m, self._drawn = storage or field_storage(size_m, resolution_m)
        self._scratch = line_scratch()
        self.reset(np.zeros(2))

    def reset(self, centre_m: Array) -> None:
        """Forget all walls and move to another centre."""
        half = 0.5 * len(self._cells) / self._inverse_m
        self._origin_m[:] = centre_m[0] - half, centre_m[1] - half
        left, bottom, right, top, _ = self._drawn.tolist()
        self._cells[bottom:top, left:right] = NO_WALL
        self._drawn[:] = NOTHING_DRAWN

    def add(self, poses: Array, scans: Array) -> None:
        """Draw the walls seen by scans (k, beams) [m] at poses (k, 3). Raises DataError for what is no number."""
        directions = beam_directions(scans.shape[1])
        if not draw_scans(
            self._cells, self._lines, self._origin_m, self._inverse_m, poses, directions, scans, self.range_max_m,
            np.empty((scans.shape[1] + 1, 2)), self._drawn,
        ):  # fmt: skip
            raise DataError("scans hold numbers alone (infinite: no return), poses finite ones")

    def refine(self, points: Array, guess: Array, distance_max_m: float, iterations: int, degenerate_share: float):
        """Match points (n, 2) of the robot frame from a near guess (point-to-line Gauss-Newton) -> Match."""
        pose, h = np.empty(3), np.zeros(9)
        weight, _, degenerate, vx, vy = _refine(
            self._cells, self._lines, self._origin_m, self._inverse_m, points, len(points), guess, distance_max_m,
            iterations, degenerate_share, STOP_M, STOP_RAD, self._scratch, pose, h,
        )  # fmt: skip
        return Match(pose, h, weight, degenerate, np.array([vx, vy]))

    def correlate(
        self, points: Array, guess: Array, window: tuple[float, float], step: tuple[float, float], stride: int = 1
    ):
        """Search a window [m, rad] around guess in steps [m, rad] -> (best pose (3,), mean score in [0, 1])."""
        best = np.array(guess, float)
        score = _correlate(
            *self._field, points, len(points), np.asarray(guess, float), *window, *step, stride, best
        )  # fmt: skip
        return best, score

    def share_near(self, points: Array, pose: Array, near_m: float) -> float:
        """Share of points (n, 2), seen from pose, that lie within near_m of a wall."""
        return _share_near(*self._field, points, len(points), pose, near_m)

    def facing_at(self, position: Sequence[float] | Array, seen_from: Sequence[float] | Array) -> float:
        """Outward normal [rad] of the wall at a position, on the side it is seen from; NaN where no wall is near."""
        x, y = position
        origin_x, origin_y = self._origin_m.tolist()
        column, row = math.floor((x - origin_x) * self._inverse_m), math.floor((y - origin_y) * self._inverse_m)
        if not (0 <= row < len(self._cells) and 0 <= column < len(self._cells)):
            return math.nan
        distance_m, line = told_by(int(self._cells[row, column]))
        if distance_m > SIGN_TO_WALL_M:
            return math.nan
        nx, ny, _ = self._lines[line].tolist()
        towards = nx * (seen_from[0] - x) + ny * (seen_from[1] - y)
        return math.atan2(ny, nx) if towards >= 0 else math.atan2(-ny, -nx)

    @property
    def _field(self) -> tuple[Array, Array, float]:
        return self._cells, self._origin_m, self._inverse_m


class LineFields:
    """One field per robot in common memory, so that all their scans are matched in one compiled call."""

    def __init__(self, count: int, rule: LocalMapConfig, range_max_m: float, variance_m2: float):
        """variance_m2: the squared error of one beam, times how many beams count as one."""
        storage = field_storage(rule.size_m, rule.resolution_m, count)
        self.cells, self.lines, self.origins_m, self.drawn = storage
        self.inverse_m, self.range_max_m = 1.0 / rule.resolution_m, range_max_m
        self.rule = np.array(
            [
                range_max_m,
                self.inverse_m,
                rule.match_distance_max_m,
                rule.degenerate_share,
                variance_m2,
                rule.match_iterations_max,
            ]
        )
        """What `match_scan` goes by."""
        self.each = [
            LineField(rule.size_m, rule.resolution_m, range_max_m, storage) for storage in zip(*storage, strict=True)
        ]


def field_storage(size_m: float, resolution_m: float, *count: int) -> tuple[Array, Array, Array, Array]:
    """Cells ([count,] rows, columns) that know no wall; lines ([count,] n, 3): normal and offset; corners ([count,] 2);
    and `drawn` ([count,] 5), see `draw_scans`."""
    side = max(int(round(size_m / resolution_m)), BLOCK_CELLS)
    return (
        np.full((*count, side, side), NO_WALL),
        np.zeros((*count, LINES_MAX + 1, 3), np.float32),
        np.zeros((*count, 2)),
        np.zeros((*count, 5), np.int64),
    )


def scan_points(ranges_m: Array, range_max_m: float) -> Array:
    """(n, 2) end points, in the robot frame, of the beams that returned from something that stands still."""
    points = np.empty((len(ranges_m), 2))
    return points[: _points_of(ranges_m, range_max_m, beam_directions(len(ranges_m)), points)]
