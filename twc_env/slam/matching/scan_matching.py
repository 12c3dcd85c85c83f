"""Match a scan to a map of lines: point-to-line Gauss-Newton near a guess, correlative search around it.

The map is a `LineField`: each cell within reach of a wall stores the line of the nearest wall, so a match costs one
look-up per beam and residuals are exact distances, not distances to cell centres.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import LidarConfig, LocalMapConfig
from twc_env.config.range_noise import RangeNoise
from twc_env.errors import ConfigError, DataError
from twc_env.kernels.compiled import BindsAnew, Lent, borrowing_kernel, bound, kernel, parts_of
from twc_env.records.array_validation import validated_points, validated_pose, validated_rows
from twc_env.records.geometry import beam_directions
from twc_env.records.growing_arrays import lazy_zeros
from twc_env.slam.matching.line_equations import line_scratch
from twc_env.slam.matching.line_matching import (
    WEIGHT_MIN,
    correlate,
    fill_information,
    is_held_by_wall,
    points_of,
    refine_pose,
    share_near,
    weight_changes,
)
from twc_env.slam.odometry.odometry_filter import open_direction
from twc_env.slam.scans.wall_cells import LINES_MAX, NO_WALL, distance_in, line_in
from twc_env.slam.scans.wall_drawing import BLOCK_CELLS, NOWHERE, draw_scans, drawing_room

FIELD_SIDE_MAX = 10_000
"""Cells along a side of the largest field: 400 MB."""
NO_NOISE = RangeNoise()
NOTHING_DRAWN = np.array([NOWHERE, NOWHERE, 0, 0, 0])
SIGN_TO_WALL_M = 0.3
"""Maximum distance of a sign from the wall it is assigned to."""
HALF_DIAGONAL = 0.71
"""A wall this near to the middle of a cell [cells] passes through it."""
STOP_M, STOP_RAD = 1e-3, 5e-4
"""A smaller step ends the iteration ..."""
TRACKING_STOP_M, TRACKING_STOP_RAD = 2e-3, 1e-3
"""... or one below this in tracking, where the next step would be below the noise of the scan."""
INNOVATION_MAX_M, INNOVATION_MAX_RAD = 0.4, 0.25
"""A match that deviates further from the prediction is rejected."""
SLIP_MAX_M, SLIP_MAX_RAD = 0.7, 0.4
"""Limit instead of that for a match that explains clearly more of the scan than the prediction: the robot slipped."""
GAIN_MIN, LOSS_WEIGHT = 0.1, 5.0
"""Required gain of such a match, as a share of the beams; weight lost by single beams counts LOSS_WEIGHT times. After a
slip hardly any beam fits worse; where new walls of a long corridor are mistaken for known ones, nearby beams do."""
MATCHED_SHARE_MIN = 0.3
"""Minimum share of matched beams of an accepted match."""
FIT_MIN = 0.75
"""Below this mean weight of a beam, a correlative search around the prediction follows ..."""
SEARCH_M, SEARCH_RAD, SEARCH_STEP_M, SEARCH_STEP_RAD, SEARCH_BEAMS = 0.6, 0.36, 0.15, 0.06, 45
"""... so far, in such steps, and with about so many beams. That is one step of a thousand."""
WALL_MARGIN_M = 0.3
"""A direction that the last match left open is fixed again only by a wall that is wider than a robot by this much:
otherwise robots, and what the map holds of one that has left, would fix a corridor's axis for some time."""


