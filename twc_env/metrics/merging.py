"""Whether robots that share one map frame do so rightly."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from twc_env.errors import DataError
from twc_env.geometry import compose, wrap_angle

Array = NDArray


def implied_frames(estimated_poses: Array, true_poses: Array, robot_of: Array) -> Array:
    """Where each robot's own path places the map frame in the building: (n, 3) poses `pose_building_map`.

    Both (k, 3): estimates in one map frame, truth in the building frame, of all robots together; robot_of (k,) says
    whose each is, counted from 0. The heading is the mean heading difference, so that a robot that never moved has a
    frame too. All frames of a perfect merge are equal.
    """
    estimated, true = np.asarray(estimated_poses, float), np.asarray(true_poses, float)
    if estimated.shape != true.shape or true.ndim != 2 or true.shape[1] != 3 or len(true) == 0:
        raise DataError(f"need two arrays of equal shape (poses, 3); got {estimated.shape} and {true.shape}")
    frames = np.empty((int(np.max(robot_of)) + 1, 3))
    _implied_frames(estimated, true, np.asarray(robot_of), frames)
    return frames


@njit(cache=True, error_model="numpy")
def _implied_frames(estimated, true, robot_of, frames):
    for robot in range(frames.shape[0]):
        count = 0
        c = s = ex = ey = tx = ty = 0.0
        for k in range(len(robot_of)):
            if robot_of[k] == robot:
                turned = true[k, 2] - estimated[k, 2]
                c += math.cos(turned)
                s += math.sin(turned)
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


def wrong_pairs(
    poses_building_map: ArrayLike,
    centre_map_m: ArrayLike = (0.0, 0.0),
    distance_max_m: float = 1.0,
    angle_max_rad: float = math.radians(10.0),
) -> list[tuple[int, int]]:
    """Pairs (i, j), i < j, of robots of one group that disagree where the map frame lies in the building.

    poses_building_map (n, 3) as `implied_frames` gives them. Two frames agree when they put `centre_map_m` (2,), a
    point amid the group's paths, at most distance_max_m apart and their headings at most angle_max_rad.
    """
    frames = np.asarray(poses_building_map, float)
    places = compose(frames, [*np.asarray(centre_map_m, float), 0.0])
    apart_m = np.hypot(*(places[:, None, :2] - places[None, :, :2]).T)
    turned_rad = np.abs(wrap_angle(frames[:, None, 2] - frames[None, :, 2]))
    wrong = np.triu((apart_m > distance_max_m) | (turned_rad > angle_max_rad), 1)
    return [(int(i), int(j)) for i, j in np.argwhere(wrong)]
