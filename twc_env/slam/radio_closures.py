"""Which pairs of places become radio closures: alike, far apart along the path, each telling something new."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.slam.distance_factor import Distances
from twc_env.slam.similarity_model import SimilarityModel

SUPPORT_REACH_M = 10.0
"""Closures nearer than this at both ends speak of one revisit."""
SUPPORT_MIN = 2
"""A true revisit is told by several closures; one that stands alone is not believed."""


def alike_pairs(similarity: Array, travel_m: Array, similarity_min: float, apart_m: float) -> tuple[Array, Array]:
    """Pairs i < j more alike than this and far apart along the path (papers.md R7: the path, not the displacement)."""
    i, j = np.nonzero(similarity > similarity_min)
    kept = travel_m[j] - travel_m[i] > apart_m
    return i[kept], j[kept]


def strongest_per_cell(i: Array, j: Array, similarity: Array, travel_m: Array, cell_m: float) -> Array:
    """Of the closures of each pair of stretches (cell_m long) the most alike: non-maximum suppression."""
    rows, columns = (travel_m[i] // cell_m).astype(np.int64), (travel_m[j] // cell_m).astype(np.int64)
    return _first_of_each(rows * (columns.max(initial=0) + 1) + columns, similarity)


def strongest_per_place(i: Array, j: Array, similarity: Array, count: int) -> Array:
    """(k,) bool: closures that are among the `count` strongest of one of their ends."""
    return (_rank(i, similarity) < count) | (_rank(j, similarity) < count)


def with_support(i: Array, j: Array, travel_m: Array) -> Array:
    """(k,) bool: closures with others near at both ends. A distance alone says too little to be judged by pairs."""
    rows, columns = (travel_m[i] // SUPPORT_REACH_M).astype(np.int64), (travel_m[j] // SUPPORT_REACH_M).astype(np.int64)
    width = columns.max(initial=0) + 3
    key = (rows + 1) * width + columns + 1
    known, count = np.unique(key, return_counts=True)
    around = np.zeros(len(key), np.int64)
    for step in [a * width + b for a in (-1, 0, 1) for b in (-1, 0, 1)]:
        at = np.minimum(np.searchsorted(known, key + step), len(known) - 1)
        around += np.where(known[at] == key + step, count[at], 0)
    return around - 1 >= SUPPORT_MIN


def closures(
    similarity: Array,
    travel_m: Array,
    model: SimilarityModel,
    similarity_min: float,
    apart_m: float,
    cell_m: float,
    per_place: int,
) -> Distances:
    """Radio closures of one cue: alike, the strongest of their neighbourhood, few per place."""
    i, j = alike_pairs(similarity, travel_m, similarity_min, apart_m)
    s = similarity[i, j]
    kept = strongest_per_cell(i, j, s, travel_m, cell_m)
    i, j, s = i[kept], j[kept], s[kept]
    kept = strongest_per_place(i, j, s, per_place)
    i, j, s = i[kept], j[kept], s[kept]
    return Distances(np.column_stack([i, j]), *model.distance(s))


def _first_of_each(key: Array, score: Array) -> Array:
    """Index of the highest score of each key, in order of the keys."""
    order = np.lexsort((-score, key))
    sorted_key = key[order]
    is_first = np.concatenate([[True], sorted_key[1:] != sorted_key[:-1]]) if len(key) else np.zeros(0, bool)
    return order[is_first]


def _rank(key: Array, score: Array) -> Array:
    """(k,) how many of the same key score higher."""
    order = np.lexsort((-score, key))
    position = np.arange(len(key))
    starts = np.zeros(len(key), np.int64)
    sorted_key = key[order]
    new = np.flatnonzero(sorted_key[1:] != sorted_key[:-1]) + 1
    starts[new] = new
    rank = np.empty(len(key), np.int64)
    rank[order] = position - np.maximum.accumulate(starts)
    return rank
