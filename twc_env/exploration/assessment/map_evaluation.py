"""Repeated evaluation of maps: alignment with the building, wrongly merged pairs, correctly mapped area.

Which cells of a map lie on the building's floor is cached as a mask while the map's (rounded) alignment stays the same.
With the mask the area is counted over the cells of the map, instead of sampling the map at each cell of the floor, and
only in blocks of cells that scans have modified since the last evaluation. For a map that has not moved, one compiled
call does all of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray as Array

from twc_env import metrics
from twc_env.kernels.compiled import Lent, borrowing_kernel, bound, kernel, parts_of
from twc_env.metrics.mapping import recount_free
from twc_env.metrics.merging import WRONG_M, WRONG_RAD, find_frames, find_wrong
from twc_env.metrics.trajectory import align
from twc_env.records.messages import GridMap
from twc_env.world.building.floor_cells import Cells

PLACE_M, TURN_RAD = 0.02, 0.001
"""Resolution to which a map's alignment is rounded, so that its mask stays valid for longer."""
KEYFRAMES_MAX = 4000
"""If a mapper has more keyframes than this, `MapEvaluators` uses every second one, with twice as many every third, and
so on, which bounds its run time and memory."""
NOT_KNOWN = -1.0
"""Instead of the number of wrong pairs: there are no keyframes. Instead of the number of cells: the map has moved."""

Nodes = tuple[Array, Array, Array, Array]
"""As `TeamMapper.nodes`."""
Pairs = tuple[tuple[int, int], ...]


MapEvaluation = tuple[list[float], Pairs, float]
"""Evaluation of a map: x, y, heading of its rigid alignment with the building; pairs of its robots whose relative frame
is wrong by more than 1 m or 10 degrees; correctly mapped area [m2]."""


