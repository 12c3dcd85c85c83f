"""Places on the floor of a plan, the ways between them, and what floor and which signs are in view from each."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import MergingConfig, SignsConfig
from twc_env.kernels.compiled import kernel
from twc_env.planning.covering_walk import WalkGraph
from twc_env.planning.terrain import FREE, Terrain

CELL = 4
"""Cells of the terrain along a cell of the floor; 8 x 8 of these are the bits of a word."""
BEAMS_MIN = 180
STRAIGHT, DIAGONAL = 5, 7
"""Lengths of steps between cells."""
READ_SHARE = 0.75
"""Signs are mostly read from within this share of the distance at which a camera still sees them."""
SQUARE_M = 2.5
"""Where there are no signs, the squares of this side take their part."""
_CAMERA, _MERGING = SignsConfig(), MergingConfig()


def place_graph(terrain: Terrain, start_m: Array, spacing_m: float) -> tuple[WalkGraph, Array]:
    """The graph of all floor that is connected to start_m (2,): about one place per square of side `spacing_m`; and
    (h, w) int32 the place to which each cell of the terrain belongs, -1 for none.

    Each cell belongs to the place that is nearest by its way, and places are neighbours whose cells touch, so that no
    door is missed: the ways are at most a few percent longer than the shortest ones.
    """
    stride = max(2, round(spacing_m / terrain.resolution_m))
    cells = _widest_cells(terrain.cost, stride)
    owner, length = np.full(terrain.cost.shape, -1, np.int32), np.full(terrain.cost.shape, 2**30, np.int32)
    _spread_from_all(terrain.cost, cells, owner, length)
    edges: dict[tuple[int, int], int] = {}
    for axis in (0, 1):
        low, high = (slice(None, -1), slice(None)), (slice(1, None), slice(None))
        a, b = (low, high) if axis == 0 else (low[::-1], high[::-1])
        touching = (owner[a] != owner[b]) & (owner[a] >= 0) & (owner[b] >= 0)
        ways = (length[a] + length[b] + STRAIGHT)[touching]
        first, second = owner[a][touching], owner[b][touching]
        for u, v, way in zip(np.minimum(first, second), np.maximum(first, second), ways, strict=True):
            edges[u, v] = min(edges.get((u, v), 2**30), int(way))
    pairs = np.array(list(edges), np.int32).reshape(-1, 2)
    ways_m = np.array(list(edges.values()), float) * terrain.resolution_m / STRAIGHT
    places_m = terrain.to_metres(cells + 0.5)
    row, column = np.clip(terrain.to_cells(start_m).astype(int), 0, np.array(owner.shape) - 1)
    first = int(owner[row, column])
    if first < 0:  # it lies in a closed cell
        first = int(np.argmin(np.hypot(*(places_m - start_m).T)))
    graph, kept = WalkGraph.reached(places_m, pairs, ways_m, first)
    number = np.full(len(cells) + 1, -1, np.int32)
    number[kept] = np.arange(len(kept))
    return graph, number[owner]


@dataclass(frozen=True, slots=True, eq=False)
class FloorViews:
    """Which parts of the floor, and which signs, are in view from each place of a graph."""

    terrain: Terrain
    graph: WalkGraph
    cells_m: Array
    """(cells, 2) centres of the cells of the floor."""
    bits: Array
    """(cells,) the bit of each: 64 times its word, plus its number there."""
    words: int
    seen_words: Array
    """(places, k) int32: words in which cells are in view from each place, -1 for none ..."""
    seen_bits: Array
    """... and these cells, uint64."""
    marks: Array
    """(places, k) uint64: the bits of the signs that can be read from each; without signs, that of its square."""
    signs: Array
    """(signs, 3) x, y and bit of each sign; those that count as one have the same bit."""
    owner: Array
    """(h, w) int32: the place to which each cell of the terrain belongs, -1 for none."""
    apart_m: float
    """Signs nearer to each other than this count as one."""
    sights: Array = field(init=False)
    """(places, places) bool: between which robots see each other, where there are no signs; else (0, 0)."""

    def __post_init__(self) -> None:
        places_m = self.graph.places_m if not len(self.signs) else np.empty((0, 2))
        cells = [int(np.argmin(np.hypot(*(self.cells_m - place).T))) for place in places_m]
        sights = np.array([self.is_seen(place)[cells] for place in range(len(places_m))], bool)
        sights = sights.reshape(len(places_m), len(places_m))
        object.__setattr__(self, "sights", sights | sights.T)

    @classmethod
    def of(
        cls,
        terrain: Terrain,
        start_m: Array,
        spacing_m: float,
        range_m: float,
        signs: Array,
        camera: SignsConfig = _CAMERA,
        apart_m: float = _MERGING.spread_min_m,
    ) -> FloorViews:
        """All views of a range [m] on a terrain without unknown floor, from the places of `place_graph`.

        signs (k, 3): x, y and facing [rad] of each; apart_m: `MergingConfig.spread_min_m`.
        """
        graph, owner = place_graph(terrain, start_m, spacing_m)
        is_floor = terrain.kind[CELL // 2 :: CELL, CELL // 2 :: CELL] == FREE
        rows, columns = np.nonzero(is_floor)
        across = -(-is_floor.shape[1] // 8)
        words = across * -(-is_floor.shape[0] // 8)
        bits = 64 * (rows // 8 * across + columns // 8) + rows % 8 * 8 + columns % 8
        places = np.ascontiguousarray(terrain.to_cells(graph.places_m), float)
        reach = range_m / terrain.resolution_m
        most = (math.ceil(2 * reach / (8 * CELL)) + 1) ** 2
        seen_words = np.full((len(places), most), -1, np.int32)
        seen_bits = np.zeros((len(places), most), np.uint64)
        beams = max(BEAMS_MIN, math.ceil(2 * math.pi * reach / CELL))
        _find_views(terrain.kind, is_floor, places, reach, beams, across, words, seen_words, seen_bits)
        numbers = _numbers_of(signs, apart_m)
        marks = _sign_marks(terrain, places, signs, numbers, camera) if len(signs) else _square_marks(graph.places_m)
        cells_m = terrain.to_metres(np.column_stack([rows, columns]) * CELL + CELL // 2 + 0.5)
        return cls(
            terrain,
            graph,
            cells_m,
            bits,
            words,
            seen_words,
            seen_bits,
            marks,
            np.column_stack([signs[:, :2], numbers]),
            owner,
            apart_m,
        )

    def place_at(self, point_m: Array) -> int:
        """The place to which a point (2,) belongs, else the nearest one."""
        row, column = np.clip(self.terrain.to_cells(point_m).astype(int), 0, np.array(self.owner.shape) - 1)
        place = int(self.owner[row, column])
        return place if place >= 0 else int(np.argmin(np.hypot(*(self.graph.places_m - point_m).T)))

    def read(self, points_m: Array) -> Array:
        """(k,) uint64 the bits of the signs at points_m (n, 2), which are estimates."""
        found = np.zeros(self.marks.shape[1], np.uint64)
        for point in points_m:
            away = np.hypot(*(self.signs[:, :2] - point).T)
            if away.min(initial=np.inf) < self.apart_m:
                bit = int(self.signs[np.argmin(away), 2])
                found[bit // 64] |= np.uint64(1 << bit % 64)
        return found

    def is_seen(self, place: int) -> Array:
        """(cells,) bool: which cells are in view from a place."""
        view = np.zeros(self.words, np.uint64)
        used = self.seen_words[place] >= 0
        view[self.seen_words[place, used]] = self.seen_bits[place, used]
        found: Array = (view[self.bits // 64] >> (self.bits % 64).astype(np.uint64)) & np.uint64(1) > 0
        return found

    def as_words(self, is_in: Array) -> Array:
        """(words,) uint64 of the cells for which is_in (cells,) holds."""
        found = np.zeros(self.words, np.uint64)
        bits = self.bits[is_in]
        np.bitwise_or.at(found, bits // 64, np.uint64(1) << (bits % 64).astype(np.uint64))
        return found


def _square_marks(places_m: Array) -> Array:
    """(places, k) uint64 the bit of the square in which each place lies."""
    _, numbers = np.unique(np.floor(places_m / SQUARE_M).astype(np.int64), axis=0, return_inverse=True)
    numbers = numbers.reshape(-1)
    marks = np.zeros((len(places_m), 1 + int(numbers.max()) // 64), np.uint64)
    marks[np.arange(len(places_m)), numbers // 64] = np.uint64(1) << (numbers % 64).astype(np.uint64)
    return marks


def _numbers_of(signs: Array, apart_m: float) -> Array:
    """(n,) the number of each of signs (n, 3), one for all that are nearer to each other than apart_m."""
    numbers = np.arange(len(signs))
    for k, sign in enumerate(signs):
        near = np.flatnonzero(np.hypot(*(signs[:k, :2] - sign[:2]).T) < apart_m)
        numbers[k] = numbers[near[0]] if len(near) else k
    return np.unique(numbers, return_inverse=True)[1].reshape(-1)


def _sign_marks(terrain: Terrain, places: Array, signs: Array, numbers: Array, camera: SignsConfig) -> Array:
    """(places, k) uint64 the bits `numbers` of the signs (n, 3: x, y, facing) that a camera can read from places (k, 2)
    [cells]."""
    marks = np.zeros((len(places), 1 + int(numbers.max()) // 64), np.uint64)
    ahead = np.column_stack([np.sin(signs[:, 2]), np.cos(signs[:, 2])])
    cells = np.column_stack([terrain.to_cells(signs[:, :2]), ahead])
    reach = READ_SHARE * camera.legible_m / terrain.resolution_m
    cosine = math.cos(camera.incidence_max_rad)
    _find_marks(terrain.kind, places, np.ascontiguousarray(cells), numbers, reach, cosine, marks)
    return marks


@kernel
def _find_marks(kind, places, signs, numbers, reach, cosine, marks):
    """Set the bits numbers (n,) of signs (n, 4: row, column and its normal) that are in view from places (k, 2), within
    `reach` cells and at most at the incidence angle with this cosine."""
    for k in range(signs.shape[0]):
        for i in range(places.shape[0]):
            dr, dc = places[i, 0] - signs[k, 0], places[i, 1] - signs[k, 1]
            away = math.hypot(dr, dc)
            if away > reach or dr * signs[k, 2] + dc * signs[k, 3] < cosine * away:
                continue
            is_clear, j = True, 2  # the wall itself is not in the way
            while is_clear and j < int(away):
                r, c = math.floor(signs[k, 0] + j * dr / away), math.floor(signs[k, 1] + j * dc / away)
                is_inside = 0 <= r < kind.shape[0] and 0 <= c < kind.shape[1]
                is_clear, j = is_inside and kind[r, c] == FREE, j + 1
            if is_clear:
                marks[i, numbers[k] // 64] |= np.uint64(1) << np.uint64(numbers[k] % 64)


@kernel
def _widest_cells(cost, stride):
    """(k, 2) one open cell per square of side `stride`: the one with the most room, the most central of those."""
    height, width = cost.shape
    found = np.empty(((height // stride + 1) * (width // stride + 1), 2), np.int64)
    count = 0
    for top in range(0, height, stride):
        for left in range(0, width, stride):
            best, least, nearest = -1, 2**30, 1e18
            for r in range(top, min(top + stride, height)):
                for c in range(left, min(left + stride, width)):
                    away = (r - top - 0.5 * stride) ** 2 + (c - left - 0.5 * stride) ** 2
                    if cost[r, c] > 0 and (cost[r, c] < least or (cost[r, c] == least and away < nearest)):
                        best, least, nearest = r * width + c, cost[r, c], away
            if best >= 0:
                found[count, 0], found[count, 1] = best // width, best % width
                count += 1
    return found[:count]


@kernel
def _spread_from_all(cost, cells, owner, length):
    """Fill owner and length (h, w) with the nearest of cells (k, 2) over open cells, and the length of the way to it.

    Dijkstra's algorithm with buckets; cost has a closed border.
    """
    width = cost.shape[1]
    flat, whose, far = cost.reshape(-1), owner.reshape(-1), length.reshape(-1)
    head = np.full(DIAGONAL + 1, -1, np.int64)
    entry, following = np.empty(8 * flat.shape[0], np.int64), np.empty(8 * flat.shape[0], np.int64)
    count = 0
    for k in range(cells.shape[0]):
        cell = cells[k, 0] * width + cells[k, 1]
        whose[cell], far[cell] = k, 0
        entry[count], following[count], head[0] = cell, head[0], count
        count += 1
    steps = np.array([1, -1, width, -width, width + 1, width - 1, -width + 1, -width - 1], np.int64)
    now, empty = 0, 0
    while empty <= DIAGONAL:
        bucket = now % (DIAGONAL + 1)
        if head[bucket] < 0:
            now, empty = now + 1, empty + 1
            continue
        empty = 0
        cell = entry[head[bucket]]
        head[bucket] = following[head[bucket]]
        if far[cell] != now:
            continue
        for k in range(8):
            neighbour = cell + steps[k]
            if flat[neighbour] == 0:
                continue
            if k >= 4:  # a diagonal step needs both adjacent cells open
                down = cell + (width if k < 6 else -width)
                if flat[down] == 0 or flat[neighbour - (down - cell)] == 0:
                    continue
            way = now + (STRAIGHT if k < 4 else DIAGONAL)
            if way < far[neighbour]:
                far[neighbour], whose[neighbour] = way, whose[cell]
                at = way % (DIAGONAL + 1)
                entry[count], following[count], head[at] = neighbour, head[at], count
                count += 1


@kernel
def _find_views(kind, is_floor, places, reach, beams, across, words, seen_words, seen_bits):
    """Fill seen_words, seen_bits (places, k) with the cells of the floor on rays that end at whatever is not free."""
    height, width = kind.shape
    view = np.zeros(words, np.uint64)
    for i in range(places.shape[0]):
        view[:] = 0
        for b in range(beams):
            angle = 2.0 * math.pi * b / beams
            dr, dc = math.sin(angle), math.cos(angle)
            for k in range(int(reach) + 1):
                r, c = math.floor(places[i, 0] + k * dr), math.floor(places[i, 1] + k * dc)
                if r < 0 or c < 0 or r >= height or c >= width or kind[r, c] != FREE:
                    break
                r, c = r // CELL, c // CELL
                if r < is_floor.shape[0] and c < is_floor.shape[1] and is_floor[r, c]:
                    view[r // 8 * across + c // 8] |= np.uint64(1) << np.uint64(r % 8 * 8 + c % 8)
        found = 0
        for w in range(words):
            if view[w] != 0 and found < seen_words.shape[1]:
                seen_words[i, found], seen_bits[i, found] = w, view[w]
                found += 1
