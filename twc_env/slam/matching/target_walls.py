"""The scans of neighbouring keyframes in a common frame: as walls, and as points to match to walls."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import LidarConfig
from twc_env.errors import DataError
from twc_env.kernels.compiled import Lent, borrowing_kernel, bound, parts_of
from twc_env.records.array_validation import plain
from twc_env.records.geometry import beam_directions
from twc_env.records.messages import Keyframe
from twc_env.slam.matching.closure_covariance import fill_closure_covariance
from twc_env.slam.matching.line_matching import fill_information, refine_pose, share_near
from twc_env.slam.matching.scan_matching import STOP_M, STOP_RAD, LineField
from twc_env.slam.scans.teammate_detection import without_narrow
from twc_env.slam.scans.wall_drawing import clear_walls, draw_scan, drawing_room

FIELD_CELL_M = 0.2
NEAR_WALL_M = 0.15
REFINE_REACH_M, REFINE_ITERATIONS, DEGENERATE_SHARE = 0.4, 20, 0.04
"""Tracking requires half that share (`slam.local_map.degenerate_share`), since it knows the pose one step before; along
bare corridors most closures constrained by fewer beams are false."""
SEEN_THROUGH_M = 0.35
"""A point this far in front of a beam's end contradicts it (seen through)."""


@borrowing_kernel
def _relative(base, pose, out):
    """The pose relative to base."""
    c, s = math.cos(base[2]), math.sin(base[2])
    dx, dy = pose[0] - base[0], pose[1] - base[1]
    out[0], out[1], out[2] = c * dx + s * dy, c * dy - s * dx, pose[2] - base[2]


@borrowing_kernel
def _draw(walls, is_first, base, pose, ranges):
    """Add a scan taken at a pose to the walls in the frame of `base`; the first scan replaces all walls.

    Returns False for a scan or a pose that is not finite.
    """
    (cells, lines, origin, inverse_m, drawn, _), (directions, range_max, room, here, _), _ = parts_of(walls)
    if is_first:
        clear_walls(cells, drawn)
    _relative(base, pose, here)
    return draw_scan(cells, lines, origin, inverse_m, here, directions, ranges, range_max, room, drawn)


@borrowing_kernel
def _join(walls, base, pose, ranges, points, count):
    """Append the end points of a scan taken at a pose, in the frame of `base`, to `count` points; returns their
    number."""
    _, (directions, range_max, _, here, _), _ = parts_of(walls)
    _relative(base, pose, here)
    c, s = math.cos(here[2]), math.sin(here[2])
    for i in range(ranges.shape[0]):
        r = ranges[i]
        if 0.0 <= r < range_max:
            x, y = r * directions[i, 0], r * directions[i, 1]
            points[count, 0], points[count, 1] = here[0] + c * x - s * y, here[1] + s * x + c * y
            count += 1
    return count


@borrowing_kernel
def _lay(walls, points, guess, priors, pose, covariance):
    """See `TargetWalls.refine`; returns the overlap."""
    (cells, lines, origin, inverse_m, _, scratch), _, (variance, sums, information, room) = parts_of(walls)
    count = points.shape[0]
    _, _, is_degenerate, _ = refine_pose(
        cells, lines, origin, inverse_m, points, count, guess, REFINE_REACH_M, REFINE_ITERATIONS, DEGENERATE_SHARE,
        STOP_M, STOP_RAD, scratch, pose, sums,
    )  # fmt: skip
    fill_information(sums, is_degenerate, variance, information)
    fill_closure_covariance(information, priors, pose[2], room, covariance)
    return share_near(cells, origin, inverse_m, points, count, pose, NEAR_WALL_M)


@borrowing_kernel
def _share_seen_through(seen, directions, pose, ranges, range_max, margin):
    """Share of one scan's end points that lie inside the other scan's free space by more than `margin`."""
    beams = ranges.shape[0]
    c, s = math.cos(pose[2]), math.sin(pose[2])
    through = compared = 0
    for i in range(seen.shape[0]):
        if not 0.0 <= seen[i] < range_max:
            continue
        px, py = seen[i] * directions[i, 0], seen[i] * directions[i, 1]
        x, y = pose[0] + c * px - s * py, pose[1] + s * px + c * py
        r = math.sqrt(x * x + y * y)
        if r >= range_max:
            continue
        bearing = math.atan2(y, x) * beams / (2 * math.pi)
        low = int(math.floor(bearing))  # within one turn: no modulo, which is as slow as atan2
        low += beams if low < 0 else 0
        free = min(abs(ranges[low]), abs(ranges[low + 1 if low + 1 < beams else 0]))
        compared += 1
        if r < free - margin:
            through += 1
    return through / max(compared, 1)


