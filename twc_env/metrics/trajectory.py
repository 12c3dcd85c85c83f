"""Trajectory errors, path length and time spent stuck."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from numpy.typing import NDArray as Array

from twc_env.errors import DataError
from twc_env.kernels.compiled import borrowing_kernel, kernel
from twc_env.records.array_validation import real_array
from twc_env.records.geometry import between, transform_points

HEADING_LEVER_M = 1.0
"""In `lay_map` a heading error counts like the position error of a point this far ahead."""
NO_TURNS = np.zeros((0, 2))


def align_team(estimated: ArrayLike, true: ArrayLike) -> Array:
    """The rigid transform (3,) from estimated to true positions with the least squared error.

    Both (..., 2) or (..., 3), of equal leading shape; all robots and steps have equal weight. Raises DataError for
    unequal shapes or no positions.
    """
    pose = np.empty(3)
    align(*_position_pairs(estimated, true), NO_TURNS, pose)
    return pose


def lay_map(estimated: ArrayLike, true: ArrayLike) -> Array:
    """The pose (3,) of a map frame in the building, from estimated and true poses (..., 3) of its robots.

    As `align_team`, but headings count too, like points one metre ahead: the rotation of a robot that has hardly moved
    follows from its heading, not from a path of few centimetres. Raises the same errors.
    """
    estimated, true, pose = real_array(estimated, "estimated"), real_array(true, "true"), np.empty(3)
    _check_pairs(estimated, true)
    if estimated.shape[-1:] != (3,) or true.shape[-1:] != (3,):
        raise DataError(f"a map is aligned by poses (..., 3); got {estimated.shape} and {true.shape}")
    estimated, true = estimated.reshape(-1, 3), true.reshape(-1, 3)
    align(estimated, true, turns_between(estimated, true), pose)
    return pose


def turns_between(estimated: Array, true: Array) -> Array:
    """(n, 2) cosine and sine of the angles between the headings of poses (n, 3)."""
    turns = np.empty((len(true), 2))
    _measure_turns(estimated, true, turns)
    return turns


@borrowing_kernel
def _measure_turns(estimated, true, turns):
    for i in range(turns.shape[0]):
        turned = true[i, 2] - estimated[i, 2]
        turns[i, 0], turns[i, 1] = math.cos(turned), math.sin(turned)


@borrowing_kernel
def align(a, b, turns, pose):
    """`geometry.align_rigidly` of points (n, 2), or of poses (n, 3) with the turns (n, 2) between their headings.

    Turns are cosines and sines, and count like points HEADING_LEVER_M ahead; `NO_TURNS`: positions only.
    """
    count = a.shape[0]
    ax = ay = bx = by = 0.0
    for i in range(count):
        ax += a[i, 0]
        ay += a[i, 1]
        bx += b[i, 0]
        by += b[i, 1]
    ax, ay, bx, by = ax / count, ay / count, bx / count, by / count
    along = across = 0.0
    for i in range(count):
        px, py, qx, qy = a[i, 0] - ax, a[i, 1] - ay, b[i, 0] - bx, b[i, 1] - by
        along += px * qx + py * qy
        across += px * qy - py * qx
    for i in range(turns.shape[0]):
        along += HEADING_LEVER_M * HEADING_LEVER_M * turns[i, 0]
        across += HEADING_LEVER_M * HEADING_LEVER_M * turns[i, 1]
    pose[2] = math.atan2(across, along)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    pose[0], pose[1] = bx - c * ax + s * ay, by - s * ax - c * ay


def absolute_trajectory_error_m(estimated: ArrayLike, true: ArrayLike, alignment: ArrayLike | None = None) -> float:
    """Root mean square distance between estimated and true positions after one rigid alignment (ATE).

    Shapes as in `align_team`. `alignment` (3,) moves the estimate onto the truth; default: the best one. Raises
    DataError for other shapes.
    """
    estimated_m, true_m = _position_pairs(estimated, true)
    if alignment is None:
        alignment = align_team(estimated_m, true_m)
    elif np.shape(alignment) != (3,):
        raise DataError(f"an alignment is one pose (3,); got shape {np.shape(alignment)}")
    squared_m2 = (transform_points(alignment, estimated_m) - true_m) ** 2
    return float(np.sqrt(np.mean(squared_m2[:, 0] + squared_m2[:, 1])))


def end_point_error_m(estimated: ArrayLike, true: ArrayLike) -> float:
    """Distance between the estimated and the true last position, both relative to the first pose (EPE, papers.md T18).

    Both (t, 3). If the true path is closed, this is the start-to-end gap that the paper prints. Raises DataError for
    other shapes, and for empty paths.
    """
    estimated, true = real_array(estimated, "estimated"), real_array(true, "true")
    if estimated.shape != true.shape or estimated.ndim != 2 or len(true) == 0 or true.shape[1] != 3:
        raise DataError(f"need two paths of equal shape (steps, 3); got {estimated.shape} and {true.shape}")
    end_estimated, end_true = between(estimated[0], estimated[-1]), between(true[0], true[-1])
    return float(np.hypot(*(end_estimated - end_true)[:2]))


def path_length_m(poses: ArrayLike, step_max_m: float = np.inf) -> float:
    """Length of the path through (t, 2) or (t, 3) poses; longer steps than `step_max_m` are none of it: the robot was
    carried. Raises DataError for other shapes."""
    path = real_array(poses, "poses")
    if path.ndim != 2 or path.shape[1] not in (2, 3):
        raise DataError(f"a path has positions (steps, 2) or poses (steps, 3); got {path.shape}")
    steps_m = np.diff(path[:, :2], axis=0)
    lengths_m = np.hypot(steps_m[:, 0], steps_m[:, 1])
    return float(np.sum(lengths_m[lengths_m <= step_max_m]))


def stuck_share(true_poses: ArrayLike, window: int, radius_m: float, is_commanded: ArrayLike | None = None) -> float:
    """Share of the episode in which a robot made no progress, maximum over the robots.

    true_poses (t, n, 2 or 3). A step counts if it lies in a window of `window` steps in which the robot stayed within
    `radius_m` of its position at the end of the window. With is_commanded (t - 1, n), whether a robot was told to move
    from each pose to the next, only windows count in more than half of which it was: a robot that waits is not stuck.
    Raises DataError for other shapes.
    """
    poses = real_array(true_poses, "true_poses")
    if poses.ndim != 3 or poses.shape[2] not in (2, 3):
        raise DataError(f"poses of a team have shape (steps, robots, 2 or 3); got {poses.shape}")
    positions_m = poses[..., :2]  # (t, n, 2)
    count = len(positions_m) - window
    if window < 1 or count < 1:
        return 0.0
    starts_stuck = np.empty((count, positions_m.shape[1]), np.bool_)  # the window that begins at this step
    _find_stuck(positions_m, window, radius_m**2, starts_stuck)
    if is_commanded is not None:
        commanded = np.asarray(is_commanded, bool)
        if commanded.shape != (len(poses) - 1, poses.shape[1]):
            raise DataError(f"{len(poses)} poses need commands of shape (steps - 1, robots); got {commanded.shape}")
        so_far = np.cumsum(np.vstack([np.zeros((1, commanded.shape[1]), int), commanded]), axis=0)  # (t, n)
        starts_stuck &= 2 * (so_far[window:] - so_far[:-window]) > window
    change = np.zeros((len(positions_m) + 1, positions_m.shape[1]), int)
    change[:count] += starts_stuck
    change[window + 1 : window + 1 + count] -= starts_stuck
    is_stuck = np.cumsum(change, axis=0)[:-1] > 0  # (t, n)
    return float(is_stuck.mean(axis=0).max())


def _position_pairs(estimated: ArrayLike, true: ArrayLike) -> tuple[Array, Array]:
    estimated, true = real_array(estimated, "estimated"), real_array(true, "true")
    _check_pairs(estimated, true)
    return estimated[..., :2].reshape(-1, 2), true[..., :2].reshape(-1, 2)


def _check_pairs(estimated: Array, true: Array) -> None:
    are_poses = all(a.shape[-1:] in ((2,), (3,)) for a in (estimated, true))
    if not are_poses or estimated.shape[:-1] != true.shape[:-1] or true.size == 0:
        raise DataError(
            "need as many estimated as true positions (..., 2) or poses (..., 3), at least one; "
            f"got {estimated.shape} and {true.shape}"
        )


@kernel
def _find_stuck(positions, window, radius2, starts_stuck):
    """Whether each robot stays near the end of the window of `window` steps that begins at each step."""
    for i in range(positions.shape[1]):
        for t in range(starts_stuck.shape[0]):
            x, y = positions[t + window, i, 0], positions[t + window, i, 1]
            starts_stuck[t, i] = True
            for k in range(t, t + window):
                dx, dy = positions[k, i, 0] - x, positions[k, i, 1] - y
                if dx * dx + dy * dy >= radius2:
                    starts_stuck[t, i] = False
                    break
