"""Global search for placements of one map in another: all shifts at once, for the turns at which walls are parallel.

For each turn, agreement is a cross-correlation of pictures, by Fourier transforms: walls near walls count for a shift,
walls in the free floor of the other map count against it, both ways. Turns are those at which the directions of walls
coincide modulo a right angle (Carpin 2008 finds them by Hough spectra); a building without preferred directions is
searched at all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array
from scipy import fft, ndimage

from twc_env.records.geometry import wrap_angle
from twc_env.slam.saved_maps.saved_map import ComparedMap

COARSE_M, PIXELS_MAX = 0.2, 400
"""Pixel of the search, and the most along a side of a map: larger maps are searched at coarser pixels."""
BLUR_PIXELS = 2.0
"""A wall's agreement falls linearly from 1 to 0 at this distance from a wall of the other map; beyond, it
contradicts."""
CONTRADICTION = 1.0
"""Weight of a wall in free floor against that of a wall on a wall."""
COMMON_FLOOR = 0.05
"""Weight of a pixel of floor that both know to be free."""
TURN_STEP_DEG = 1
TURN_SHARE = 0.35
"""Turns are searched if their spectrum exceeds the mean by this share of what the best does: two wings of a building
may lie at an angle, and the part that is common need not be the one that dominates."""
PEAKS_OF_TURN, PEAKS_MAX = 16, 60
APART_M, APART_RAD = 0.6, np.radians(3.0)
"""Placements closer than this are one."""


@dataclass(frozen=True, slots=True, eq=False)
class _Pictures:
    """Pictures (rows, columns) of the target."""

    agreement: Array
    """What a wall of the other map is worth at each pixel."""
    floor: Array
    """What floor of the other map, apart from walls, is worth."""


def candidate_poses(target: ComparedMap, source: ComparedMap) -> Array:
    """(k, 3) poses of the source in the target, best first, accurate to a pixel and half a degree."""
    extents_m = [max(each.free.shape) * each.cell_m for each in (target, source)]
    pixel_m = max(COARSE_M, max(extents_m) / PIXELS_MAX)
    fixed = _target_pictures(target, pixel_m)
    centre = source.centre_m
    walls, inside = source.points - centre, _inside_points(source, pixel_m) - centre
    reach = int(np.ceil(np.hypot(*np.abs(np.concatenate([walls, inside])).max(axis=0)) / pixel_m)) + 1
    shape = tuple(fft.next_fast_len(n + 2 * reach + 1, real=True) for n in fixed.floor.shape)
    agreement, floor = (fft.rfft2(part, shape) for part in (fixed.agreement, fixed.floor))
    found: list[tuple[float, Array]] = []
    for turn in turns_along_walls(target, source):
        # Of a map turned about its centre, which lies at pixel (reach, reach); correlation by conjugates.
        drawn = [_drawn(points, turn, pixel_m, reach) for points in (walls, inside)]
        its_walls, its_inside = (fft.rfft2(picture, shape) for picture in drawn)
        score = fft.irfft2(agreement * np.conj(its_walls) + floor * np.conj(its_inside), shape)
        for value, row, column in _peaks(score, pixel_m):
            shift = (np.array([_signed(column, shape[1], fixed.floor.shape[1]),
                               _signed(row, shape[0], fixed.floor.shape[0])]) + reach) * pixel_m  # fmt: skip
            c, s = np.cos(turn), np.sin(turn)
            found.append((value, np.array([*(shift - np.array([[c, -s], [s, c]]) @ centre), turn])))
    found.sort(key=lambda pair: -pair[0])
    return _apart(np.array([pose for _, pose in found]).reshape(-1, 3), centre)


def _apart(poses: Array, centre: Array) -> Array:
    """The first PEAKS_MAX of the poses (n, 3) that put the centre elsewhere than those before them, or turn it."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    places = poses[:, :2] + np.column_stack([c * centre[0] - s * centre[1], s * centre[0] + c * centre[1]])
    kept, is_left = [], np.ones(len(poses), bool)
    for k in range(len(poses)):
        if is_left[k]:
            kept.append(k)
            if len(kept) == PEAKS_MAX:
                break
            turned = np.abs(wrap_angle(poses[:, 2] - poses[k, 2]))
            is_left &= (np.hypot(*(places - places[k]).T) >= APART_M) | (turned >= APART_RAD)
    return poses[kept]


