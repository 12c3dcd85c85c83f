"""SE(2) and angles: pure functions on arrays. A pose is (x [m], y [m], heading [rad])."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from numpy.typing import NDArray as Array


def wrap_angle(angle_rad: ArrayLike):
    """Angles moved into [-pi, pi)."""
    return (np.asarray(angle_rad) + np.pi) % (2 * np.pi) - np.pi


def wrap_one(angle_rad: float) -> float:
    """`wrap_angle` of a single number, without array functions."""
    return (angle_rad + math.pi) % (2 * math.pi) - math.pi


def compose_one(pose_a_b: Sequence[float], pose_b_c: Sequence[float]) -> tuple[float, float, float]:
    """`compose` of single poses, without array functions."""
    (ax, ay, at), (bx, by, bt) = pose_a_b, pose_b_c
    c, s = math.cos(at), math.sin(at)
    return ax + c * bx - s * by, ay + s * bx + c * by, wrap_one(at + bt)


def compose(pose_a_b: ArrayLike, pose_b_c: ArrayLike) -> Array:
    """The pose of c in a, from b in a and c in b; (..., 3) each, broadcast."""
    a, b = np.asarray(pose_a_b, float), np.asarray(pose_b_c, float)
    if a.ndim == 1 and b.ndim == 1:  # one pose: ten times faster without array functions
        return np.array(compose_one(a.tolist(), b.tolist()))
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    x = a[..., 0] + c * b[..., 0] - s * b[..., 1]
    y = a[..., 1] + s * b[..., 0] + c * b[..., 1]
    return np.stack([x, y, wrap_angle(a[..., 2] + b[..., 2])], axis=-1)


def compose_rows(poses_a_b: Array, rows: Array, poses_b_c: Array) -> Array:
    """`compose` of the chosen rows of (k, 3) with poses (n, 3), rows (n,) int: where k is small, half the time."""
    a, b = poses_a_b[rows], poses_b_c
    c, s = np.cos(poses_a_b[:, 2])[rows], np.sin(poses_a_b[:, 2])[rows]
    x = a[:, 0] + c * b[:, 0] - s * b[:, 1]
    y = a[:, 1] + s * b[:, 0] + c * b[:, 1]
    return np.stack([x, y, wrap_angle(a[:, 2] + b[:, 2])], axis=-1)


def inverse(pose_a_b: ArrayLike) -> Array:
    """The pose of a in b, from b in a; (..., 3)."""
    p = np.asarray(pose_a_b, float)
    if p.ndim == 1:
        x, y, t = p.tolist()
        c, s = math.cos(t), math.sin(t)
        return np.array([-c * x - s * y, s * x - c * y, wrap_one(-t)])
    c, s = np.cos(p[..., 2]), np.sin(p[..., 2])
    return np.stack([-c * p[..., 0] - s * p[..., 1], s * p[..., 0] - c * p[..., 1], wrap_angle(-p[..., 2])], axis=-1)


def between(pose_m_a: ArrayLike, pose_m_b: ArrayLike) -> Array:
    """The pose of b in a, from both in m; (..., 3) each, broadcast."""
    a, b = np.asarray(pose_m_a, float), np.asarray(pose_m_b, float)
    if a.ndim == 1 and b.ndim == 1:  # `inverse` and `compose` of one pose at once
        (ax, ay, at), (bx, by, bt) = a.tolist(), b.tolist()
        c, s = math.cos(at), math.sin(at)
        x, y, t = -c * ax - s * ay, s * ax - c * ay, wrap_one(-at)
        c, s = math.cos(t), math.sin(t)
        return np.array([x + c * bx - s * by, y + s * bx + c * by, wrap_one(t + bt)])
    return compose(inverse(pose_m_a), pose_m_b)


def poses_along(motions: Array) -> Array:
    """(n, 3) poses from (0, 0, 0) along motions (n - 1, 3), each in the frame of the pose before it."""
    heading = np.concatenate([[0.0], np.cumsum(motions[:, 2])])
    c, s = np.cos(heading[:-1]), np.sin(heading[:-1])
    x = np.concatenate([[0.0], np.cumsum(c * motions[:, 0] - s * motions[:, 1])])
    y = np.concatenate([[0.0], np.cumsum(s * motions[:, 0] + c * motions[:, 1])])
    return np.column_stack([x, y, wrap_angle(heading)])


def travelled_m(path: Array) -> Array:
    """(n,) path length up to each of the positions (n, 2) or poses (n, 3)."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path[:, :2], axis=0), axis=1))])


def points_along(path_m: Array, at_m: Array) -> Array:
    """(k, 2) points of a path (n, 2) at path lengths (k,) from its start."""
    travel = travelled_m(path_m)
    return np.column_stack([np.interp(at_m, travel, path_m[:, axis]) for axis in (0, 1)])


def seen_from(information: Array, heading_rad: float) -> Array:
    """Information matrix (3, 3) of a pose, rotated from the axes of a frame to the pose's own axes."""
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    turn = np.array((c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0)).reshape(3, 3)
    return turn.T @ information @ turn


def transform_points(pose_a_b: ArrayLike, points_b: ArrayLike) -> Array:
    """Points (n, 2) of frame b, expressed in frame a."""
    pose, points = np.asarray(pose_a_b, float), np.asarray(points_b, float)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return points @ np.array([[c, s], [-s, c]]) + pose[:2]


@lru_cache(maxsize=16)
def beam_directions(beam_count: int) -> Array:
    """(beams, 2) cosine and sine of each beam's angle in the robot frame; read-only."""
    angles = np.arange(beam_count) * (2 * np.pi / beam_count)
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    directions.flags.writeable = False
    return directions


def farthest_first(points: Array, count: int, first: int = 0) -> list[int]:
    """Indices of up to `count` points (n, 2): `first`, then always the point farthest from all chosen ones."""
    chosen = [first]
    gaps = np.linalg.norm(points - points[first], axis=1)
    while len(chosen) < min(count, len(points)):
        chosen.append(int(np.argmax(gaps)))
        gaps = np.minimum(gaps, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return chosen


def align_rigidly(points_from: ArrayLike, points_to: ArrayLike) -> Array:
    """The pose (3,) that moves points_from (n, 2) onto points_to with least squared error (no scale, no mirror).

    Defined for any n >= 1: the rotation is 0 if the points do not determine it (one point, or all equal).
    """
    a, b = np.asarray(points_from, float), np.asarray(points_to, float)
    mean_a, mean_b = a.mean(axis=0), b.mean(axis=0)
    h = (a - mean_a).T @ (b - mean_b)
    angle = np.arctan2(h[0, 1] - h[1, 0], h[0, 0] + h[1, 1])
    c, s = np.cos(angle), np.sin(angle)
    return np.array([*(mean_b - np.array([[c, -s], [s, c]]) @ mean_a), angle])
