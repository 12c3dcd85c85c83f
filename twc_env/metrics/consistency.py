"""Whether robots know how far they may have gone astray: their errors beside the standard deviations they told."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.geometry import between


def errors_since_closure(
    believed: Array, true: Array, std: Array, since_closure_m: Array, map_version: Array
) -> tuple[Array, Array]:
    """Errors (n, 3) along the map's axes of what robots believed of their way since a closure, and their std (n, 3).

    believed and true poses and std, all (samples, robots, 3); since_closure_m and map_version (samples, robots).
    A way begins where a robot's path since its last closure is shorter than a sample before, and ends with the next
    closure or where the map jumped. Position [m] and heading [rad], not aligned: both ends of a way lie in one map.
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
