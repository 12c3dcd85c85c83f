"""Inverse k-visibility as published: dense inverse, rules, Eq. 4 and 5, and Algorithm 1 (papers.md K3, K7-K15).

Choices that the paper leaves open are settings.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from numpy.typing import NDArray as Array

from twc_env.errors import DataError
from twc_env.kernels.compiled import kernel
from twc_env.records.array_validation import validated_points, validated_rows
from twc_env.slam.walls.k_visibility_grid import FREE, UNKNOWN, WALL

LITERAL, MIXTURE = 0, 1
_EQUATIONS = {"literal": LITERAL, "mixture": MIXTURE}
ALGORITHM_1_STEP = 8
"""Sigma of Algorithm 1: change of a cell's grey level by one reading."""


@dataclass(frozen=True, slots=True)
class RuleSettings:
    """Choices that the paper leaves open."""

    equation_4: str = "mixture"
    """"literal": exp(-(1/M)^2 d)/L on every segment; "mixture": one Gaussian per wall of the segment (K9)."""
    wall_from: float | None = None
    """Least mu of a wall; cells below it stay unknown. None: all cells seen only through walls are walls (rule 3)."""
    with_outer_box: bool = True
    """Draw the bounding box of all free cells as outer wall (K8)."""


def walls_from_k_map(k_map: Array, router_cell: Array) -> Array:
    """(rows, columns) bool walls from the number of walls k between router and every cell, -1 unknown (Sec. IV, K3).

    A cell is a wall if k increases there along the ray from the router. If unknown cells lie between the two values,
    the first and the last of them are walls.
    """
    walls = np.zeros(k_map.shape, np.bool_)
    _mark_changes(np.ascontiguousarray(k_map), np.asarray(router_cell, float), walls, _room(router_cell, k_map.shape))
    return walls


def map_by_rules(
    cells: Array, walls: Array, router_of: Array, router_cells: Array, shape: tuple[int, int],
    settings: RuleSettings | None = None,
) -> tuple[Array, Array]:  # fmt: skip
    """Classes (rows, columns) and mu (rows, columns; NaN without estimate) from readings at cells (n, 2) (row, column).

    walls (n,): number of walls k between each reading and its router router_of (n,), at router_cells (routers, 2).
    Raises DataError for arrays that do not belong together.
    """
    settings = settings or RuleSettings()
    router_cells = validated_points(router_cells, "places of routers")
    cells, walls, router_of = _checked(cells, walls, router_of, len(router_cells))
    free = np.zeros(shape, np.bool_)
    mu, variance = np.full(shape, np.nan), np.full(shape, np.inf)
    known_k = np.full((len(router_cells), *shape), -1, np.int64)
    for router in range(len(router_cells)):
        mine = router_of == router
        _put_medians(known_k[router], cells[mine], walls[mine])
    places = np.asarray(cells, np.int64)
    _apply_rules(
        places, np.asarray(walls, np.int64), np.asarray(router_of, np.int64), np.asarray(router_cells, float), known_k,
        _EQUATIONS[settings.equation_4], free, mu, variance, _room(router_cells, places),
    )  # fmt: skip
    seen = np.isfinite(mu)
    limit = -np.inf if settings.wall_from is None else settings.wall_from
    classes = np.full(shape, UNKNOWN, np.uint8)
    classes[seen & (np.nan_to_num(mu) >= limit)] = WALL
    classes[free] = FREE
    if settings.with_outer_box:
        _draw_box(classes, free | seen)
    return classes, mu


def map_by_algorithm_1(
    cells: Array, walls: Array, rssi_dbm: Array, router_cells: Array, shape: tuple[int, int]
) -> Array:  # fmt: skip
    """Algorithm 1 with its misprints corrected (K13): (rows, columns) grey levels, P(free) = level / 255.

    Uses the router with the strongest RSSI at each reading (n, routers); k is known only in cells of the path. Raises
    DataError for arrays that do not belong together.
    """
    router_cells = validated_points(router_cells, "places of routers")
    levels = np.full(shape, UNKNOWN, np.int64)
    focus = np.argmax(np.nan_to_num(rssi_dbm, nan=-200.0), axis=1)
    cells, walls, focus = _checked(cells, walls, focus, len(router_cells))
    known_k = np.full((len(router_cells), *shape), -1, np.int64)
    for router in range(len(router_cells)):
        _put_medians(known_k[router], cells[focus == router], walls[focus == router])
    places = np.asarray(cells, np.int64)
    room = _room(router_cells, places)
    _algorithm_1(places, focus, np.asarray(router_cells, float), known_k, ALGORITHM_1_STEP, levels, room)
    return levels.astype(np.uint8)