def turns_along_walls(target: ComparedMap, source: ComparedMap) -> Array:
    """(n,) turns of the source [rad] at which its walls are parallel or at right angles to the target's, where spectra
    of wall directions agree best (Carpin 2008); each with its three right angles."""
    spectra = [_spectrum(each.directions_rad) for each in (target, source)]
    match = fft.irfft(fft.rfft(spectra[0]) * np.conj(fft.rfft(spectra[1])), len(spectra[0]))
    level = match.mean() + TURN_SHARE * (match.max() - match.mean())
    good = np.flatnonzero(match >= level) * TURN_STEP_DEG
    return np.radians((good[:, None] + np.array([0, 90, 180, 270])).ravel())


def _spectrum(directions_rad: Array) -> Array:
    """Smoothed histogram of directions modulo a right angle, bins of TURN_STEP_DEG."""
    bins = 90 // TURN_STEP_DEG
    index = np.round(np.degrees(directions_rad) / TURN_STEP_DEG).astype(np.int64) % bins
    counts = np.bincount(index, minlength=bins).astype(float)
    return np.asarray(ndimage.gaussian_filter1d(counts, 1.0, mode="wrap"))


def _inside_points(each: ComparedMap, pixel_m: float) -> Array:
    """(k, 2) [m] free floor further from walls than agreement reaches."""
    is_inside = each.free & (each.wall_distance_m > BLUR_PIXELS * pixel_m)
    return (np.argwhere(is_inside)[:, ::-1] + 0.5) * each.cell_m


def _target_pictures(each: ComparedMap, pixel_m: float) -> _Pictures:
    rows, columns = (int(np.ceil(n * each.cell_m / pixel_m)) for n in each.free.shape)
    walls, inside = np.zeros((rows, columns), np.float32), np.zeros((rows, columns), np.float32)
    for picture, points in ((walls, each.points), (inside, _inside_points(each, pixel_m))):
        column, row = np.minimum((points / pixel_m).astype(np.int64), [columns - 1, rows - 1]).T
        picture[row, column] = 1.0
    near = np.maximum(1.0 - ndimage.distance_transform_edt(walls == 0) / BLUR_PIXELS, 0.0)
    agreement = near - CONTRADICTION * inside * (near == 0)
    return _Pictures(agreement.astype(np.float32), COMMON_FLOOR * inside - CONTRADICTION * walls)


def _drawn(points: Array, turn: float, pixel_m: float, reach: int) -> Array:
    """(2 reach + 1, same) picture of points (n, 2) turned about (0, 0), which lies in its middle."""
    c, s = np.cos(turn), np.sin(turn)
    x, y = points.T
    column = np.floor((c * x - s * y) / pixel_m).astype(np.int64) + reach
    row = np.floor((s * x + c * y) / pixel_m).astype(np.int64) + reach
    picture = np.zeros((2 * reach + 1, 2 * reach + 1), np.float32)
    picture[row, column] = 1.0
    return picture


def _signed(index: int, period: int, positive: int) -> int:
    """A shift from its index in a circular correlation, where shifts up to `positive` are not negative."""
    return index if index <= positive else index - period


def _peaks(score: Array, pixel_m: float) -> list[tuple[float, int, int]]:
    """The best shifts that are APART_M from each other: value, row, column."""
    flat = score.ravel()
    best = np.argpartition(flat, -600)[-600:] if flat.size > 600 else np.arange(flat.size)
    best = best[np.argsort(-flat[best], kind="stable")]
    rows, columns = np.unravel_index(best, score.shape)
    apart, out, is_left = APART_M / pixel_m, [], np.ones(len(best), bool)
    for k in range(len(best)):
        if is_left[k]:
            out.append((float(flat[best[k]]), int(rows[k]), int(columns[k])))
            if len(out) == PEAKS_OF_TURN:
                break
            is_left &= np.hypot(rows - rows[k], columns - columns[k]) >= apart
    return out
