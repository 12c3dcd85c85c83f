"""Judge maps time and again: where each lies in the building, whom it merges wrongly, how much of the floor it shows.

Which cells of a map lie on the building's floor is kept while the map lies where it lay. With that mask, measuring a
map is a comparison of two grids, cell by cell, instead of looking up every cell of the floor; and only of those blocks
of cells in which scans changed something since the last time. One compiled call does all of it for a map that has not
moved.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray as Array

from twc_env import metrics
from twc_env.kernels import Lent, borrowing_kernel, bound, parts_of
from twc_env.messages import GridMap
from twc_env.metrics.mapping import recount_free
from twc_env.metrics.merging import WRONG_M, WRONG_RAD, find_frames, find_wrong
from twc_env.metrics.trajectory import align
from twc_env.world.floor_cells import Cells

PLACE_M, TURN_RAD = 0.02, 0.001
"""A map's place in the building is rounded to these, so that its mask holds for long."""
JUDGED_MAX = 4000
"""Of more keyframes than so many only every second is looked at while an episode runs, of twice as many every third,
and so on, so that the time it takes does not grow with the way gone."""
NOT_KNOWN = -1.0
"""In place of a number: of wrong pairs, where there are no keyframes; of cells, where a map lies elsewhere."""

Nodes = tuple[Array, Array, Array, Array]
"""As `TeamMapper.nodes`."""
Pairs = tuple[tuple[int, int], ...]


Judgement = tuple[list[float], Pairs, float]
"""A map against the truth: x, y, heading of the one rigid alignment that lays it on the building; the pairs of its
robots whose relative frame is off by more than 1 m or 10 degrees; and how much floor it shows rightly [m2]."""


def lay(robots: tuple[int, ...], nodes: Nodes, true_poses: Array) -> tuple[Array, Pairs] | None:
    """The pose (3,) that lays a group's map on the building, and its wrongly merged pairs; None without keyframes.

    nodes: of the mapper that has the map; true_poses (steps + 1, robots, 3).
    """
    if not len(nodes[0]):
        return None
    pose, room = np.empty(3), _room_for(len(nodes[0]), len(robots))
    if _lay_paths(_numbers(robots), *nodes, true_poses, 1, room, pose) == NOT_KNOWN:
        return None
    return pose, tuple((robots[i], robots[j]) for i, j in np.argwhere(room[-1]).tolist())


@lru_cache(maxsize=64)
def _numbers(robots: tuple[int, ...]) -> Array:
    return np.array(robots)


def _room_for(nodes: int, robots: int) -> tuple[Array, ...]:
    """What `_lay_paths` works in: estimated and true poses, turns between these, whose they are, frames; of every node
    the turn that it had last, with its cosine and sine; and which pairs are wrong."""
    return (
        np.empty((nodes, 3)), np.empty((nodes, 3)), np.empty((nodes, 2)), np.empty(nodes, np.int64),
        np.empty((robots, 3)), np.full((nodes, 3), math.nan), np.zeros((robots, robots), bool),
    )  # fmt: skip


@borrowing_kernel
def _collect(robots, poses, step_of_node, paths, lengths, truth, stride, estimated, true, turns, owner, latest):
    """Estimated and true poses of some robots' keyframes, robot by robot, and whose they are; count and mean place.

    Of each robot the first, and every so manyth after it.

    paths and lengths: which nodes are a robot's, and how many; truth (steps, robots, 3); poses, estimated, true (nodes,
    3); turns (nodes, 2) as `turns_between` gives them; owner (nodes,): the robot's number among `robots`; latest
    (nodes, 3): a node's turn, cosine and sine, worked out anew only for a node that has turned.
    """
    count, x, y = 0, 0.0, 0.0
    for a in range(robots.shape[0]):
        robot = robots[a]
        for number in range(0, lengths[robot], stride):
            k = paths[robot, number]
            step = step_of_node[k]
            for axis in range(3):
                estimated[count, axis], true[count, axis] = poses[k, axis], truth[step, robot, axis]
            turned = true[count, 2] - estimated[count, 2]
            if latest[k, 0] != turned:
                latest[k, 0], latest[k, 1], latest[k, 2] = turned, math.cos(turned), math.sin(turned)
            turns[count, 0], turns[count, 1] = latest[k, 1], latest[k, 2]
            owner[count] = a
            x += poses[k, 0]
            y += poses[k, 1]
            count += 1
    return count, x / max(count, 1), y / max(count, 1)


@borrowing_kernel
def _lay_paths(robots, poses, step_of_node, paths, lengths, truth, stride, room, pose):
    """See `lay`, by every so manyth keyframe; marks wrong pairs in the last array of the room, gives their number."""
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


