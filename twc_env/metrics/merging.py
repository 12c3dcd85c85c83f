"""Whether robots that share one map frame do so rightly."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twc_env.errors import DataError
from twc_env.geometry import transform_points, wrap_angle

Array = NDArray


def implied_frames(estimated_poses: ArrayLike, true_poses: ArrayLike) -> Array:
    """Where each robot's own path places the map frame in the building: (n, 3) poses `pose_building_map`.

    Both (t, n, 3): estimates in one map frame, truth in the building frame. The heading is the mean heading difference,
    so that a robot that never moved has a frame too. All frames of a perfect merge are equal.
    """
    estimated, true = np.asarray(estimated_poses, float), np.asarray(true_poses, float)
    if estimated.shape != true.shape or true.ndim != 3 or true.shape[2] != 3 or len(true) == 0:
        raise DataError(f"need two arrays of equal shape (steps, robots, 3); got {estimated.shape} and {true.shape}")
    turned = true[..., 2] - estimated[..., 2]  # (t, n)
    heading = np.arctan2(np.sin(turned).mean(axis=0), np.cos(turned).mean(axis=0))
    x, y = estimated[..., 0].mean(axis=0), estimated[..., 1].mean(axis=0)
    c, s = np.cos(heading), np.sin(heading)
    mean_true = true[..., :2].mean(axis=0)
    return np.stack([mean_true[:, 0] - c * x + s * y, mean_true[:, 1] - s * x - c * y, heading], axis=-1)


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
    centre = np.atleast_2d(np.asarray(centre_map_m, float))
    wrong = []
    for i, j in itertools.combinations(range(len(frames)), 2):
        offset_m = transform_points(frames[i], centre)[0] - transform_points(frames[j], centre)[0]
        turn_rad = abs(wrap_angle(frames[i, 2] - frames[j, 2]))
        if np.hypot(*offset_m) > distance_max_m or turn_rad > angle_max_rad:
            wrong.append((i, j))
    return wrong
