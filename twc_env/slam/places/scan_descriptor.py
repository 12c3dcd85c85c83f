"""Appearance of a place in a laser scan: a rotation-invariant descriptor, and a direct comparison of two scans.

The descriptor is Scan Context (Kim and Kim 2018) in 2D: rings of range by sectors of bearing. A rotation shifts the
sectors, so the best shift gives the similarity and the rotation between two scans. A rotation by part of a sector
lowers the similarity, more so with few beams.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import kernel
from twc_env.records.geometry import wrap_angle

SECTORS, RINGS = 60, 20
NEIGHBOUR_WEIGHT = 0.5
"""Weight of a point in the neighbouring rings, so that small translations change the descriptor little."""
AGREE_M = 0.25
THROUGH_M = 0.4
"""A point this far in front of the other scan's wall contradicts it (seen through)."""


def describe(ranges_m: Array, range_max_m: float) -> Array:
    """Ranges (beams,) -> (RINGS, sectors) with normalised sectors; beams marked as teammates or without return are
    skipped.

    There are SECTORS, or one for each beam of a scan with fewer: a beam-wise rotation would not shift gaps evenly.
    """
    descriptor = np.zeros((RINGS, min(SECTORS, len(ranges_m))))
    _bin(ranges_m, range_max_m, descriptor)
    return descriptor


def ring_key(descriptor: Array) -> Array:
    """(..., RINGS) mean of each ring over all bearings: invariant to rotation, for fast search."""
    return descriptor.mean(axis=-1)


def compare(target: Array, source: Array) -> tuple[float, float]:
    """Similarity of two descriptors in [0, 1] at the best rotation, and that rotation: the source's heading in the
    target."""
    similarity, turn = compare_many(target[None], source)
    return float(similarity[0]), float(turn[0])


def compare_many(targets: Array, source: Array) -> tuple[Array, Array]:
    """(k, RINGS, sectors) against one: (k,) similarities at the best rotation and (k,) rotations [rad], multiples of a
    sector.

    The sum of the cosines between sectors, divided by the number of non-empty sectors of the fuller descriptor.
    """
    sectors = source.shape[-1]
    shifts = np.fft.irfft(
        (np.fft.rfft(targets, axis=-1) * np.conj(np.fft.rfft(source, axis=-1))).sum(axis=-2), n=sectors, axis=-1
    )
    filled = max(int((source.max(axis=-2) > 0).sum()), 1)
    counts = np.maximum((targets.max(axis=-2) > 0).sum(axis=-1), filled)
    best = np.argmax(shifts, axis=-1)
    similarity = np.clip(shifts[np.arange(len(best)), best] / counts, 0.0, 1.0)
    return similarity, wrap_angle(best * (2 * np.pi / sectors))


def scan_agreement(
    target_m: Array, source_m: Array, pose_target_source: Array, range_max_m: float
) -> tuple[float, float]:
    """Overlay two scans: share of points on the other's walls, and share that contradicts it (seen through).

    Each share is of the points within the other scan's view, both directions together; (0, 0) without any.
    """
    pose = np.asarray(pose_target_source, float)
    a = _compare(source_m, pose, target_m, range_max_m)
    b = _compare(target_m, _inverse(pose), source_m, range_max_m)
    compared = a[2] + b[2]
    return ((a[0] + b[0]) / compared, (a[1] + b[1]) / compared) if compared else (0.0, 0.0)


@kernel
def _inverse(pose):
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return np.array([-c * pose[0] - s * pose[1], s * pose[0] - c * pose[1], -pose[2]])


@kernel
def _bin(ranges, range_max, descriptor):
    rings, sectors = descriptor.shape
    beams = ranges.shape[0]
    for beam in range(beams):
        r = ranges[beam]
        if not 0.0 < r < range_max:
            continue
        ring = min(int(r / range_max * rings), rings - 1)
        sector = (beam * sectors) // beams
        descriptor[ring, sector] += 1.0
        if ring > 0:
            descriptor[ring - 1, sector] += NEIGHBOUR_WEIGHT
        if ring < rings - 1:
            descriptor[ring + 1, sector] += NEIGHBOUR_WEIGHT
    for sector in range(sectors):
        total = 0.0
        for ring in range(rings):
            total += descriptor[ring, sector] ** 2
        if total > 0.0:
            for ring in range(rings):
                descriptor[ring, sector] /= math.sqrt(total)


@kernel
def _compare(points, pose, ranges, range_max):
    """Points of one scan, at pose in the frame of another: on its walls, seen through, and evaluated in total."""
    beams = ranges.shape[0]
    step = 2.0 * math.pi / points.shape[0]
    c, s = math.cos(pose[2]), math.sin(pose[2])
    met = crossed = compared = 0
    for i in range(points.shape[0]):
        far = points[i]
        if not 0.0 < far < range_max:
            continue
        px, py = far * math.cos(i * step), far * math.sin(i * step)
        x, y = pose[0] + c * px - s * py, pose[1] + s * px + c * py
        r = math.sqrt(x * x + y * y)
        beam = math.atan2(y, x) * beams / (2.0 * math.pi)
        low = int(math.floor(beam)) % beams
        a, b = abs(ranges[low]), abs(ranges[(low + 1) % beams])
        near, most = min(a, b), max(a, b)
        if r > most + AGREE_M or r >= range_max:  # occluded in the other scan
            continue
        compared += 1
        if r < near - THROUGH_M:
            crossed += 1
        elif min(abs(r - near), abs(r - most)) <= AGREE_M or near < r < most:
            met += 1
    return met, crossed, compared