def lay(robots: tuple[int, ...], nodes: Nodes, true_poses: Array, stride: int = 1) -> tuple[Array, Pairs] | None:
    """Rigid alignment (3,) of a group's map with the building, and its wrongly merged pairs; None without keyframes.

    nodes: of the mapper that holds the map; true_poses (steps + 1, robots, 3). Every `stride`-th keyframe of each robot
    is used. Memory: about 100 bytes per keyframe used, until it returns.
    """
    if not len(nodes[0]):
        return None
    pose, room = np.empty(3), _room_for(len(nodes[0]) // stride, len(robots))
    if _lay_paths(_numbers(robots), *nodes, true_poses, stride, room, pose) == NOT_KNOWN:
        return None
    return pose, tuple((robots[i], robots[j]) for i, j in np.argwhere(room[-1]).tolist())


@lru_cache(maxsize=64)
def _numbers(robots: tuple[int, ...]) -> Array:
    return np.array(robots)


def _room_for(nodes: int, robots: int) -> tuple[Array, ...]:
    """Scratch arrays of `_lay_paths`: estimated and true poses, cosine and sine of their heading differences, robot of
    each; frames of the robots; per node the latest heading difference with cosine and sine; which pairs are wrong.

    For so many nodes, and one more of each robot: every s-th keyframe of each path is at most so many of all paths.
    """
    nodes += robots
    return (
        np.empty((nodes, 3)), np.empty((nodes, 3)), np.empty((nodes, 2)), np.empty(nodes, np.int64),
        np.empty((robots, 3)), np.full((nodes, 3), math.nan), np.zeros((robots, robots), bool),
    )  # fmt: skip


@borrowing_kernel
def _collect(robots, poses, step_of_node, paths, lengths, truth, stride, estimated, true, turns, owner, latest):
    """Collect estimated and true poses of some robots' keyframes, ordered by robot; returns count and mean position.

    Of each robot, every `stride`-th keyframe from the first on. paths, lengths: nodes of each robot and their number;
    truth (steps, robots, 3); poses, estimated, true (nodes, 3); turns (nodes, 2): cosine and sine as of
    `turns_between`; owner (nodes,): index into `robots`; latest (rows, 3): cache of each node's heading difference
    with cosine and sine; nodes share a row if there are more of them than rows.
    """
    count, x, y, rows = 0, 0.0, 0.0, latest.shape[0]
    for a in range(robots.shape[0]):
        robot = robots[a]
        for number in range(0, lengths[robot], stride):
            k = paths[robot, number]
            step = step_of_node[k]
            for axis in range(3):
                estimated[count, axis], true[count, axis] = poses[k, axis], truth[step, robot, axis]
            turned = true[count, 2] - estimated[count, 2]
            row = k % rows
            if latest[row, 0] != turned:
                latest[row, 0], latest[row, 1], latest[row, 2] = turned, math.cos(turned), math.sin(turned)
            turns[count, 0], turns[count, 1] = latest[row, 1], latest[row, 2]
            owner[count] = a
            x += poses[k, 0]
            y += poses[k, 1]
            count += 1
    return count, x / max(count, 1), y / max(count, 1)


@borrowing_kernel
def _lay_paths(robots, poses, step_of_node, paths, lengths, truth, stride, room, pose):
    """`lay` with every `stride`-th keyframe: writes pose (3,), marks wrong pairs in the last scratch array, and returns
    their number, or `NOT_KNOWN` without keyframes."""
    estimated, true, turns, owner, frames, latest, is_wrong = room
    count, x, y = _collect(
        robots, poses, step_of_node, paths, lengths, truth, stride, estimated, true, turns, owner, latest
    )  # fmt: skip
    if count == 0:
        return NOT_KNOWN
    align(estimated[:count], true[:count], turns[:count], pose)
    if robots.shape[0] == 1:
        return 0.0
    own = frames[: robots.shape[0]]
    find_frames(estimated[:count], true[:count], turns[:count], owner[:count], own)
    return float(find_wrong(own, x, y, WRONG_M, WRONG_RAD, is_wrong))


@kernel
def _stride(nodes):
    """Of a mapper with this number of keyframes `MapEvaluators` uses every n-th one of each robot: n."""
    return 1 + nodes // (KEYFRAMES_MAX + 1)


@borrowing_kernel
def _evaluate(
    room, place, mask, known, counts, result, robots, poses, step_of_node, paths, lengths, truth, log_odds, touched
):  # fmt: skip
    """Write to result (5,): alignment of the map, number of wrong pairs, number of free cells on the floor.

    The last is `NOT_KNOWN` if the rounded alignment differs from place (3,), to which the mask belongs.
    """
    stride = _stride(poses.shape[0])
    result[3] = _lay_paths(robots, poses, step_of_node, paths, lengths, truth, stride, parts_of(room), result[:3])
    result[4] = NOT_KNOWN
    x, y, turn = np.rint(result[0] / PLACE_M), np.rint(result[1] / PLACE_M), np.rint(result[2] / TURN_RAD)
    if result[3] >= 0.0 and x == place[0] and y == place[1] and turn == place[2]:
        result[4] = recount_free(log_odds, mask, touched, known, counts)


class _Held:
    """Mask and counts of a map at one place."""

    def __init__(self, grid: GridMap, place: tuple[int, int, int], cells: Cells):
        """place: rounded alignment, in units of `PLACE_M` and `TURN_RAD`."""
        assert grid.touched is not None
        self.place = place
        rounded = np.array([place[0] * PLACE_M, place[1] * PLACE_M, place[2] * TURN_RAD])
        self.mask = metrics.floor_mask(
            grid.log_odds.shape, grid.origin_m, grid.resolution_m, rounded, cells.free, cells.origin_m,
            cells.resolution_m,
        )  # fmt: skip
        """(rows, columns) bool: cells of the map that lie on the building's floor."""
        self.known, self.counts = np.full(grid.touched.shape, -1), np.zeros(grid.touched.shape, np.int64)
        """(blocks, blocks) `GridMap.touched` at each block's last count, -1: never; its free cells on the floor."""
        self.arguments = np.array(place, float), self.mask, self.known, self.counts
        """Arguments of `_evaluate`."""


class MapEvaluators:
    """Evaluates maps, with a cache per map. The cache can be computed from the maps, so copies start with none.

    Memory: of each map that is in use the two latest places, with a mask of a byte per cell; and 100 bytes for each of
    at most `KEYFRAMES_MAX` keyframes, and one more of each robot.
    """

    def __init__(self) -> None:
        self._held: WeakKeyDictionary[GridMap, tuple[_Held, ...]] = WeakKeyDictionary()
        """The latest two places of each map, newest first: maps often alternate between two. One that has grown is a
        new GridMap."""
        self._room: tuple[Array, ...] = ()
        self._run: Callable[..., None] | None = None
        """`_evaluate` bound to the scratch arrays `_room`."""
        self._result = np.empty(5)

    def __reduce__(self):
        return MapEvaluators, ()

    def evaluate(
        self, robots: tuple[int, ...], nodes: Nodes, true_poses: Array, grid: GridMap, cells: Cells
    ) -> MapEvaluation | None:
        """Align the map of these robots with the building and measure its `correct_area_m2`; None without keyframes.

        nodes, true_poses: as in `lay`.
        """
        kept = self._held.get(grid)
        if kept:
            x, y, turn, wrong, count = self._evaluate_again(grid, kept[0], robots, nodes, true_poses)
            if wrong == 0.0:  # otherwise, which is rare, `lay` below names the pairs
                pose = [x, y, turn]
                if count == NOT_KNOWN:
                    return pose, (), self.correct_area_m2(grid, pose, cells)
                return pose, (), count * grid.resolution_m**2
        laid = lay(robots, nodes, true_poses, _stride(len(nodes[0])))
        if laid is None:
            return None
        pose = laid[0].tolist()
        return pose, laid[1], self.correct_area_m2(grid, pose, cells)

    def _evaluate_again(
        self, grid: GridMap, held: _Held, robots: tuple[int, ...], nodes: Nodes, true_poses: Array
    ) -> list[float]:
        """The result (5,) of `_evaluate` for a cached map."""
        robots_in_all = true_poses.shape[1]
        if not self._room or min(len(nodes[0]), KEYFRAMES_MAX) + robots_in_all > len(self._room[0]):
            self._room, self._run = _room_for(min(2 * len(nodes[0]), KEYFRAMES_MAX), robots_in_all), None
        now = (
            *held.arguments, self._result, _numbers(robots), *nodes, true_poses, grid.log_odds, grid.touched
        )  # fmt: skip
        if self._run is None:
            self._run = bound(_evaluate, Lent(self._room), *now)
        self._run(*now)
        said: list[float] = self._result.tolist()
        return said

    def correct_area_m2(self, grid: GridMap, pose_building_map: Sequence[float] | Array, cells: Cells) -> float:
        """`metrics.correct_area_m2` with the rounded alignment, counted over cells of the map instead of the floor."""
        x, y, turn = pose_building_map
        place = round(x / PLACE_M), round(y / PLACE_M), round(turn / TURN_RAD)
        kept = self._held.get(grid, ())
        for held in kept:
            if held.place == place:
                break
        else:
            held = _Held(grid, place, cells)
        if not kept or held is not kept[0]:  # newest first
            self._held[grid] = (held, *[other for other in kept[:2] if other is not held][:1])
        count: int = recount_free(grid.log_odds, held.mask, grid.touched, held.known, held.counts)
        return count * grid.resolution_m**2
