"""A pose graph without some of its nodes: odometry joined past them, closures handed to those that stay.

Exact marginalisation would tie all neighbours of a node to each other. Kept is what joins them along the path, as by
the trees of Kretzschmar and Stachniss (2012): odometry from one node that stays to the next, with the covariance of the
whole stretch, and of the closures of the stretch the best for nodes at its ends that have few. What is said again of
two nodes is put into one.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twc_env.geometry import between, compose, inverse
from twc_env.slam.graph_arrays import ODOMETRY
from twc_env.slam.twists import adjoint, turned

Array = NDArray

CLOSURES_MAX = 3
"""A node that has so many closures takes over no other."""
LOOSE_M = 1.0
"""A closure that is known no better than this where it is handed to says too little to be kept."""


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """Edges as `GraphArrays` has them."""

    ends: Array
    measured: Array
    information: Array
    closure: Array
    """(edges,) number of the closure, or `ODOMETRY`."""
    is_used: Array

    @property
    def parts(self) -> tuple[Array, Array, Array, Array, Array]:
        """Its arrays, in the order of `GraphArrays`."""
        return self.ends, self.measured, self.information, self.closure, self.is_used

    def of(self, kept: Array) -> Edges:
        """Some of the edges: (e,) bool or indices."""
        return Edges(*(part[kept] for part in self.parts))


@dataclass(frozen=True, slots=True, eq=False)
class _Way:
    """The motion along odometry from one node to a later one, and its covariance in the frame of the later one."""

    motion: Array
    covariance: Array

    def then(self, other: _Way) -> _Way:
        back = adjoint(inverse(other.motion))
        return _Way(compose(self.motion, other.motion), turned(back, self.covariance) + other.covariance)

    @property
    def reversed(self) -> _Way:
        return _Way(inverse(self.motion), turned(adjoint(self.motion), self.covariance))

    def also(self, other: _Way) -> _Way:
        """The mean of two ways between the same nodes, each as it is known."""
        says = np.linalg.inv(other.covariance)
        covariance = np.linalg.inv(np.linalg.inv(self.covariance) + says)
        return _Way(compose(self.motion, covariance @ says @ between(self.motion, other.motion)), covariance)

    @property
    def spread_m2(self) -> float:
        return float(self.covariance[0, 0] + self.covariance[1, 1])


_NOWHERE = _Way(np.zeros(3), np.zeros((3, 3)))


def thinned(edges: Edges, is_gone: Array) -> Edges:
    """The edges of the graph without the nodes that are gone (nodes,) bool.

    Each robot's first and last node must stay.
    """
    is_touched = is_gone[edges.ends].any(axis=1)
    is_odometry = edges.closure == ODOMETRY
    joined, ways = _joined(edges.of(is_touched & is_odometry), is_gone)
    is_tie = ~is_odometry & edges.is_used
    own, handed = _handed(edges.of(is_tie & ~is_touched), edges.of(is_tie & is_touched), is_gone, ways)
    kept = edges.of(~is_touched)
    is_own = is_tie[~is_touched]
    kept.measured[is_own], kept.information[is_own] = own.measured, own.information
    return Edges(*(np.concatenate(parts) for parts in zip(kept.parts, joined.parts, handed.parts, strict=True)))


def _joined(edges: Edges, is_gone: Array) -> tuple[Edges, dict[int, tuple[int, _Way]]]:
    """Odometry past the nodes that are gone, and of each of these the nearer end of its stretch and the way from it."""
    steps = dict(zip(edges.ends[:, 0].tolist(), range(len(edges.ends)), strict=True))
    covariances = np.linalg.inv(edges.information)
    ends: list[tuple[int, int]] = []
    whole: list[_Way] = []
    nearer: dict[int, tuple[int, _Way]] = {}
    for start in sorted(n for n in steps if not is_gone[n]):
        passed, node, way = list[tuple[int, _Way]](), start, _NOWHERE
        while node == start or is_gone[node]:
            step = steps[node]
            way = way.then(_Way(edges.measured[step], covariances[step]))
            node = int(edges.ends[step, 1])
            passed.append((node, way))
        ends.append((start, node))
        whole.append(way)
        for other, there in passed[:-1]:
            nearer[other] = start, there
        back = _NOWHERE
        for k in range(len(passed) - 2, -1, -1):
            other, there = passed[k]
            step = steps[other]
            back = _Way(edges.measured[step], covariances[step]).then(back)
            if back.spread_m2 < there.spread_m2:
                nearer[other] = node, back.reversed
    if not ends:
        return edges, nearer
    joined = Edges(
        np.array(ends, np.int64), np.array([way.motion for way in whole]),
        np.linalg.inv(np.array([way.covariance for way in whole])), np.full(len(ends), ODOMETRY, np.int64),
        np.ones(len(ends), bool),
    )  # fmt: skip
    return joined, nearer


def _handed(own: Edges, edges: Edges, is_gone: Array, ways: dict[int, tuple[int, _Way]]) -> tuple[Edges, Edges]:
    """Closures of nodes that stay, with what those of nodes that are gone say of them; and the best of these."""
    said: dict[tuple[int, int], tuple[int, _Way]] = {}
    counts: Counter[int] = Counter(own.ends.ravel().tolist())
    for k, (ends, motion, information) in enumerate(zip(own.ends.tolist(), own.measured, own.information, strict=True)):
        said[ends[0], ends[1]] = k, _Way(motion, np.linalg.inv(information))
    new: list[tuple[int, int]] = []
    numbers: list[int] = []
    for spread_m2, k, (i, j), way in sorted(_moved(edges, is_gone, ways), key=lambda entry: entry[:2]):
        if i == j or spread_m2 > LOOSE_M**2:
            continue
        if (j, i) in said:
            i, j, way = j, i, way.reversed
        if (i, j) in said:
            place, before = said[i, j]
            said[i, j] = place, before.also(way)
        elif min(counts[i], counts[j]) < CLOSURES_MAX:
            said[i, j] = len(own.ends) + len(new), way
            new.append((i, j))
            numbers.append(k)
            counts.update((i, j))
    for place, way in said.values():
        if place < len(own.ends):
            own.measured[place], own.information[place] = way.motion, np.linalg.inv(way.covariance)
    handed = edges.of(np.array(numbers, np.int64))
    for place, pair in enumerate(new):
        way = said[pair][1]
        handed.ends[place], handed.measured[place] = pair, way.motion
        handed.information[place] = np.linalg.inv(way.covariance)
    return own, handed


def _moved(
    edges: Edges, is_gone: Array, ways: dict[int, tuple[int, _Way]]
) -> list[tuple[float, int, tuple[int, int], _Way]]:
    """Closures with ends that are gone as ones of the nodes that stay: how loose, their places, ends and ways."""
    moved = []
    for k, ((i, j), motion, information) in enumerate(
        zip(edges.ends.tolist(), edges.measured, edges.information, strict=True)
    ):
        way = _Way(motion, np.linalg.inv(information))
        if is_gone[i]:
            i, to = ways[i]
            way = to.then(way)
        if is_gone[j]:
            j, to = ways[j]
            way = way.then(to.reversed)
        moved.append((way.spread_m2, k, (i, j), way))
    return moved
