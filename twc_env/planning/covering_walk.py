"""Coverage walks: short walks over open floor from which many cells are observed.

Each place observes some cells, and a walk observes the union over all places on it. The walk minimises its length plus
a penalty for every unobserved cell: a travelling salesman problem with profits and overlapping coverage. It is a
sequence of places joined by shortest paths, optimised by simulated annealing.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.kernels.compiled import kernel
from twc_env.planning.terrain import Terrain

TURNS_MAX = 60
"""Maximum places in the sequence that defines a walk."""
NEIGHBOUR_COUNT = 30
"""Nearest places of each to which annealing may shift a turn."""
EDGE_SPACINGS = 2.2
"""Maximum edge length in multiples of the spacing."""
SPACING_FACTOR = 1.25
"""Factor on the spacing as long as there are more than `PLACES_MAX` places."""
PLACES_MAX = 900
TEMPERATURE_START_M, TEMPERATURE_END_M = 1.0, 0.02
"""Annealing temperatures: cost increases of this size are accepted with probability 1/e."""


@dataclass(frozen=True, slots=True, eq=False)
class WalkGraph:
    """Places on open floor and the shortest paths between them; place 0 is the start."""

    places_m: Array
    """(places, 2) in the map frame."""
    lengths_m: Array
    """(places, places) shortest path lengths."""
    via: Array
    """(places, places) int32: predecessor of the second place on the shortest path from the first; diagonal < 0."""
    near: Array
    """(places, k) int32: nearest places of each by path length."""

    @classmethod
    def reached(cls, places_m: Array, pairs: Array, lengths_m: Array, start: int) -> tuple[WalkGraph, Array]:
        """The graph of the places (k, 2) that can be reached from number `start`, and the numbers of these.

        pairs (n, 2), lengths_m (n,): the edges between all of them.
        """
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import dijkstra

        ends = tuple(pairs.T.astype(np.int32))  # the index type that all versions of csgraph accept
        edges = coo_array((lengths_m, ends), shape=(len(places_m), len(places_m))).tocsr()
        kept = np.flatnonzero(np.isfinite(dijkstra(edges, directed=False, indices=start)))
        ways_m, via = dijkstra(edges[kept][:, kept], directed=False, return_predecessors=True)
        near = np.argsort(ways_m, axis=1, kind="stable")[:, 1 : NEIGHBOUR_COUNT + 1]
        return cls(places_m[kept], ways_m, via.astype(np.int32), near.astype(np.int32)), kept

    def way(self, turns: Array) -> Array:
        """(k,) all places on the shortest paths between consecutive turns, the first included."""
        found = [int(turns[0])]
        for first, last in pairwise(turns):
            part, at = [], int(last)
            while at != first:
                part.append(at)
                at = int(self.via[first, at])
            found += part[::-1]
        return np.array(found)


def walk_graph(terrain: Terrain, start_m: Array, spacing_m: float) -> WalkGraph:
    """The graph of places reachable from start_m (2,), at least `spacing_m` apart, those beside closed cells first."""
    from scipy.spatial import cKDTree

    is_open = terrain.cost > 0
    spacing = spacing_m / terrain.resolution_m
    while True:
        cells = _sample_places(is_open, spacing)
        if len(cells) <= PLACES_MAX:
            break
        spacing *= SPACING_FACTOR
    places = np.vstack([terrain.to_cells(start_m), cells + 0.5])
    pairs = cKDTree(places).query_pairs(EDGE_SPACINGS * spacing, output_type="ndarray")
    pairs = pairs[_are_lines_open(is_open, places[pairs[:, 0]], places[pairs[:, 1]])]
    apart = np.linalg.norm(places - places[0], axis=1)
    if not (pairs == 0).any() and len(places) > 1:  # the start lies in a closed cell
        pairs = np.vstack([pairs, [0, 1 + int(np.argmin(apart[1:]))]])
    lengths_m = np.linalg.norm(places[pairs[:, 0]] - places[pairs[:, 1]], axis=1) * terrain.resolution_m
    return WalkGraph.reached(terrain.to_metres(places), pairs, lengths_m, 0)[0]


def covering_walk(graph: WalkGraph, told: Array, price_m: float, turns: Array, draws: Array) -> tuple[Array, int]:
    """(k,) turns of the best walk, place 0 first, and the count of cells that it observes.

    told (places, cells) bool: cells observed from each place; price_m: penalty per unobserved cell; turns (k,): initial
    walk; draws (tries, 4): uniform in [0, 1).
    """
    padded = np.pad(told, ((0, 0), (0, -told.shape[1] % 64)))
    words = np.ascontiguousarray(np.packbits(padded, axis=1)).view(np.uint64)
    first = np.zeros(TURNS_MAX, np.int32)
    count = min(len(turns), TURNS_MAX)
    first[:count] = turns[:count]
    if len(graph.places_m) < 2:
        return first[:1], int(told[0].sum())
    best, count, cells = _anneal(first, count, graph.lengths_m, graph.via, graph.near, words, price_m, draws)
    return best[:count], cells


@kernel
def _sample_places(is_open, spacing):
    """(k, 2) open cells at least `spacing` apart, those beside closed ones first."""
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
    """(k,) whether all cells on the lines between points (k, 2) [cells] are open, ends not counted."""
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
def bit_count(word):
    """Number of bits set in a 64-bit word."""
    word = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    word = (word & np.uint64(0x3333333333333333)) + ((word >> np.uint64(2)) & np.uint64(0x3333333333333333))
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int64((word * np.uint64(0x0101010101010101)) >> np.uint64(56))


@kernel
def _evaluate_walk(turns, count, lengths, via, words, union):
    """Length [m] of a walk and the count of cells that it observes; union (words,) is scratch."""
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
        cells += bit_count(union[w])
    return length, cells


@kernel
def _anneal(turns, count, lengths, via, near, words, price, draws):
    """Simulated annealing; (turns, their count, observed cells) of the best walk.

    A move removes, inserts, shifts or relocates a turn, or reverses a part of the sequence.
    """
    places, tries = lengths.shape[0], draws.shape[0]
    union = np.empty(words.shape[1], np.uint64)
    trial, best = turns.copy(), turns.copy()
    length, cells = _evaluate_walk(turns, count, lengths, via, words, union)
    cost = length - price * cells
    best_cost, best_count, best_cells = cost, count, cells
    for t in range(tries):
        kind, place, where, acceptance = draws[t]
        trial[:] = turns
        size = count
        i = 1 + int(place * max(count - 1, 1))
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
        length, cells = _evaluate_walk(trial, size, lengths, via, words, union)
        temperature = TEMPERATURE_START_M * (1.0 - t / tries) ** 2 + TEMPERATURE_END_M
        if length - price * cells < cost or acceptance < np.exp((cost - length + price * cells) / temperature):
            turns[:] = trial
            count, cost = size, length - price * cells
            if cost < best_cost - 1e-9:
                best[:] = trial
                best_cost, best_count, best_cells = cost, size, cells
    return best, best_count, best_cells
