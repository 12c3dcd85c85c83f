"""Candidate walls from a path alone: short pieces beside it, and midway between two tracks (papers.md K7, K10).

A robot that follows the walls of a building never crosses one and has one beside it. Pieces on both sides of the path
are candidates; `k_visibility` decides by radio which of them are walls.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import kernel
from twc_env.records.geometry import points_along, travelled_m, wrap_angle

SPACING_M = 0.1
_PIECE_M = 0.05
_NEAR, _FAR = 1.2, 2.8
"""Two tracks between these multiples of the standoff apart may have a wall midway."""
_FACING_COS = 0.6
_CLEAR_SHARE, _TIP_SHARE = 0.85, 0.9
"""A piece nearer to any part of the path than this share of its own offset is no wall; the second share is for line
ends."""
_DIRECTION_RAD = np.deg2rad(20.0)
"""Tracks follow a direction if they deviate by less."""
_STRAIGHT_RAD = np.deg2rad(8.0)
"""Maximum deviation of the parts that estimate a wall's own direction."""
_TIP_RAD = np.deg2rad(40.0)
"""Maximum deviation around the end of a wall, where the track bends."""
_DIRECTION_SHARE = 0.08
"""Minimum share of the path along a main direction."""
_RUN_MIN_M, _BEND_MIN_M = 0.15, 0.5
_STRAIGHT_SHARE = 0.6
"""If a larger share of the path follows main directions, walls beside its bends are no candidates."""
_TURN_BACK_RAD, _STUB_M = np.deg2rad(75.0), 0.6
"""A path that turns by more within half a circle goes around the end of a wall, which then gets a candidate of
STUB_M."""
_LINE_MIN_M = 0.25
"""Shorter lines are the blunt ends of walls and are dropped."""
_REACH_M = 0.1
"""A wall extends beyond the end of the track beside it by the standoff, for the corner, plus this."""
_SAME_LINE = 0.6
"""Two parallel lines within this share of the standoff are one wall seen from both sides."""


@dataclass(frozen=True, slots=True, eq=False)
class WallCandidates:
    """Short straight pieces, grouped in lines along the path."""

    ends_m: Array
    """(pieces, 4) x1, y1, x2, y2."""
    side: Array
    """(pieces,) 0: left of the path, 1: right."""
    is_between: Array
    """(pieces,) bool: midway between two tracks."""
    before: Array
    """(pieces,) previous piece of the line, -1 at its start."""
    after: Array
    """(pieces,) next piece of the line, -1 at its end."""
    stretch: Array
    """(pieces,) number of the line; all its pieces have one wall loss."""
    standoff_m: Array
    """(pieces,) distance from the path."""


@dataclass(frozen=True, slots=True, eq=False)
class _Line:
    """A line of pieces beside one run of the path."""

    corners_m: Array
    """(pieces + 1, 2)."""
    side: int
    offset_m: float
    is_between: bool
    beyond: Array
    """(pieces,) bool: beyond the end of the run, where only clearance limits the wall."""


