"""Which robots share a map, and the map of each such group, drawn from the scans that the mapper has."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig
from twc_env.geometry import compose
from twc_env.kernels import borrowing_kernel
from twc_env.messages import GridMap, Keyframe
from twc_env.slam.growing import ROOM, grown, only
from twc_env.slam.occupancy_grid import OccupancyGrid
from twc_env.slam.team_graph import TeamGraph

MOVED_M, MOVED_RAD = 0.04, 0.008
"""The map is drawn anew when a keyframe has moved by more than this from where it was drawn."""


@dataclass(slots=True, eq=False)
class Group:
    """Robots that share one map."""

    robots: tuple[int, ...]
    grid: OccupancyGrid
    version: int = 0
    """Grows when the map was drawn anew."""


@borrowing_kernel
def _have_moved(poses, drawn):
    """Whether any pose is so far from where it was drawn that the map shows it."""
    for k in range(drawn.shape[0]):
        if abs(poses[k, 0] - drawn[k, 0]) > MOVED_M or abs(poses[k, 1] - drawn[k, 1]) > MOVED_M:
            return True
        if abs((poses[k, 2] - drawn[k, 2] + math.pi) % (2 * math.pi) - math.pi) > MOVED_RAD:
            return True
    return False


class Side(NamedTuple):
    """What a part of a group has seen: a grid, the nodes (n,) drawn in it, and where they stood (n, 3)."""

    grid: OccupancyGrid
    nodes: Array
    poses: Array


class GroupMaps:
    """Groups of robots and their grids. `home`: the robot this runs on; None for the one mapper of all."""

    def __init__(self, config: EnvConfig, graph: TeamGraph, home: int | None, robot_count: int):
        self._resolution_m, self._lidar = config.slam.resolution_m, config.lidar
        self._graph, self._home, self._on_request = graph, home, config.link.scan_on_request
        self.groups = [Group((r,), self._new_grid()) for r in range(robot_count)]
        self.group_of = list(range(robot_count))
        """Which of `groups` each robot belongs to."""
        self.regroupings = 0
        """Grows whenever robots come to share a map or no longer do."""
        self.changes = 0
        """Grows with it, and whenever a map is drawn anew or its cells lie elsewhere, as they must to become more."""
        self._drawn = np.zeros((ROOM, 3))
        """Where each node stands in the map as drawn."""
        self._scan_here = np.zeros(ROOM, bool)
        """Which nodes' scans have come; the others may be drawn by their own robot only."""
        self._sides: dict[tuple[int, ...], Side] = {}
        """Robots of a part of a group -> what they have seen."""
        self._settled: dict[tuple[int, ...], Side] = {}
        """Robots of a group -> what its keyframes show that were held in place when its map was drawn last."""
        self.wanted: dict[tuple[int, int], None] = {}
        """Scans to ask for, in order."""

    def add(self, keyframe: Keyframe, node: int) -> None:
        """A new keyframe: draw its scan, or ask for it where some robot would see it."""
        if node == len(self._drawn):
            self._drawn, self._scan_here = grown(self._drawn), grown(self._scan_here)
        self._scan_here[node] = not self._on_request or keyframe.robot == self._home
        self._drawn[node] = poses = self._graph.poses[node : node + 1]
        group = self.group_of[keyframe.robot]
        if self._scan_here[node] or self._draws_all(group):
            self._draw(self.groups[group].grid, poses, keyframe.ranges_m[None])
        elif self._is_seen(group):
            self.wanted[keyframe.key] = None

    def receive(self, scans: Sequence[tuple[int, int]]) -> None:
        """Scans that were asked for have come."""
        for key in scans:
            self.wanted.pop(key, None)
            node, group = self._graph.node(key), self.group_of[key[0]]
            is_drawn = self._scan_here[node] or self._draws_all(group)
            self._scan_here[node] = True
            if not is_drawn:
                self._draw(self.groups[group].grid, *self._graph.rows_of(slice(node, node + 1)))

    def ask_for(self, keys: Collection[tuple[int, int]]) -> bool:
        """Want those scans of these keyframes that are not here; whether there are any."""
        if not self._on_request:
            return False
        missing = [key for key in keys if not self._scan_here[self._graph.node(key)]]
        self.wanted.update(dict.fromkeys(missing))
        return len(missing) > 0

    def known_grid(self, robots: Sequence[int], group: int) -> GridMap:
        """What some robots of a group have seen, as far as this mapper may know it, in the group's frame."""
        if not self._on_request and len(robots) == len(self.groups[group].robots):
            return self.groups[group].grid.snapshot()
        nodes = self._graph.nodes_of(robots)
        return self._drawn_in(self._sides, tuple(robots), nodes[self._scan_here[nodes]]).grid.snapshot()

    def _drawn_in(self, sides: dict[tuple[int, ...], Side], robots: tuple[int, ...], nodes: Array) -> Side:
        """What these nodes of some robots show: drawn on where they stand as they did, otherwise anew."""
        poses, side = self._graph.poses[nodes], sides.get(robots)
        count = 0 if side is None else len(side.nodes)
        if side is None or not np.array_equal(side.nodes, nodes[:count]) or _have_moved(poses[:count], side.poses):
            side, count = Side(self._new_grid(), nodes[:0], poses[:0]), 0
        self._draw(side.grid, *self._graph.rows_of(nodes[count:]))
        sides[robots] = side = Side(side.grid, nodes, np.concatenate([side.poses, poses[count:]]))
        return side

    def merge(self, a: int, b: int, pose_a_b: Array) -> None:
        """Carry group b into the map of group a; b's number goes to the group after it."""
        into, other = self.groups[a], self.groups[b]
        moved = self._graph.nodes_of(other.robots)
        self._graph.place(moved, compose(pose_a_b, self._graph.poses[moved]))
        robots = tuple(sorted(into.robots + other.robots))
        self.groups[a] = Group(robots, into.grid, into.version + other.version + 1)
        del self.groups[b]
        self._renumber()
        merged = self.group_of[robots[0]]
        if self._is_seen(merged):
            self.ask_for([(robot, k.index) for robot in robots for k in self._graph.keyframes[robot]])
        if self._on_request:
            self.redraw(merged)
        else:
            self._redraw(merged, moved)

    def split(self, group: int, parts: Sequence[Sequence[int]]) -> None:
        """Take a group apart; each part keeps the frame it was in, the first part the group's number."""
        version = self.groups[group].version
        made = [Group(tuple(sorted(part)), self._new_grid(), version) for part in parts]
        self.groups[group] = made[0]
        self.groups += made[1:]
        self._renumber()
        for one in made:
            self.redraw(self.group_of[one.robots[0]])

    def forget(self, kept: Array) -> None:
        """Of all nodes only some are left (k,), in this order."""
        self._drawn, self._scan_here = only(self._drawn, kept), only(self._scan_here, kept)
        self._forget_parts()

    def _forget_parts(self) -> None:
        """Let go of what parts of groups have seen; it is drawn anew when it is asked for."""
        self._sides.clear()
        self._settled.clear()

    def _renumber(self) -> None:
        self._forget_parts()
        self.regroupings += 1
        self.changes += 1
        for index, group in enumerate(self.groups):
            for robot in group.robots:
                self.group_of[robot] = index

    def redraw_if_moved(self, group: int, first: int = 0) -> None:
        """Draw the map anew where keyframes have moved enough to show; nodes before `first` were held in place."""
        nodes = self._graph.nodes_of(self.groups[group].robots)
        if _have_moved(self._graph.poses[nodes], self._drawn[nodes]):
            self.redraw(group, first)

    def redraw(self, group: int, first: int = 0) -> None:
        """Draw a group's map anew, from where its keyframes stand now; those before `first`, which do not move, once.

        How long it takes does not grow with these.
        """
        nodes, robots = self._graph.nodes_of(self.groups[group].robots), self.groups[group].robots
        settled = int(np.searchsorted(nodes, first))
        if settled == 0:
            self._settled.pop(robots, None)
            self.groups[group].grid.clear()
            self._redraw(group, nodes)
            return
        held = self._drawn_in(self._settled, robots, self._drawable(group, nodes[:settled]))
        self._drawn[nodes[:settled]] = self._graph.poses[nodes[:settled]]
        self._drawn[held.nodes] = held.poses
        self.groups[group].grid.take_over(held.grid)
        self._redraw(group, nodes[settled:])

    def _redraw(self, group: int, nodes: Array) -> None:
        self._drawn[nodes] = self._graph.poses[nodes]
        self._draw(self.groups[group].grid, *self._graph.rows_of(self._drawable(group, nodes)))
        self.groups[group].version += 1
        self.changes += 1

    def _drawable(self, group: int, nodes: Array) -> Array:
        """Those of some nodes of a group whose scans may be drawn."""
        return nodes if self._draws_all(group) else nodes[self._scan_here[nodes]]

    def _draw(self, grid: OccupancyGrid, poses: Array, scans: Array) -> None:
        cells = grid.log_odds
        grid.integrate(poses, scans)
        self.changes += grid.log_odds is not cells

    def _new_grid(self) -> OccupancyGrid:
        return OccupancyGrid(self._resolution_m, self._lidar.range_max_m, self._lidar.beam_count)

    def _draws_all(self, group: int) -> bool:
        """Whether all scans may be drawn: a robot that is alone in its map draws its own where they are."""
        return self._home is None and len(self.groups[group].robots) == 1

    def _is_seen(self, group: int) -> bool:
        """Whether some robot sees the map that this mapper draws of a group of several."""
        robots = self.groups[group].robots
        return len(robots) > 1 and (self._home is None or self._home in robots)