@borrowing_kernel
def _contradict(walls, target, source, pose):
    """The larger share of one scan's points that the other saw through; pose of the source in the target's frame."""
    _, (directions, range_max, _, back, origin), _ = parts_of(walls)
    _relative(pose, origin, back)
    return max(
        _share_seen_through(source, directions, pose, target, range_max, SEEN_THROUGH_M),
        _share_seen_through(target, directions, back, source, range_max, SEEN_THROUGH_M),
    )


class _Kernels(NamedTuple):
    """The kernels above, bound to their constant arguments."""

    draw: Callable[..., bool]
    join: Callable[..., int]
    lay: Callable[..., float]
    contradict: Callable[..., float]


class WallMatch(NamedTuple):
    """Result of matching points to walls."""

    pose: Array
    """(3,) pose of the points."""
    covariance: Array
    """(3, 3) covariance in the frame of the pose, see `closure_covariance`."""
    overlap: float
    """Share of the points on walls."""


class TargetWalls:
    """The walls seen from a keyframe and its neighbours, in its own frame.

    Arguments are not checked: points as returned by `points`, guesses poses (3,) of float64.
    """

    def __init__(self, size_m: float, lidar: LidarConfig, variance_m2: float):
        """variance_m2: squared error of a point on a wall, times the number of correlated points that count as one."""
        self._variance_m2 = variance_m2
        self.field = LineField(size_m, FIELD_CELL_M, lidar.range_max_m)
        """For correlative search far from a guess."""
        self._noise = lidar.range_noise
        self._bound: _Kernels | None = None
        self._beams = 0
        """Beam count for which the kernels are bound."""

    def __getstate__(self) -> dict:
        return self.__dict__ | {"_bound": None}

    def _kernels(self, beams: int) -> _Kernels:
        if self._bound is None or beams != self._beams:
            self._beams, pose, scan, points = beams, np.empty(3), np.empty(beams), np.empty((0, 2))
            room = drawing_room(beams, self._noise), np.empty(3), np.zeros(3)
            scans = beam_directions(beams), self.field.range_max_m, *room
            fit = self._variance_m2, np.zeros(9), np.empty((3, 3)), np.empty((2, 3, 3))
            held = Lent((self.field.parts, scans, fit))
            self._bound = _Kernels(
                bound(_draw, held, True, pose, pose, scan),
                bound(_join, held, pose, pose, scan, points, 0),
                bound(_lay, held, points, pose, fit[3], pose, fit[2]),
                bound(_contradict, held, scan, scan, pose),
            )
        return self._bound

    def draw(self, keyframes: Sequence[Keyframe]) -> None:
        """Replace all walls by those seen from these keyframes, in the frame of the first.

        Raises DataError for scans and poses that are not finite.
        """
        first = keyframes[0]
        for keyframe in keyframes:
            scan = plain(keyframe.ranges_m)
            if not self._kernels(len(scan)).draw(keyframe is first, first.pose_odom, keyframe.pose_odom, scan):
                raise DataError("scans hold numbers alone (infinite: no return), poses finite ones")

    def points(self, keyframes: Sequence[Keyframe], width_m: float = 0.0) -> Array:
        """(n, 2) scan points of these keyframes in the frame of the first, without objects narrower than `width_m`."""
        first, count = keyframes[0], 0
        points = np.empty((sum([len(keyframe.ranges_m) for keyframe in keyframes]), 2))
        for keyframe in keyframes:
            scan = plain(keyframe.ranges_m)
            if width_m > 0.0:
                scan = without_narrow(scan, width_m)
            count = self._kernels(len(scan)).join(first.pose_odom, keyframe.pose_odom, scan, points, count)
        return points[:count]

    def refine(self, points: Array, guess: Array, priors: Array) -> WallMatch:
        """Match points (n, 2) to the walls from a guess (3,); priors: see `closure_covariance`."""
        pose, covariance = np.empty(3), np.empty((3, 3))
        return WallMatch(pose, covariance, self._kernels(self._beams).lay(points, guess, priors, pose, covariance))

    def contradiction(self, target: Keyframe, source: Keyframe, pose: Array) -> float:
        """The larger share of points of one scan that the other saw through; pose (3,) of the source in the target."""
        scan = plain(target.ranges_m)
        return self._kernels(len(scan)).contradict(scan, plain(source.ranges_m), pose)
