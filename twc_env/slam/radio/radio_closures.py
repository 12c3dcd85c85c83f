"""Select radio closures: pairs of places with similar fingerprints, far apart along the path, without redundant
ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.slam.pose_graph.distance_factor import Distances
from twc_env.slam.radio.similarity_model import SimilarityModel

SUPPORT_REACH_M = 10.0
"""Closures nearer than this at both ends belong to one revisit."""
SUPPORT_MIN = 2
"""Minimum number of other closures of the same revisit; isolated closures are rejected."""


def similar_pairs(similarity: Array, travel_m: Array, similarity_min: float, apart_m: float) -> tuple[Array, Array]:
    """Pairs i < j above a similarity and apart_m along the path (papers.md R7: path length, not displacement).

    similarity: (n, n), of which the part above the diagonal is read; travel_m: (n,) path length, rising. Returns the
    indices i (k,) and j (k,).
    """
    i, j = np.nonzero(similarity > similarity_min)
    kept = travel_m[j] - travel_m[i] > apart_m
    return i[kept], j[kept]


def strongest_per_cell(i: Array, j: Array, similarity: Array, travel_m: Array, cell_m: float) -> Array:
    """Indices of the most similar closure per pair of path segments of cell_m: non-maximum suppression.

    i, j, similarity: (k,) of the closures; travel_m: (n,) path length of the places.
    """
    rows, columns = (travel_m[i] // cell_m).astype(np.int64), (travel_m[j] // cell_m).astype(np.int64)
    return _first_of_each(rows * (columns.max(initial=0) + 1) + columns, similarity)


def strongest_per_place(i: Array, j: Array, similarity: Array, count: int) -> Array:
    """(k,) bool: closures among the `count` most similar ones of one of their ends."""
    return (_rank(i, similarity) < count) | (_rank(j, similarity) < count)


def with_support(i: Array, j: Array, travel_m: Array) -> Array:
    """(k,) bool: closures with others nearby at both ends. Distances carry too little for a pairwise consistency
    test."""
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
    """Radio closures of one cue after similarity threshold, non-maximum suppression and limit per place.

    similarity: (n, n); travel_m: (n,) path length. A closure is a pair of places with the distance [m] that `model`
    expects at this similarity, and its standard deviation.
    """
    i, j = similar_pairs(similarity, travel_m, similarity_min, apart_m)
    s = similarity[i, j]
    kept = strongest_per_cell(i, j, s, travel_m, cell_m)
    i, j, s = i[kept], j[kept], s[kept]
    kept = strongest_per_place(i, j, s, per_place)
    i, j, s = i[kept], j[kept], s[kept]
    return Distances(np.column_stack([i, j]), *model.distance(s))


def _first_of_each(key: Array, score: Array) -> Array:
    """Index of the highest score per key, ordered by key."""
    order = np.lexsort((-score, key))
    sorted_key = key[order]
    is_first = np.concatenate([[True], sorted_key[1:] != sorted_key[:-1]]) if len(key) else np.zeros(0, bool)
    return order[is_first]


def _rank(key: Array, score: Array) -> Array:
    """(k,) number of entries with the same key and a higher score."""
    order = np.lexsort((-score, key))
    position = np.arange(len(key))
    starts = np.zeros(len(key), np.int64)
    sorted_key = key[order]
    new = np.flatnonzero(sorted_key[1:] != sorted_key[:-1]) + 1
    starts[new] = new
    rank = np.empty(len(key), np.int64)
    rank[order] = position - np.maximum.accumulate(starts)
    return rank
