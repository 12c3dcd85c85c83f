"""One random stream per named noise source and robot: adding a sensor never shifts another's noise."""

from __future__ import annotations

import zlib

import numpy as np


def random_stream(seed: int, source: str, robot: int = 0) -> np.random.Generator:
    """The generator of one noise source (`"lidar"`, `"odometry"`, ...) of one robot.

    The same (seed, source, robot) gives the same numbers in every process and on every machine.
    """
    return np.random.default_rng([seed, zlib.crc32(source.encode()), robot])
