"""Correctness of merges: whether robots that share a map frame agree on its true pose."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from numpy.typing import NDArray as Array

from twc_env.errors import DataError
from twc_env.kernels.compiled import borrowing_kernel
from twc_env.metrics.trajectory import turns_between
from twc_env.records.array_validation import real_array

WRONG_M, WRONG_RAD = 1.0, math.radians(10.0)
"""Robots whose implied frames differ by more than one of these are wrongly merged."""


def implied_frames(estimated_poses: Array, true_poses: Array, robot_of: Array) -> Array:
    """Poses `pose_building_map` (n, 3) of the map frame in the building implied by each robot's own path.

    Both (k, 3): estimates in one map frame and truth in the building frame, of all robots together; robot_of (k,) is
    the robot of each, counted from 0. The heading is the mean heading difference, so that it is defined for a robot
    that never moved. In a perfect merge all frames are equal. NaN for a robot without poses. Raises DataError for other
    shapes and negative robots.
    """
    estimated, true = np.asarray(estimated_poses, float), np.asarray(true_poses, float)
    if estimated.shape != true.shape or true.ndim != 2 or true.shape[1] != 3 or len(true) == 0:
        raise DataError(f"need two arrays of equal shape (poses, 3); got {estimated.shape} and {true.shape}")
    whose = np.asarray(robot_of)
    if whose.shape != true.shape[:1] or whose.dtype.kind not in "iu" or whose.min() < 0:
        raise DataError(
            f"robot_of must be {len(true)} whole numbers from 0, one for each pose; got {whose.dtype} {whose.shape}"
        )
    frames = np.empty((int(np.max(whose)) + 1, 3))
    find_frames(estimated, true, turns_between(estimated, true), whose, frames)
    frames[np.bincount(whose, minlength=len(frames)) == 0] = np.nan
    return frames


@borrowing_kernel
def find_frames(estimated, true, turns, robot_of, frames):
    """Write `implied_frames` to frames (n, 3); turns as from `turns_between`."""
    for robot in range(frames.shape[0]):
        count = 0
        c = s = ex = ey = tx = ty = 0.0
        for k in range(len(robot_of)):
            if robot_of[k] == robot:
                c += turns[k, 0]
                s += turns[k, 1]
                ex += estimated[k, 0]
                ey += estimated[k, 1]
                tx += true[k, 0]
                ty += true[k, 1]
                count += 1
        heading = math.atan2(s, c)
        c, s, count = math.cos(heading), math.sin(heading), max(count, 1)
        frames[robot, 0] = (tx - c * ex + s * ey) / count
        frames[robot, 1] = (ty - s * ex - c * ey) / count
        frames[robot, 2] = heading


def wrong_pairs(poses_building_map: ArrayLike, centre_map_m: ArrayLike = (0.0, 0.0)) -> list[tuple[int, int]]:
    """Pairs (i, j), i < j, of robots of one group that disagree about the pose of the map frame in the building.

    poses_building_map (n, 3) as from `implied_frames`. Two frames agree if they place `centre_map_m` (2,), a point
    amid the group's paths, at most WRONG_M apart, and differ by at most WRONG_RAD. A robot without poses (a row of NaN)
    disagrees with none. Raises DataError for invalid poses.
    """
    frames = real_array(poses_building_map, "poses_building_map")
    centre_m = real_array(centre_map_m, "centre_map_m")
    is_shaped = frames.ndim == 2 and frames.shape[1] == 3 and centre_m.shape == (2,)
    if not is_shaped or not (np.isfinite(frames).all(axis=1) | np.isnan(frames).all(axis=1)).all():
        raise DataError(
            "need finite poses (robots, 3) of the map frame, and a point (2,); "
            f"got {frames.tolist()} and {centre_m.tolist()}"
        )
    x, y = centre_m.tolist()
    is_wrong = np.zeros((len(frames), len(frames)), bool)
    find_wrong(frames, x, y, WRONG_M, WRONG_RAD, is_wrong)
    return [(int(i), int(j)) for i, j in np.argwhere(is_wrong)]


@borrowing_kernel
def find_wrong(frames, x, y, distance_max, angle_max, is_wrong):
    """Mark the pairs (i, j), i < j, that disagree; returns their number."""
    count = 0
    for i in range(frames.shape[0]):
        for j in range(i + 1, frames.shape[0]):
            turn_i, turn_j = frames[i, 2], frames[j, 2]
            ci, si, cj, sj = math.cos(turn_i), math.sin(turn_i), math.cos(turn_j), math.sin(turn_j)
            dx = frames[i, 0] + ci * x - si * y - frames[j, 0] - cj * x + sj * y
            dy = frames[i, 1] + si * x + ci * y - frames[j, 1] - sj * x - cj * y
            turned = abs((turn_i - turn_j + math.pi) % (2.0 * math.pi) - math.pi)
            if math.sqrt(dx * dx + dy * dy) > distance_max or turned > angle_max:
                is_wrong[i, j] = True
                count += 1
    return count
