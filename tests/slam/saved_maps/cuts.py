"""An irregular building, and maps of it as two runs saved them. Generated offices repeat their rooms too often."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twc_env.datasets.buildings.ros_map import write_ros_map
from twc_env.records.messages import GridMap
from twc_env.reproduce.maps.map_cuts import Cut, overlapping_parts, saved_parts
from twc_env.slam.saved_maps.saved_map import SavedMap


def irregular_building(seed: int = 0) -> SavedMap:
    """A rectangle of 26 x 18 m, split into rooms of random sizes with doors at random places."""
    random = np.random.default_rng(seed)
    free = np.zeros((182, 262), bool)
    free[2:-2, 2:-2] = True
    _split(free, 2, 180, 2, 260, random)
    return SavedMap("irregular", free, ~free, 0.1)


def _split(free: np.ndarray, r0: int, r1: int, c0: int, c1: int, random: np.random.Generator) -> None:
    rows, columns = r1 - r0, c1 - c0
    if max(rows, columns) < 70:
        return
    if columns >= rows:
        at, door = int(random.integers(c0 + 25, c1 - 25)), int(random.integers(r0 + 2, r1 - 12))
        free[r0:r1, at : at + 2] = False
        free[door : door + 9, at : at + 2] = True
        _split(free, r0, r1, c0, at, random)
        _split(free, r0, r1, at + 2, c1, random)
    else:
        at, door = int(random.integers(r0 + 25, r1 - 25)), int(random.integers(c0 + 2, c1 - 12))
        free[at : at + 2, c0:c1] = False
        free[at : at + 2, door : door + 9] = True
        _split(free, r0, at, c0, c1, random)
        _split(free, at + 2, r1, c0, c1, random)


def cut_building(seed: int = 0) -> Cut:
    """Two overlapping maps of it."""
    random = np.random.default_rng(seed)
    building = irregular_building()
    return saved_parts(building, overlapping_parts(building, 0.55, random), (0.1, 0.1), random)


def saved_cut(folder: Path) -> list[str]:
    """The two maps as files, monday.yaml and tuesday.yaml; returns their paths."""
    cut = cut_building()
    paths = []
    for saved, name in ((cut.target, "monday"), (cut.source, "tuesday")):
        log_odds = np.where(saved.walls, 1, np.where(saved.free, -1, 0)).astype(np.int16)
        paths.append(str(write_ros_map(GridMap(log_odds, saved.origin[:2], saved.resolution_m), folder, name)))
    return paths