def _checked(cells: Array, walls: Array, router_of: Array, routers: int) -> tuple[Array, Array, Array]:
    """Cells (n, 2), numbers of walls (n,) and routers (n,) of readings, as the kernels need them, which check nothing.
    Raises DataError for others."""
    with np.errstate(invalid="ignore"):  # NaN among whole numbers is told by the error alone
        cells = validated_rows(cells, (2,), "cells", np.int64)
        walls = validated_rows(walls, (), "walls", np.int64)
        router_of = validated_rows(router_of, (), "router_of", np.int64)
    if not len(cells) == len(walls) == len(router_of):
        raise DataError(f"give a number of walls and a router for each of {len(cells)} cells")
    if len(router_of) and not (router_of.min() >= 0 and router_of.max() < routers):
        raise DataError(f"router_of numbers {routers} routers from 0; got {router_of.min()} to {router_of.max()}")
    return cells, walls, router_of


def _room(*ends: ArrayLike) -> int:
    """Upper bound of the number of cells on a ray between two of these positions."""
    return 2 * int(sum(np.abs(end).max(initial=0) for end in ends)) + 8


def _put_medians(known_k: Array, cells: Array, walls: Array) -> None:
    """Write the median k of the readings in each cell to known_k (rows, columns)."""
    inside = ((cells >= 0) & (cells < known_k.shape)).all(axis=1)
    cells, walls = cells[inside], walls[inside]
    order = np.lexsort((walls, cells[:, 1], cells[:, 0]))
    rows = cells[order]
    starts = np.flatnonzero(np.any(np.diff(rows, axis=0, prepend=-1), axis=1))
    for first, last in itertools.pairwise([*starts, len(rows)]):
        known_k[tuple(rows[first])] = walls[order[(first + last) // 2]]


def _draw_box(classes: Array, known: Array) -> None:
    """Mark the bounding box of the known cells, one cell larger, as walls where it is not free."""
    rows, columns = np.nonzero(known)
    if len(rows) == 0:
        return
    top, bottom = min(rows.max() + 1, len(classes) - 1), max(rows.min() - 1, 0)
    right, left = min(columns.max() + 1, classes.shape[1] - 1), max(columns.min() - 1, 0)
    for line in (
        classes[bottom, left : right + 1], classes[top, left : right + 1],
        classes[bottom : top + 1, left], classes[bottom : top + 1, right],
    ):  # fmt: skip
        line[line != FREE] = WALL


@kernel
def _ray(start_row, start_column, row, column, path):
    """Write the cells from a position to the centre of a cell to path; returns their number."""
    dr, dc = row + 0.5 - start_row, column + 0.5 - start_column
    steps = int(max(abs(dr), abs(dc)) * 2.0) + 1
    count = 0
    for s in range(steps + 1):
        r, c = int(np.floor(start_row + dr * s / steps)), int(np.floor(start_column + dc * s / steps))
        if count == 0 or r != path[count - 1, 0] or c != path[count - 1, 1]:
            path[count, 0], path[count, 1] = r, c
            count += 1
    return count


@kernel
def _inside(path, j, rows, columns):
    return 0 <= path[j, 0] < rows and 0 <= path[j, 1] < columns


@kernel
def _apply_rules(cells, walls, router_of, routers, known_k, equation, free, mu, variance, room):
    rows, columns = free.shape
    path, cuts, ks = np.empty((room, 2), np.int64), np.empty(room, np.int64), np.empty(room, np.int64)
    for i in range(cells.shape[0]):
        if 0 <= cells[i, 0] < rows and 0 <= cells[i, 1] < columns:
            free[cells[i, 0], cells[i, 1]] = True  # rule 1
        router = router_of[i]
        count = _ray(routers[router, 0], routers[router, 1], cells[i, 0], cells[i, 1], path)
        if count < 3:
            continue
        # Cut the ray at cells of the path with known k (Fig. 6), as long as k does not decrease.
        cuts[0], ks[0], found = 0, 0, 1
        for j in range(1, count - 1):
            if _inside(path, j, rows, columns):
                k = known_k[router, path[j, 0], path[j, 1]]
                if ks[found - 1] <= k <= walls[i]:
                    cuts[found], ks[found] = j, k
                    found += 1
        cuts[found], ks[found] = count - 1, walls[i]
        for f in range(found):
            low, high, more = cuts[f], cuts[f + 1], ks[f + 1] - ks[f]
            if more <= 0:
                for j in range(low, high + 1):
                    if _inside(path, j, rows, columns):
                        free[path[j, 0], path[j, 1]] = True  # rules 2 and 4
            elif high - low >= 2:
                _add_walls(path, low, high, more, equation, mu, variance)  # rule 3


@kernel
def _add_walls(path, low, high, more, equation, mu, variance):
    """Distribute `more` walls over the cells between two cuts, and fuse with their previous estimates (Eq. 4 and 5)."""
    rows, columns = mu.shape
    between = high - low - 1
    length = float(high - low)
    total = 0.0
    for turn in range(2):  # sum first, then write
        for j in range(1, between + 1):
            if equation == LITERAL:
                value = np.exp(-((1.0 / between) ** 2) * abs(j - 0.5 * (between + 1))) / length * more
            else:
                value = 0.0
                for q in range(more):
                    centre = (2.0 * q + 1.0) / (2.0 * more) * (between + 1)
                    value += np.exp(-0.5 * ((j - centre) / (between / (4.0 * more) + 0.3)) ** 2)
            if turn == 0:
                total += value
                continue
            value = min(value if equation == LITERAL else value * more / max(total, 1e-12), 0.99)
            if not _inside(path, low + j, rows, columns):
                continue
            r, c = path[low + j, 0], path[low + j, 1]
            new = length * length
            if np.isnan(mu[r, c]):
                mu[r, c], variance[r, c] = value, new
            else:
                old = variance[r, c]
                mu[r, c] = (new * mu[r, c] + old * value) / (new + old)
                variance[r, c] = new * old / (new + old)


@kernel
def _algorithm_1(cells, focus, routers, known_k, step, levels, room):
    rows, columns = levels.shape
    path = np.empty((room, 2), np.int64)
    for i in range(cells.shape[0]):
        if 0 <= cells[i, 0] < rows and 0 <= cells[i, 1] < columns:
            levels[cells[i, 0], cells[i, 1]] = FREE
        router = focus[i]
        count = _ray(routers[router, 0], routers[router, 1], cells[i, 0], cells[i, 1], path)
        last, last_k = -1, -1
        for j in range(count):
            if not _inside(path, j, rows, columns):
                continue
            k = known_k[router, path[j, 0], path[j, 1]]
            if k < 0:
                continue
            change = step if k == 0 else -step
            first = 0 if last < 0 else last + 1
            for m in range(first, j + 1):
                if _inside(path, m, rows, columns):
                    r, c = path[m, 0], path[m, 1]
                    levels[r, c] = min(max(levels[r, c] + change, WALL), FREE)
                    if last >= 0 and k == last_k:
                        levels[r, c] = min(levels[r, c] + step + abs(min(change, 0)), FREE)  # rule 4
            last, last_k = j, k


@kernel
def _mark_changes(k_map, router, walls, room):
    rows, columns = k_map.shape
    path = np.empty((room, 2), np.int64)
    for r in range(rows):
        for c in range(columns):
            if r != 0 and c != 0 and r != rows - 1 and c != columns - 1:
                continue
            count = _ray(router[0], router[1], r, c, path)
            last, last_k = -1, 0
            for j in range(count):
                k = k_map[path[j, 0], path[j, 1]] if _inside(path, j, rows, columns) else -1
                if k < 0:
                    continue
                if k > last_k:
                    gap = j - last - 1  # unknown cells in between: the wall itself
                    if gap > 0:
                        walls[path[last + 1, 0], path[last + 1, 1]] = True
                        walls[path[j - 1, 0], path[j - 1, 1]] = True
                    else:
                        walls[path[j, 0], path[j, 1]] = True
                last, last_k = j, k
            if last >= 0 and last + 1 < count and _inside(path, last + 1, rows, columns):
                walls[path[last + 1, 0], path[last + 1, 1]] = True
