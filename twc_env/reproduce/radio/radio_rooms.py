"""Rooms inferred from a survey whose points have room types.

A surveyed corridor is open from end to end, other rooms have walls around them. Unsurveyed areas get square rooms.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array
from scipy.ndimage import binary_fill_holes, distance_transform_edt, maximum_filter, median_filter, minimum_filter

from twc_env.datasets.buildings.raster import free_edges, parts
from twc_env.datasets.surveys.fingerprints import RadioSurvey
from twc_env.reproduce.radio_places import MODULE_M, OUTER_WALL_DB, WALL_DB
from twc_env.world.building.floorplan import Floorplan

CELL_M = 0.2
REACH_M = 1.7
"""A room extends this far beyond its outermost points: access points on walls are 1.6 to 2 m away from them."""
BRIDGED_M = 5.0
"""Maximum width of unsurveyed areas inside a room, such as furniture."""
ROOM_MIN_M2 = 10.0
CORRIDOR = 1
"""Room type whose points cover the floor."""


def surveyed_rooms(survey: RadioSurvey, floor: int, bounds_m: Array) -> Floorplan:
    """The plan of a storey of a survey with room types, within bounds (4,)."""
    origin = np.asarray(bounds_m[:2], float)
    columns, rows = np.ceil((np.asarray(bounds_m[2:]) - origin) / CELL_M).astype(int).tolist()
    here = survey.floor == floor
    cells = np.floor((survey.position_m[here] - origin) / CELL_M).astype(int)
    labels = _known(cells, survey.room_kinds[here], (rows, columns))
    drawn = labels.max() + 1 + _drawn((rows, columns))
    walls = free_edges(_without_slivers(np.where(labels > 0, labels, drawn)))
    is_outer = (walls == 0).all(axis=1).any(axis=1) | (walls == [columns, rows]).all(axis=1).any(axis=1)
    column, row = cells[0]
    return Floorplan(
        f"{survey.name} floor {floor}",
        walls * CELL_M + origin,
        np.where(is_outer, OUTER_WALL_DB, WALL_DB),
        interior_m=origin + (np.array([[column, row]]) + 0.5) * CELL_M,
    )


def _known(cells: Array, kinds: Array, shape: tuple[int, int]) -> Array:
    """(rows, columns) number of the surveyed room of each cell, 0 for none; overlaps go to the nearest point."""
    rooms, away = [], []
    for kind in np.unique(kinds):
        points = np.zeros(shape, bool)
        points[cells[kinds == kind, 1], cells[kinds == kind, 0]] = True
        bridged_m = 2 * REACH_M if kind == CORRIDOR else BRIDGED_M
        wide = maximum_filter(points, _width(bridged_m), mode="constant")
        room = minimum_filter(wide, _width(bridged_m - 2 * REACH_M), mode="constant", cval=1)
        rooms.append(binary_fill_holes(room))
        away.append(distance_transform_edt(~points))
    # The nearest point changes from cell to cell along a wall; a median filter makes it straight.
    nearest = median_filter(np.argmin(away, axis=0), _width(2 * REACH_M))
    labels = np.zeros(shape, int)
    for number, room in enumerate(rooms):
        part, _ = parts(room & (nearest == number))
        labels[part > 0] = labels.max() + part[part > 0]
    return labels


def _width(length_m: float) -> int:
    """Size of a square window, an odd number of cells."""
    return 2 * round(length_m / CELL_M / 2) + 1


def _drawn(shape: tuple[int, int]) -> Array:
    """(rows, columns) number of the square room (MODULE_M) of each cell, from 0."""
    (row, column), module = np.indices(shape), MODULE_M / CELL_M
    return (row // module * shape[1] + column // module).astype(int)


def _without_slivers(labels: Array) -> Array:
    """Labels in which parts that are too small for a room belong to the nearest room."""
    is_room = np.zeros(labels.shape, bool)
    numbers = np.zeros_like(labels)
    for label in np.unique(labels):
        number, sizes = parts(labels == label)
        large = np.append(False, sizes * CELL_M**2 >= ROOM_MIN_M2)[number]
        numbers[large] = numbers.max() + number[large]
        is_room |= large
    row, column = distance_transform_edt(~is_room, return_distances=False, return_indices=True)
    return numbers[row, column]
