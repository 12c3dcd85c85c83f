"""Consistency of the pose uncertainty: actual errors and reported standard deviations."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.records.geometry import between


def errors_since_closure(
    believed: Array, true: Array, std: Array, since_closure_m: Array, map_version: Array
) -> tuple[Array, Array]:
    """Errors (n, 3) of the estimated motion since a closure, along the axes of the map, and its reported std (n, 3).

    believed and true poses and std, all (samples, robots, 3); since_closure_m and map_version (samples, robots).
    A motion starts at the sample where since_closure_m has decreased, and ends with the next closure or a jump of the
    map. Position [m] and heading [rad], without alignment: both ends of a motion lie in one map.
    """
    errors, stds = [], []
    for robot in range(true.shape[1]):
        since_m, version = since_closure_m[:, robot], map_version[:, robot]
        start = 0
        for now in range(1, len(since_m)):
            if since_m[now] < since_m[now - 1]:
                start = now
            elif since_m[now] > since_m[start] and version[now] == version[start]:
                moved = between(believed[start, robot], believed[now, robot])
                error = moved - between(true[start, robot], true[now, robot])
                heading = believed[start, robot, 2]
                c, s = np.cos(heading), np.sin(heading)
                turned = (error[2] + np.pi) % (2 * np.pi) - np.pi
                errors.append([c * error[0] - s * error[1], s * error[0] + c * error[1], turned])
                stds.append(std[now, robot])
    return np.array(errors).reshape(-1, 3), np.array(stds).reshape(-1, 3)