@borrowing_kernel
def _judge(
    room, place, mask, known, counts, result, robots, poses, step_of_node, paths, lengths, truth, log_odds, touched
):  # fmt: skip
    """Write to `result` (5,) how the map lies, how many pairs are wrong, and how many free cells lie on the floor.

    The last is `NOT_KNOWN` where the map does not lie at the place (3,) that the mask belongs to.
    """
    stride = 1 + poses.shape[0] // (JUDGED_MAX + 1)
    result[3] = _lay_paths(robots, poses, step_of_node, paths, lengths, truth, stride, parts_of(room), result[:3])
    result[4] = NOT_KNOWN
    x, y, turn = np.rint(result[0] / PLACE_M), np.rint(result[1] / PLACE_M), np.rint(result[2] / TURN_RAD)
    if result[3] >= 0.0 and x == place[0] and y == place[1] and turn == place[2]:
        result[4] = recount_free(log_odds, mask, touched, known, counts)


class _Held:
    """What is kept of a map while it lies at one place. A grid that has grown is another one."""

    def __init__(self, grid: GridMap, place: tuple[int, int, int], cells: Cells):
        """place: where it lies, in steps of `PLACE_M` and `TURN_RAD`."""
        assert grid.touched is not None
        self.grid, self.place = grid, place
        rounded = np.array([place[0] * PLACE_M, place[1] * PLACE_M, place[2] * TURN_RAD])
        self.mask = metrics.floor_mask(
            grid.log_odds.shape, grid.origin_m, grid.resolution_m, rounded, cells.free, cells.origin_m,
            cells.resolution_m,
        )  # fmt: skip
        """(rows, columns) bool: its cells that lie on the floor there."""
        self.known, self.counts = np.full(grid.touched.shape, -1), np.zeros(grid.touched.shape, np.int64)
        """(blocks, blocks) `GridMap.touched` when blocks were counted last, -1 for never; free cells on the floor."""
        self.arguments = np.array(place, float), self.mask, self.known, self.counts
        """For `_judge`."""


class MapJudges:
    """What is kept of each map that is judged again; it follows from the maps, so copies may begin without any."""

    def __init__(self) -> None:
        self._held: dict[int, tuple[_Held, ...]] = {}
        """Of each map the latest two: often it goes back and forth between two places."""
        self._room: tuple[Array, ...] = ()
        self._run: Callable[..., None] | None = None
        """`_judge` with that room."""
        self._result = np.empty(5)

    def __reduce__(self):
        return MapJudges, ()

    def judge(
        self, owner: int, robots: tuple[int, ...], nodes: Nodes, true_poses: Array, grid: GridMap, cells: Cells
    ) -> Judgement | None:
        """Lay a map of these robots on the building and measure it as `correct_area_m2`; None without keyframes.

        owner: whose map it is, of those of which something is kept; nodes, true_poses: as in `lay`.
        """
        kept = self._held.get(owner)
        if kept and kept[0].grid is grid:
            x, y, turn, wrong, count = self._judge_again(kept[0], robots, nodes, true_poses)
            if wrong == 0.0:  # who is merged wrongly, which is rare, is not told by numbers alone
                pose = [x, y, turn]
                if count == NOT_KNOWN:
                    return pose, (), self.correct_area_m2(owner, grid, pose, cells)
                return pose, (), count * grid.resolution_m**2
        laid = lay(robots, nodes, true_poses)
        if laid is None:
            return None
        pose = laid[0].tolist()
        return pose, laid[1], self.correct_area_m2(owner, grid, pose, cells)

    def _judge_again(self, held: _Held, robots: tuple[int, ...], nodes: Nodes, true_poses: Array) -> list[float]:
        """What `_judge` says of a map that is kept."""
        if not self._room or len(nodes[0]) > len(self._room[0]):
            self._room, self._run = _room_for(2 * len(nodes[0]), true_poses.shape[1]), None
        now = (
            *held.arguments, self._result, _numbers(robots), *nodes, true_poses, held.grid.log_odds, held.grid.touched
        )  # fmt: skip
        if self._run is None:
            self._run = bound(_judge, Lent(self._room), *now)
        self._run(*now)
        said: list[float] = self._result.tolist()
        return said

    def correct_area_m2(
        self, owner: int, grid: GridMap, pose_building_map: Sequence[float] | Array, cells: Cells
    ) -> float:
        """`metrics.correct_area_m2` with a rounded pose, counting cells of the map instead of the floor."""
        x, y, turn = pose_building_map
        place = round(x / PLACE_M), round(y / PLACE_M), round(turn / TURN_RAD)
        kept = self._held.get(owner, ())
        for held in kept:
            if held.place == place and held.grid is grid:
                break
        else:
            held = _Held(grid, place, cells)
        if not kept or held is not kept[0]:  # the latest first
            self._held[owner] = (held, *[other for other in kept[:2] if other is not held][:1])
        count: int = recount_free(grid.log_odds, held.mask, grid.touched, held.known, held.counts)
        return count * grid.resolution_m**2
