"""Short walks over open floor from which much is told: which places to visit and in which order, planned as a whole.

Every place tells some cells, and a walk tells what any place on it tells. The walk sought is the shortest when every
cell left untold counts as some more metres: a travelling salesman who may leave out towns, and is paid once for what
several of them offer. Simulated annealing over the places at which the walk turns; between these it takes the shortest
way, and tells what lies on it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels import kernel
from twc_env.planning.terrain import Terrain

TURNS_MAX = 60
"""A walk turns at most so often."""
NEAR_COUNT = 30
"""A turn is shifted to one of so many nearest places."""
REACH = 2.2
"""Places are joined up to so many spacings apart, where the line between them is open."""
WIDER = 1.25
"""A terrain with too many places is read with so much wider spacing."""
PLACES_MAX = 900
HOT_M, COLD_M = 1.0, 0.02
"""Walks longer by this are accepted at first, and at last."""


@dataclass(frozen=True, slots=True, eq=False)
class WalkGraph:
    """Places on open floor and the shortest ways between them; place 0 is where the walk starts."""

    places_m: Array
    """(places, 2) in the map frame."""
    lengths_m: Array
    """(places, places)."""
    via: Array
    """(places, places) int32: the place before the second on the way from the first; below 0 on the diagonal."""
    near: Array
    """(places, k) int32: the nearest places of each by way."""

    def way(self, turns: Array) -> Array:
        """(k,) every place on the walk that turns at these places, the first included."""
        found = [int(turns[0])]
        for first, last in pairwise(turns):
            part, at = [], int(last)
            while at != first:
                part.append(at)
                at = int(self.via[first, at])
            found += part[::-1]
        return np.array(found)


def walk_graph(terrain: Terrain, start_m: Array, spacing_m: float) -> WalkGraph:
    """Places that can be reached from start_m (2,), about `spacing_m` apart, along the rim of the open floor first."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra
    from scipy.spatial import cKDTree

    is_open = terrain.cost > 0
    spacing = spacing_m / terrain.resolution_m
    while True:
        cells = _spread_out(is_open, spacing)
        if len(cells) <= PLACES_MAX:
            break
        spacing *= WIDER
    places = np.vstack([terrain.to_cells(start_m), cells + 0.5])
    pairs = cKDTree(places).query_pairs(REACH * spacing, output_type="ndarray")
    pairs = pairs[_are_lines_open(is_open, places[pairs[:, 0]], places[pairs[:, 1]])]
    apart = np.linalg.norm(places - places[0], axis=1)
    if not (pairs == 0).any() and len(places) > 1:  # the robot stands where its map shows no room
        pairs = np.vstack([pairs, [0, 1 + int(np.argmin(apart[1:]))]])
    lengths = np.linalg.norm(places[pairs[:, 0]] - places[pairs[:, 1]], axis=1) * terrain.resolution_m
    ends = tuple(pairs.T.astype(np.int32))  # the kind that all versions of csgraph take
    edges = coo_array((lengths, ends), shape=(len(places), len(places)))
    kept = np.flatnonzero(np.isfinite(dijkstra(edges, directed=False, indices=0)))
    lengths_m, via = dijkstra(edges.tocsr()[kept][:, kept], directed=False, return_predecessors=True)
    near = np.argsort(lengths_m, axis=1, kind="stable")[:, 1 : NEAR_COUNT + 1]
    return WalkGraph(terrain.to_metres(places[kept]), lengths_m, via.astype(np.int32), near.astype(np.int32))


def covering_walk(graph: WalkGraph, told: Array, price_m: float, turns: Array, draws: Array) -> tuple[Array, int]:
    """(k,) places at which the walk turns, place 0 first, and how many cells it tells.

    told (places, cells) says what each place tells, price_m is what each cell is worth, turns (k,) is a walk to begin
    with, and draws (tries, 4) uniform in [0, 1).
    """
    padded = np.pad(told, ((0, 0), (0, -told.shape[1] % 64)))
    words = np.ascontiguousarray(np.packbits(padded, axis=1)).view(np.uint64)
    first = np.zeros(TURNS_MAX, np.int32)
    count = min(len(turns), TURNS_MAX)
    first[:count] = turns[:count]
    if len(graph.places_m) < 2:
        return first[:1], int(told[0].sum())
    best, count, cells = _annealed(first, count, graph.lengths_m, graph.via, graph.near, words, price_m, draws)
    return best[:count], cells