def wall_candidates(path_m: Array, standoff_m: float) -> WallCandidates:
    """Pieces beside a path (k, 2) at `standoff_m`, or at half the gap where another track runs on the other side."""
    length_m = travelled_m(path_m)[-1]
    vertices = points_along(path_m, np.linspace(0.0, length_m, max(int(length_m / SPACING_M) + 1, 3)))
    tangent = np.gradient(vertices, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    gaps = np.empty((2, len(vertices)))
    _opposite_tracks(vertices, tangent, _FAR * standoff_m, gaps)
    has_tip = np.any((gaps > 1.7 * standoff_m) & (gaps < 2.2 * standoff_m), axis=0)  # the path runs around a wall's end
    lines = [
        line
        for run, direction in _runs(tangent, has_tip)
        for side in (0, 1)
        if (line := _line(vertices[run], tangent[run], direction, side, gaps[side, run], standoff_m)) is not None
    ]
    lines += _ends_turned_around(vertices, tangent, standoff_m)
    # Walls between two tracks are found twice: the longer run has priority.
    lines.sort(key=lambda line: (not line.is_between, -len(line.corners_m)))
    ends = np.concatenate(
        [np.hstack([line.corners_m[:-1], line.corners_m[1:]]) for line in lines] or [np.zeros((0, 4))]
    )
    sizes = [len(line.corners_m) - 1 for line in lines]
    stretch = np.repeat(np.arange(len(lines)), sizes)
    offset = np.repeat([line.offset_m for line in lines], sizes)
    share = np.where(np.concatenate([line.beyond for line in lines] or [np.zeros(0, bool)]), _TIP_SHARE, _CLEAR_SHARE)
    keep = _distance_to_path(ends, vertices) >= share * offset
    _drop_repeated(ends, stretch, _SAME_LINE * standoff_m, keep)
    keep &= np.bincount(stretch, keep, minlength=len(lines))[stretch] * _PIECE_M >= _LINE_MIN_M
    follows = np.zeros(len(ends), bool)
    follows[1:] = keep[1:] & keep[:-1] & (stretch[1:] == stretch[:-1])
    follows = follows[keep]
    before = np.where(follows, np.arange(len(follows)) - 1, -1)
    after = np.full(len(follows), -1)
    after[before[follows]] = np.flatnonzero(follows)
    side = np.repeat([line.side for line in lines], sizes).astype(np.int64)
    between = np.repeat([line.is_between for line in lines], sizes).astype(bool)
    _, stretch = np.unique(stretch[keep], return_inverse=True)
    return WallCandidates(ends[keep], side[keep], between[keep], before, after, stretch, offset[keep])


def _runs(tangent: Array, has_tip: Array) -> list[tuple[slice, float | None]]:
    """Parts of the path along one of its main directions, with the direction, and long bends, with None."""
    heading = np.arctan2(tangent[:, 1], tangent[:, 0])
    is_used = np.zeros(len(heading), bool)
    runs: list[tuple[slice, float | None]] = []
    for direction in _main_directions(heading):
        for along in (direction, direction - np.pi):
            off = np.abs(wrap_angle(heading - along))
            is_along = (off < _DIRECTION_RAD) | ((off < _TIP_RAD) & has_tip)
            for run in _where(is_along):
                if (run.stop - run.start) * SPACING_M >= _RUN_MIN_M:
                    runs.append((run, along))
                    is_used[run] = True
    if is_used.mean() >= _STRAIGHT_SHARE:
        return runs
    runs += [(run, None) for run in _where(~is_used) if (run.stop - run.start) * SPACING_M >= _BEND_MIN_M]
    return runs


def _main_directions(heading: Array) -> list[float]:
    """Directions in [0, pi) along which much of the path runs, strongest first."""
    rest = heading.copy()
    found: list[float] = []
    while len(rest) >= _DIRECTION_SHARE * len(heading):
        doubled = np.exp(2j * rest)
        angles = np.deg2rad(np.arange(0.0, 180.0, 3.0))
        near = np.abs(wrap_angle(2 * (rest[:, None] - angles))) < _DIRECTION_RAD
        best = int(np.argmax(near.sum(axis=0)))
        if near[:, best].sum() < _DIRECTION_SHARE * len(heading):
            break
        mean = 0.5 * np.angle(doubled[near[:, best]].mean()) % np.pi
        found.append(float(mean))
        rest = rest[np.abs(wrap_angle(2 * (rest - mean))) > 2 * _DIRECTION_RAD]
    return found


def _where(flags: Array) -> list[slice]:
    """Runs of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return [slice(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _line(
    vertices: Array, tangent: Array, direction: float | None, side: int, gaps: Array, standoff_m: float
) -> _Line | None:
    """The pieces beside one run of the path; None if another track is too near for a wall in between."""
    is_between = (gaps >= _NEAR * standoff_m) & (gaps <= _FAR * standoff_m)
    if np.mean(gaps < _NEAR * standoff_m) > 0.5:
        return None
    has_track = is_between.mean() >= 0.4
    offset = float(np.median(gaps[is_between]) / 2) if has_track else standoff_m
    sign = 1.0 if side == 0 else -1.0
    if direction is None:
        corners = vertices + offset * sign * np.column_stack([-tangent[:, 1], tangent[:, 0]])
        return _Line(corners, side, offset, bool(has_track), np.zeros(len(corners) - 1, bool))
    ahead = np.array([np.cos(direction), np.sin(direction)])
    if len(vertices) * SPACING_M >= 3 * _BEND_MIN_M:  # long enough to estimate its own direction
        straight = vertices[np.abs(wrap_angle(np.arctan2(tangent[:, 1], tangent[:, 0]) - direction)) < _STRAIGHT_RAD]
        if len(straight) >= 2:
            own = np.linalg.svd(straight - straight.mean(axis=0), full_matrices=False)[2][0]
            ahead = own * np.sign(own @ ahead)
    left = np.array([-ahead[1], ahead[0]])
    along, across = vertices @ ahead, float(np.median(vertices @ left)) + sign * offset
    if has_track:
        normal = sign * np.column_stack([-tangent[:, 1], tangent[:, 0]])
        across = float(
            np.median((vertices + 0.5 * np.where(is_between, gaps, 0.0)[:, None] * normal)[is_between] @ left)
        )
    reach = standoff_m + _REACH_M
    marks = np.arange(along.min() - reach, along.max() + reach + _PIECE_M / 2, _PIECE_M)
    corners = marks[:, None] * ahead + across * left
    middles = (marks[:-1] + marks[1:]) / 2
    beyond = (middles < along.min()) | (middles > along.max())
    return _Line(corners, side, offset, bool(has_track), beyond)


def _ends_turned_around(vertices: Array, tangent: Array, standoff_m: float) -> list[_Line]:
    """Walls whose end the path goes around in a half circle: they start at its centre."""
    heading = np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))
    half = max(int(0.5 * np.pi * standoff_m / SPACING_M), 2)
    if len(heading) <= 2 * half:
        return []
    turned = heading[2 * half :] - heading[: -2 * half]
    directions = np.array(_main_directions(heading) or [0.0])
    lines = []
    for run in _where(np.abs(turned) > _TURN_BACK_RAD):
        middle = half + run.start + int(np.argmax(np.abs(turned[run])))
        sign = float(np.sign(turned[middle - half]))
        arc = slice(middle - half // 2, middle + half // 2 + 1)
        normal = sign * np.column_stack([-tangent[arc, 1], tangent[arc, 0]])
        centre = (vertices[arc] + standoff_m * normal).mean(axis=0)
        behind = float(np.arctan2(*(centre - vertices[middle])[::-1]))
        off = wrap_angle(2 * (directions - behind)) / 2
        nearest = int(np.argmin(np.abs(off)))
        if abs(off[nearest]) > 2 * _DIRECTION_RAD:
            continue
        behind += float(off[nearest])
        marks = np.arange(-standoff_m / 2, _STUB_M, _PIECE_M)
        corners = centre + marks[:, None] * np.array([np.cos(behind), np.sin(behind)])
        lines.append(_Line(corners, 0 if sign > 0 else 1, standoff_m, False, np.ones(len(corners) - 1, bool)))
    return lines


def _distance_to_path(ends: Array, vertices: Array) -> Array:
    """(pieces,) distance from the middle of each piece to the nearest vertex."""
    from scipy.spatial import cKDTree

    middles = (ends[:, :2] + ends[:, 2:]) / 2
    vertices = np.concatenate([vertices, (vertices[:-1] + vertices[1:]) / 2])
    return cKDTree(vertices).query(middles)[0] if len(ends) else np.zeros(0)


@kernel
def _drop_repeated(ends, stretch, reach, keep):
    """Drop pieces that coincide with a piece of an earlier line."""
    for j in range(ends.shape[0]):
        if not keep[j]:
            continue
        x, y = 0.5 * (ends[j, 0] + ends[j, 2]), 0.5 * (ends[j, 1] + ends[j, 3])
        ex, ey = ends[j, 2] - ends[j, 0], ends[j, 3] - ends[j, 1]
        length = max(np.sqrt(ex * ex + ey * ey), 1e-9)
        for i in range(j):
            if stretch[i] == stretch[j]:
                break
            if not keep[i]:
                continue
            fx, fy = ends[i, 2] - ends[i, 0], ends[i, 3] - ends[i, 1]
            other = max(np.sqrt(fx * fx + fy * fy), 1e-9)
            if abs(ex * fx + ey * fy) < 0.8 * length * other:
                continue
            ax, ay = x - ends[i, 0], y - ends[i, 1]
            along, across = (ax * fx + ay * fy) / other, abs(ax * fy - ay * fx) / other
            if across < reach and -0.5 * length <= along <= other + 0.5 * length:
                keep[j] = False
                break


@kernel
def _opposite_tracks(vertices, tangent, reach, gaps):
    """For each vertex and side: distance to the next track along the normal; inf without one."""
    count = vertices.shape[0]
    for i in range(count):
        for side in range(2):
            sign = 1.0 if side == 0 else -1.0
            nx, ny = -sign * tangent[i, 1], sign * tangent[i, 0]
            gaps[side, i] = np.inf
            for j in range(count - 1):
                if abs(j - i) < 3:
                    continue
                ax, ay = vertices[j, 0] - vertices[i, 0], vertices[j, 1] - vertices[i, 1]
                if abs(ax) > reach + 0.3 or abs(ay) > reach + 0.3:
                    continue
                ex, ey = vertices[j + 1, 0] - vertices[j, 0], vertices[j + 1, 1] - vertices[j, 1]
                det = nx * ey - ny * ex
                if abs(det) < 1e-12:
                    continue
                t = (ax * ey - ay * ex) / det
                u = (ax * ny - ay * nx) / det
                if t <= 1e-6 or t > reach or u < 0.0 or u > 1.0 or t >= gaps[side, i]:
                    continue
                length = np.sqrt(ex * ex + ey * ey)
                if abs(ex * tangent[i, 0] + ey * tangent[i, 1]) < _FACING_COS * length:
                    continue
                gaps[side, i] = t