@borrowing_kernel
def match_scan(cells, lines, origin, scan, directions, rule, guess, room, pose, information):
    """Match a scan (beams,) to a field near a guess: writes the pose (3,) and its information (3, 3), zeros if
    rejected.

    rule: as in `LineFields`; room: from `matching_room`. Returns whether the match is accepted (near the guess, with
    enough beams), whether it explains clearly more of the scan than the guess, and the share of returned beams near
    walls.
    """
    points, h, start, scratch = room
    was_open, _, _ = open_direction(information)
    n = points_of(scan, rule[0], directions, points)
    start[0], start[1], start[2] = guess[0], guess[1], guess[2]
    begun = held = total = 0.0
    near, degenerate = 0, False
    # First at the guess; if that fits badly, also after a search; again at the guess if nothing fits clearly better.
    for attempt in range(3):
        total, near, degenerate, first = refine_pose(
            cells, lines, origin, rule[1], points, n, start, rule[2], int(rule[5]), rule[3], TRACKING_STOP_M,
            TRACKING_STOP_RAD, scratch, pose, h,
        )  # fmt: skip
        if attempt == 0:
            begun = first
            if total >= FIT_MIN * n or total < WEIGHT_MIN:
                break
            held = total
            correlate(
                cells, origin, rule[1], points, n, guess, SEARCH_M, SEARCH_RAD, SEARCH_STEP_M, SEARCH_STEP_RAD,
                max(n // SEARCH_BEAMS, 1), start,
            )  # fmt: skip
        elif total >= held + GAIN_MIN * n:
            break
        else:
            start[0], start[1], start[2] = guess[0], guess[1], guess[2]
    if (
        was_open
        and total >= WEIGHT_MIN
        and not (degenerate or is_held_by_wall(cells, lines, origin, rule[1], points, n, pose, rule[2], h, rule[6]))
    ):
        total, near, degenerate, _ = refine_pose(
            cells, lines, origin, rule[1], points, n, guess, rule[2], int(rule[5]), math.inf, TRACKING_STOP_M,
            TRACKING_STOP_RAD, scratch, pose, h,
        )  # fmt: skip
    is_clear = total - begun >= GAIN_MIN * n
    if is_clear:
        won, lost = weight_changes(cells, lines, origin, rule[1], points, n, guess, pose, rule[2])
        is_clear = won - LOSS_WEIGHT * lost >= GAIN_MIN * n
    reach, reach_turned = (SLIP_MAX_M, SLIP_MAX_RAD) if is_clear else (INNOVATION_MAX_M, INNOVATION_MAX_RAD)
    jump_x, jump_y = pose[0] - guess[0], pose[1] - guess[1]
    is_matched = (
        total >= WEIGHT_MIN
        and total >= MATCHED_SHARE_MIN * n
        and math.sqrt(jump_x * jump_x + jump_y * jump_y) <= reach
        and abs(pose[2] - guess[2]) <= reach_turned
    )
    if is_matched:
        fill_information(h, degenerate, rule[4], information)
    else:
        for i in range(3):
            for j in range(3):
                information[i, j] = 0.0
    return is_matched, is_clear, near / max(n, 1)


@borrowing_kernel
def _facing(field, x, y, from_x, from_y):
    """See `LineField.facing_at`."""
    cells, lines, origin, inverse_m = parts_of(field)
    column, row = math.floor((x - origin[0]) * inverse_m), math.floor((y - origin[1]) * inverse_m)
    if not (0 <= row < cells.shape[0] and 0 <= column < cells.shape[1]):
        return math.nan
    cell = cells[row, column]
    if distance_in(cell) > SIGN_TO_WALL_M:
        return math.nan
    line = lines[line_in(cell)]
    nx, ny = np.float64(line[0]), np.float64(line[1])
    return math.atan2(ny, nx) if nx * (from_x - x) + ny * (from_y - y) >= 0.0 else math.atan2(-ny, -nx)


@kernel
def _facing_around(cells, lines, origin, inverse_m, x, y, from_x, from_y):
    """See `LineField.facing_around`: the medoid of what the cells around tell that a wall passes through."""
    column, row = math.floor((x - origin[0]) * inverse_m), math.floor((y - origin[1]) * inverse_m)
    reach = math.ceil(SIGN_TO_WALL_M * inverse_m)
    told, count = np.empty((2 * reach + 1) ** 2), 0
    for i in range(max(row - reach, 0), min(row + reach + 1, cells.shape[0])):
        for j in range(max(column - reach, 0), min(column + reach + 1, cells.shape[1])):
            away = math.hypot(origin[0] + (j + 0.5) / inverse_m - x, origin[1] + (i + 0.5) / inverse_m - y)
            if away > SIGN_TO_WALL_M or distance_in(cells[i, j]) > HALF_DIAGONAL / inverse_m:
                continue
            line = lines[line_in(cells[i, j])]
            nx, ny = np.float64(line[0]), np.float64(line[1])
            is_seen = nx * (from_x - x) + ny * (from_y - y) >= 0.0
            told[count] = math.atan2(ny, nx) if is_seen else math.atan2(-ny, -nx)
            count += 1
    best, least = math.nan, math.inf
    for i in range(count):
        total = 0.0
        for j in range(count):
            total += abs((told[i] - told[j] + math.pi) % (2.0 * math.pi) - math.pi)
        if total < least:
            best, least = told[i], total
    return best


def matching_room(beams: int) -> tuple:
    """Work arrays of `match_scan` for scans of this many beams."""
    return np.empty((beams, 2)), np.empty(9), np.empty(3), line_scratch()


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """Result of scan matching."""

    pose: Array
    """(3,) pose of the scan in the frame of the field."""
    sums: Array
    """(9,) sums over the beams, see `normal_equations`."""
    weight: float
    """Sum of the beams' weights; below WEIGHT_MIN nothing was matched."""
    is_degenerate: bool

    def information(self, beam_std_m: float, correlation: float) -> Array:
        """(3, 3) information of `pose`, along the field's axes.

        Zero along a degenerate direction, since a corridor does not constrain its own axis.
        """
        information = np.empty((3, 3))
        fill_information(self.sums, self.is_degenerate, beam_std_m**2 * correlation, information)
        return information


class LineField(BindsAnew):
    """The walls around a point, indexed for matching: a square of cells in a fixed frame."""

    def __init__(
        self,
        size_m: float,
        resolution_m: float,
        range_max_m: float,
        range_noise: RangeNoise = NO_NOISE,
        storage: tuple[Array, Array, Array, Array] | None = None,
    ):
        """Empty and centred on 0, 0. storage: from `field_storage`, to use instead of new arrays.

        Larger range noise gives longer wall pieces. Raises ConfigError for invalid sizes.
        """
        if not (0.0 < resolution_m <= size_m <= FIELD_SIDE_MAX * resolution_m and range_max_m > 0.0):
            raise ConfigError(
                f"a field needs 0 < resolution_m <= size_m, at most {FIELD_SIDE_MAX} cells a side, and a range above "
                f"0; got size {size_m!r}, resolution {resolution_m!r} and range {range_max_m!r}"
            )
        self.range_max_m, self._noise = range_max_m, range_noise
        self._inverse_m = 1.0 / resolution_m
        self._cells, self._lines, self._origin_m, self._drawn = storage or field_storage(size_m, resolution_m)
        self._scratch = line_scratch()
        self._facing: Callable[..., float] | None = None
        """The kernel `_facing` bound to the arrays of this field."""
        self.reset(np.zeros(2))

    def reset(self, centre_m: Array) -> None:
        """Remove all walls and move to another centre."""
        half = 0.5 * len(self._cells) / self._inverse_m
        self._origin_m[:] = centre_m[0] - half, centre_m[1] - half
        left, bottom, right, top, _ = self._drawn.tolist()
        self._cells[bottom:top, left:right] = NO_WALL
        self._drawn[:] = NOTHING_DRAWN

    def add(self, poses: Array, scans: Array) -> None:
        """Add the walls seen by scans (k, beams) [m] at poses (k, 3).

        Raises DataError for NaN or arrays of another shape.
        """
        if np.ndim(scans) != 2 or np.shape(poses) != (len(scans), 3) or np.shape(scans)[1] == 0:
            raise DataError(
                f"give scans (k, beams), one pose (k, 3) for each; got {np.shape(scans)} and {np.shape(poses)}"
            )
        poses, scans = validated_rows(poses, (3,), "poses"), validated_rows(scans, np.shape(scans)[1:], "scans")
        directions = beam_directions(scans.shape[1])
        if not draw_scans(
            self._cells, self._lines, self._origin_m, self._inverse_m, poses, directions, scans, self.range_max_m,
            drawing_room(scans.shape[1], self._noise), self._drawn,
        ):  # fmt: skip
            raise DataError("scans hold numbers alone (infinite: no return), poses finite ones")

    def refine(self, points: Array, guess: Array, distance_max_m: float, iterations: int, degenerate_share: float):
        """Match points (n, 2) of the robot frame from a near guess (point-to-line Gauss-Newton) -> Match.

        Like the methods below, raises DataError for points and poses of another shape, or not finite.
        """
        points, guess = validated_points(points), validated_pose(guess, "guess")
        pose, h = np.empty(3), np.zeros(9)
        weight, _, is_degenerate, _ = refine_pose(
            self._cells, self._lines, self._origin_m, self._inverse_m, points, len(points), guess, distance_max_m,
            iterations, degenerate_share, STOP_M, STOP_RAD, self._scratch, pose, h,
        )  # fmt: skip
        return Match(pose, h, weight, is_degenerate)

    def correlate(
        self, points: Array, guess: Array, window: tuple[float, float], step: tuple[float, float], stride: int = 1
    ):
        """Search a window [m, rad] around guess in steps [m, rad] -> (best pose (3,), mean score in [0, 1])."""
        points, guess = validated_points(points), validated_pose(guess, "guess")
        if not (min(window) >= 0.0 and min(step) > 0.0 and stride >= 1):
            raise DataError(f"a search needs steps above 0 and a stride of 1 or more; got {window}, {step}, {stride}")
        best = guess.copy()
        score = correlate(*self._field, points, len(points), guess, *window, *step, stride, best)
        return best, score

    def share_near(self, points: Array, pose: Array, near_m: float) -> float:
        """Share of points (n, 2), transformed by pose, within near_m of a wall."""
        points, pose = validated_points(points), validated_pose(pose, "pose")
        return share_near(*self._field, points, len(points), pose, near_m)

    def facing_at(self, position: Sequence[float] | Array, seen_from: Sequence[float] | Array) -> float:
        """Outward normal [rad] of the wall at a position, on the side it is seen from; NaN if no wall is near."""
        now = *map(float, position), *map(float, seen_from)
        if self._facing is None:
            self._facing = bound(_facing, Lent((self._cells, self._lines, self._origin_m, self._inverse_m)), *now)
        return self._facing(*now)

    def facing_around(self, position: Sequence[float] | Array, seen_from: Sequence[float] | Array) -> float:
        """The same by all walls within SIGN_TO_WALL_M: a single piece of two or three end points, as at a corner, may
        be askew by half a radian, which only a match of scans would find."""
        at = *map(float, position), *map(float, seen_from)
        return float(_facing_around(self._cells, self._lines, self._origin_m, self._inverse_m, *at))

    @property
    def parts(self) -> tuple[Array, Array, Array, float, Array, Array]:
        """Cells, lines, corner, cells per metre, `drawn` and work arrays, as `draw_scans` and `refine_pose` take
        them."""
        return self._cells, self._lines, self._origin_m, self._inverse_m, self._drawn, self._scratch

    @property
    def _field(self) -> tuple[Array, Array, float]:
        return self._cells, self._origin_m, self._inverse_m


class LineFields:
    """One field per robot in common arrays, so that all their scans are matched in one compiled call."""

    def __init__(self, count: int, rule: LocalMapConfig, lidar: LidarConfig, variance_m2: float, robot_radius_m: float):
        """variance_m2: the squared error of one beam, times how many beams count as one."""
        storage = field_storage(rule.size_m, rule.resolution_m, count)
        self.cells, self.lines, self.origins_m, self.drawn = storage
        self.inverse_m, self.range_max_m = 1.0 / rule.resolution_m, lidar.range_max_m
        self.range_noise = lidar.range_noise
        searched = rule.match_distance_max_m, rule.degenerate_share, variance_m2, rule.match_iterations_max
        wall_min_m = 2 * robot_radius_m + WALL_MARGIN_M
        self.rule = np.array([lidar.range_max_m, self.inverse_m, *searched, wall_min_m])
        """What `match_scan` goes by."""
        self.each = [
            LineField(rule.size_m, rule.resolution_m, lidar.range_max_m, lidar.range_noise, part)
            for part in zip(*storage, strict=True)
        ]


def field_storage(size_m: float, resolution_m: float, *count: int) -> tuple[Array, Array, Array, Array]:
    """Empty cells ([count,] rows, columns); lines ([count,] n, 3): normal and offset; corners ([count,] 2); and `drawn`
    ([count,] 5), see `draw_scans`."""
    side = max(int(round(size_m / resolution_m)), BLOCK_CELLS)
    return (
        np.full((*count, side, side), NO_WALL),
        lazy_zeros((*count, LINES_MAX + 1, 3), np.float32),
        np.zeros((*count, 2)),
        np.zeros((*count, 5), np.int64),
    )


def scan_points(ranges_m: Array, range_max_m: float) -> Array:
    """(n, 2) end points, in the robot frame, of the beams that returned from static objects.

    Raises DataError for ranges that are no array (beams,) of numbers.
    """
    ranges_m = validated_rows(ranges_m, (), "ranges_m", rows="beams")
    if len(ranges_m) == 0:
        return np.zeros((0, 2))
    points = np.empty((len(ranges_m), 2))
    return points[: points_of(ranges_m, range_max_m, beam_directions(len(ranges_m)), points)]