@kernel
def _spread_out(is_open, spacing):
    """(k, 2) open cells no nearer to each other than `spacing`, those beside closed ones first."""
    rows, columns = is_open.shape
    reach, limit = int(spacing) + 1, spacing * spacing
    taken, found = np.zeros(is_open.shape, np.bool_), np.empty((is_open.size, 2), np.int64)
    count = 0
    for on_rim in (True, False):
        for r in range(1, rows - 1):
            for c in range(1, columns - 1):
                if not is_open[r, c]:
                    continue
                inside = is_open[r - 1, c] and is_open[r + 1, c] and is_open[r, c - 1] and is_open[r, c + 1]
                if inside == on_rim:
                    continue
                is_crowded = False
                for i in range(max(0, r - reach), min(rows, r + reach + 1)):
                    for j in range(max(0, c - reach), min(columns, c + reach + 1)):
                        if taken[i, j] and (i - r) ** 2 + (j - c) ** 2 < limit:
                            is_crowded = True
                if not is_crowded:
                    taken[r, c] = True
                    found[count, 0], found[count, 1] = r, c
                    count += 1
    return found[:count]


@kernel
def _are_lines_open(is_open, first, last):
    """(k,) whether all cells on the lines between points (k, 2), in cells, are open; their ends count as open."""
    rows, columns = is_open.shape
    found = np.ones(first.shape[0], np.bool_)
    for k in range(first.shape[0]):
        dr, dc = last[k, 0] - first[k, 0], last[k, 1] - first[k, 1]
        steps = int(2.0 * np.sqrt(dr * dr + dc * dc)) + 1
        for s in range(1, steps):
            r, c = int(first[k, 0] + dr * s / steps), int(first[k, 1] + dc * s / steps)
            if r < 0 or c < 0 or r >= rows or c >= columns or not is_open[r, c]:
                found[k] = False
    return found


@kernel
def _ones(word):
    """Bits that are set in a 64-bit word."""
    word = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    word = (word & np.uint64(0x3333333333333333)) + ((word >> np.uint64(2)) & np.uint64(0x3333333333333333))
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int64((word * np.uint64(0x0101010101010101)) >> np.uint64(56))


@kernel
def _weighed(turns, count, lengths, via, words, union):
    """Length of a walk and the cells that it tells; union (words,) is scratch."""
    union[:] = words[turns[0]]
    length = 0.0
    for k in range(count - 1):
        first, at = turns[k], turns[k + 1]
        length += lengths[first, at]
        while at != first:
            for w in range(union.shape[0]):
                union[w] |= words[at, w]
            at = via[first, at]
    cells = 0
    for w in range(union.shape[0]):
        cells += _ones(union[w])
    return length, cells


@kernel
def _annealed(turns, count, lengths, via, near, words, price, draws):
    """The best walk met, its turns and its cells. A try adds, drops, shifts or moves a turn, or turns a part round."""
    places, tries = lengths.shape[0], draws.shape[0]
    union = np.empty(words.shape[1], np.uint64)
    trial, best = turns.copy(), turns.copy()
    length, cells = _weighed(turns, count, lengths, via, words, union)
    cost = length - price * cells
    best_cost, best_count, best_cells = cost, count, cells
    for t in range(tries):
        kind, place, where, luck = draws[t]
        trial[:] = turns
        size = count
        i = 1 + int(place * max(count - 1, 1))  # some turn
        j = int(where * near.shape[1])
        if kind < 0.2:
            if count < 2:
                continue
            trial[i : count - 1] = turns[i + 1 : count]
            size -= 1
        elif kind < 0.5:
            if count == turns.shape[0]:
                continue
            i = 1 + int(place * count)
            trial[i + 1 : count + 1] = turns[i:count]
            trial[i] = int(where * places) if kind < 0.4 else near[turns[i - 1], j]
            size += 1
        elif kind < 0.75:
            if count < 2:
                continue
            trial[i] = near[turns[i], j]
        elif count > 3:
            k = 1 + int(where * (count - 1))
            first, last = min(i, k), max(i, k)
            if kind < 0.9:
                trial[first : last + 1] = turns[first : last + 1][::-1]
            else:
                trial[first:last] = turns[first + 1 : last + 1]
                trial[last] = turns[first]
        else:
            continue
        length, cells = _weighed(trial, size, lengths, via, words, union)
        heat = HOT_M * (1.0 - t / tries) ** 2 + COLD_M
        if length - price * cells < cost or luck < np.exp((cost - length + price * cells) / heat):
            turns[:] = trial
            count, cost = size, length - price * cells
            if cost < best_cost - 1e-9:
                best[:] = trial
                best_cost, best_count, best_cells = cost, size, cells
    return best, best_count, best_cells
