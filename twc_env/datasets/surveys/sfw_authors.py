"""The logs that the authors of inverse k-visibility published: strengths along two walks, and a LiDAR map.

Positions are pixels of the authors' own window, whose y runs down; the LiDAR picture has another scale and frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.datasets.buildings.raster import read_grey
from twc_env.datasets.surveys.fingerprints import numbered_words, numbers
from twc_env.errors import DataError

ROUTERS_PX = np.array([(397.0, 236.0), (830.0, 620.0)])
"""Router positions in the authors' program; the walk with one router has the first."""
THRESHOLDS_DBM = (-41.0, -56.0)
"""Limits between k = 0, 1 and 2 in their program."""
FLOOR_M2 = 42.5
"""Printed area."""
_FILES = {1: ("Exp1_1router.csv", 1), 2: ("Exp3_2router.csv", 4)}
"""File, and columns of strengths."""
_FREE_FROM, _WALL_TO = 250, 60


@dataclass(frozen=True, slots=True, eq=False)
class AuthorsWalk:
    """One log."""

    position_px: Array
    """(readings, 2) x, y."""
    rssi_dbm: Array
    """(readings, columns): the one router; or router 1 at 2.4 and 5 GHz, router 2 at 2.4 and 5 GHz."""
    router_of: Array
    """(columns,) number of the router in ROUTERS_PX."""


def read_authors_walk(folder: str | Path, routers: int) -> AuthorsWalk:
    """The walk with one router (experiment 3 of the paper) or two (experiment 5). DataError for invalid files."""
    if routers not in _FILES:
        raise DataError(f"the authors published walks with 1 and 2 routers; got {routers}")
    name, columns = _FILES[routers]
    path = Path(folder) / name
    rows, lines = numbered_words(path)
    table = numbers([row[: 2 + columns] for row in rows[1:]], lines[1:], path)
    if table.shape[1] != 2 + columns:
        raise DataError(f"{path} must hold rows of {2 + columns} numbers or more; got {table.shape[1]}")
    router_of = np.array([0]) if columns == 1 else np.array([0, 0, 1, 1])
    return AuthorsWalk(table[:, :2], table[:, 2:], router_of)


def read_lidar_map(folder: str | Path) -> tuple[Array, Array]:
    """(rows, columns) bool free and wall pixels of the LiDAR picture, row 0 at the top."""
    grey = read_grey(Path(folder) / "exp3_gt.png")
    return grey >= _FREE_FROM, grey <= _WALL_TO
