"""Groups of robots that share a map, and the occupancy grid of each group, drawn from the scans the mapper has."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig
from twc_env.kernels.compiled import borrowing_kernel
from twc_env.records.geometry import compose
from twc_env.records.growing_arrays import ROOM, grown, only
from twc_env.records.messages import GridMap, Keyframe
from twc_env.slam.mapping.team_graph import TeamGraph
from twc_env.slam.scans.occupancy_grid import OccupancyGrid, resampled

MOVED_M, MOVED_RAD = 0.04, 0.008
"""The map is redrawn when a keyframe has moved by more than this since it was drawn."""
SIDES_MAX = 6
"""Sides of merges whose grids are kept, those used last: in a team of eight there are ten, of a megabyte or two each.
With four, eight robots draw a tenth more keyframes again."""


@dataclass(slots=True, eq=False)
class Group:
    """Robots that share one map."""

    robots: tuple[int, ...]
    grid: OccupancyGrid
    version: int = 0
    """Incremented when the map is redrawn."""


@borrowing_kernel
def _have_moved(poses, drawn):
    """Whether any pose differs from where it was drawn by more than `MOVED_M` or `MOVED_RAD`."""
    for k in range(drawn.shape[0]):
        if abs(poses[k, 0] - drawn[k, 0]) > MOVED_M or abs(poses[k, 1] - drawn[k, 1]) > MOVED_M:
            return True
        if abs((poses[k, 2] - drawn[k, 2] + math.pi) % (2 * math.pi) - math.pi) > MOVED_RAD:
            return True
    return False


class PartialMap(NamedTuple):
    """Cached grid of some nodes of a group: grid, nodes (n,), and their poses (n, 3) when drawn."""

    grid: OccupancyGrid
    nodes: Array
    poses: Array


class GroupMaps:
    """Groups of robots and their grids. `home`: the robot this mapper runs on; None for the central mapper."""

    def __init__(self, config: EnvConfig, graph: TeamGraph, home: int | None, robot_count: int):
        self._resolution_m, self._lidar = config.slam.resolution_m, config.lidar
        self._graph, self._home, self._on_request = graph, home, config.link.scan_on_request
        self.groups = [Group((r,), self._new_grid()) for r in range(robot_count)]
        self.group_of = list(range(robot_count))
        """Index in `groups` of each robot's group."""
        self.regroupings = 0
        """Incremented at each merge and split."""
        self.changes = 0
        """Incremented with it, when a map is redrawn and when a grid is reallocated."""
        self._drawn = np.zeros((ROOM, 3))
        """(nodes, 3) pose at which each node is drawn."""
        self._has_scan = np.zeros(ROOM, bool)
        """(nodes,) whether the scan has been received; others may only be drawn for their own robot."""
        self._partial_maps: dict[tuple[int, ...], PartialMap] = {}
        """Robots of one side of a merge -> grid of their nodes, the one used last at the end."""
        self._fixed_maps: dict[tuple[int, ...], PartialMap] = {}
        """Robots of a group -> grid of the nodes that were fixed at its last redraw."""
        self._prior_grid: OccupancyGrid | None = None
        """Grid of a map of an earlier session, whose nodes are the first and are never drawn again."""
        self.wanted: dict[tuple[int, int], None] = {}
        """Keys of the scans to request, in order."""

    def add_robot(self) -> None:
        """One more robot begins a map of its own."""
        self.group_of.append(len(self.groups))
        self.groups.append(Group((len(self.group_of) - 1,), self._new_grid()))
        self.regroupings += 1
        self.changes += 1

    def add(self, keyframe: Keyframe, node: int, is_drawn: bool = True) -> None:
        """Draw the scan of a new keyframe; request it if it is missing and a robot uses the map."""
        if node == len(self._drawn):
            self._drawn, self._has_scan = grown(self._drawn), grown(self._has_scan)
        self._has_scan[node] = not self._on_request or keyframe.robot == self._home
        self._drawn[node] = poses = self._graph.poses[node : node + 1]
        group = self.group_of[keyframe.robot]
        if not is_drawn:
            return
        if self._has_scan[node] or self._may_draw_all(group):
            self._draw(self.groups[group].grid, poses, keyframe.ranges_m[None])
        elif self._is_map_used(group):
            self.wanted[keyframe.key] = None

    def add_prior(self, robot: int, grid: GridMap) -> None:
        """The keyframes of this robot are those of a map of an earlier session with this grid."""
        nodes, (poses, scans) = self._graph.path_of(robot), self._graph.rows_of(self._graph.path_of(robot))
        while len(nodes) > len(self._drawn):
            self._drawn, self._has_scan = grown(self._drawn), grown(self._has_scan)
        self._drawn[nodes], self._has_scan[nodes] = poses, True
        own = self.groups[self.group_of[robot]].grid
        if grid.resolution_m == self._resolution_m:
            own.begin_with(grid)
        elif len(nodes):
            own.integrate(poses, scans)
            own.begin_with(own.snapshot())
        else:
            own.begin_with(resampled(grid, self._resolution_m))
        self._prior_grid = self._new_grid()
        self._prior_grid.take_over(own)

    def join_prior(self, prior: int, group: int, pose_prior_group: Array) -> None:
        """Move a group into the map of an earlier session, which stays as it was."""
        robot = self.groups[prior].robots[0]
        self.merge(prior, group, pose_prior_group)
        assert self._prior_grid is not None
        self.groups[self.group_of[robot]].grid.take_over(self._prior_grid)

    def _begun(self, grid: OccupancyGrid, nodes: Array) -> int:
        """Begin a grid of these nodes (k,) of a group anew; returns how many of them it shows: a prior map's, or 0."""
        if self._prior_grid is None or not len(nodes) or nodes[0] > 0:
            grid.clear()
            return 0
        grid.take_over(self._prior_grid)
        return len(self._graph.path_of(self._graph.robot_of_node[0]))

    def receive(self, scans: Sequence[tuple[int, int]]) -> None:
        """Draw requested scans that have arrived."""
        for key in scans:
            self.wanted.pop(key, None)
            node, group = self._graph.node(key), self.group_of[key[0]]
            is_drawn = self._has_scan[node] or self._may_draw_all(group)
            self._has_scan[node] = True
            if not is_drawn:
                self._draw(self.groups[group].grid, *self._graph.rows_of(slice(node, node + 1)))

    def ask_for(self, keys: Collection[tuple[int, int]]) -> bool:
        """Request the missing scans of these keyframes; whether any is missing."""
        if not self._on_request:
            return False
        missing = [key for key in keys if not self._has_scan[self._graph.node(key)]]
        self.wanted.update(dict.fromkeys(missing))
        return len(missing) > 0

    def have_scans(self, nodes: Array) -> Array:
        """(k,) bool: for each of these nodes whether this mapper has its scan."""
        return self._has_scan[nodes]

    def known_grid(self, robots: Sequence[int], group: int) -> GridMap:
        """Map of the received scans of some robots of a group, in the group's map frame."""
        if not self._on_request and len(robots) == len(self.groups[group].robots):
            return self.groups[group].grid.snapshot()
        nodes, kept = self._graph.nodes_of(robots), self._partial_maps
        partial = self._drawn_in(kept, tuple(robots), nodes[self._has_scan[nodes]])
        if len(kept) > SIDES_MAX:
            del kept[next(iter(kept))]
        return partial.grid.snapshot()

    def _drawn_in(self, cache: dict[tuple[int, ...], PartialMap], robots: tuple[int, ...], nodes: Array) -> PartialMap:
        """Cached grid of these nodes: extended by new nodes if the earlier ones have not moved, otherwise redrawn."""
        poses, partial = self._graph.poses[nodes], cache.get(robots)
        count = 0 if partial is None else len(partial.nodes)
        if (
            partial is None
            or not np.array_equal(partial.nodes, nodes[:count])
            or _have_moved(poses[:count], partial.poses)
        ):
            grid = self._new_grid(has_kinds=cache is self._fixed_maps)
            count = self._begun(grid, nodes)
            partial = PartialMap(grid, nodes[:count], poses[:count])
        self._draw(partial.grid, *self._graph.rows_of(nodes[count:]))
        cache.pop(robots, None)  # the one used last becomes the last
        cache[robots] = partial = PartialMap(partial.grid, nodes, np.concatenate([partial.poses, poses[count:]]))
        return partial

    def merge(self, a: int, b: int, pose_a_b: Array) -> None:
        """Move group b into the map of group a and remove it: later groups' indices decrease by one."""
        target, source = self.groups[a], self.groups[b]
        nodes = self._graph.nodes_of(source.robots)
        self._graph.place(nodes, compose(pose_a_b, self._graph.poses[nodes]))
        robots = tuple(sorted(target.robots + source.robots))
        self.groups[a] = Group(robots, target.grid, target.version + source.version + 1)
        del self.groups[b]
        self._renumber()
        merged = self.group_of[robots[0]]
        if self._is_map_used(merged):
            self.ask_for([(robot, k.index) for robot in robots for k in self._graph.keyframes[robot]])
        if self._on_request:
            self.redraw(merged)
        else:
            self._redraw(merged, nodes)

    def split(self, group: int, parts: Sequence[Sequence[int]]) -> None:
        """Split a group. All parts keep the group's map frame; the first keeps its index."""
        version = self.groups[group].version
        new_groups = [Group(tuple(sorted(part)), self._new_grid(), version) for part in parts]
        self.groups[group] = new_groups[0]
        self.groups += new_groups[1:]
        self._renumber()
        for new_group in new_groups:
            self.redraw(self.group_of[new_group.robots[0]])

    def sparsify(self, kept: Array) -> None:
        """Keep the data of these nodes only; kept (k,): their former indices."""
        self._drawn, self._has_scan = only(self._drawn, kept), only(self._has_scan, kept)
        self._clear_caches()

    def _clear_caches(self) -> None:
        """Clear the cached grids."""
        self._partial_maps.clear()
        self._fixed_maps.clear()

    def _renumber(self) -> None:
        self._clear_caches()
        self.regroupings += 1
        self.changes += 1
        for index, group in enumerate(self.groups):
            for robot in group.robots:
                self.group_of[robot] = index

    def redraw_if_moved(self, group: int, first: int = 0) -> None:
        """Redraw the map if a keyframe has moved by more than `MOVED_M` or `MOVED_RAD`; first: as in `redraw`."""
        nodes = self._graph.nodes_of(self.groups[group].robots)
        if _have_moved(self._graph.poses[nodes], self._drawn[nodes]):
            self.redraw(group, first)

    def redraw(self, group: int, first: int = 0) -> None:
        """Redraw a group's map at the current poses.

        Nodes before `first` are fixed: their grid is cached, so the time does not depend on their number.
        """
        nodes, robots = self._graph.nodes_of(self.groups[group].robots), self.groups[group].robots
        fixed = int(np.searchsorted(nodes, first))
        if fixed == 0:
            self._fixed_maps.pop(robots, None)
            self._redraw(group, nodes[self._begun(self.groups[group].grid, nodes) :])
            return
        fixed_map = self._drawn_in(self._fixed_maps, robots, self._drawable(group, nodes[:fixed]))
        self._drawn[nodes[:fixed]] = self._graph.poses[nodes[:fixed]]
        self._drawn[fixed_map.nodes] = fixed_map.poses
        self.groups[group].grid.take_over(fixed_map.grid)
        self._redraw(group, nodes[fixed:])

    def _redraw(self, group: int, nodes: Array) -> None:
        self._drawn[nodes] = self._graph.poses[nodes]
        self._draw(self.groups[group].grid, *self._graph.rows_of(self._drawable(group, nodes)))
        self.groups[group].version += 1
        self.changes += 1

    def _drawable(self, group: int, nodes: Array) -> Array:
        """Those nodes whose scans may be drawn."""
        return nodes if self._may_draw_all(group) else nodes[self._has_scan[nodes]]

    def _draw(self, grid: OccupancyGrid, poses: Array, scans: Array) -> None:
        cells = grid.log_odds
        grid.integrate(poses, scans)
        self.changes += grid.log_odds is not cells

    def _new_grid(self, has_kinds: bool = True) -> OccupancyGrid:
        return OccupancyGrid(self._resolution_m, self._lidar.range_max_m, self._lidar.circle_beam_count, has_kinds)

    @property
    def range_max_m(self) -> float:
        """Of the scanners."""
        return self._lidar.range_max_m

    def _may_draw_all(self, group: int) -> bool:
        """Whether missing scans may be drawn, too: a robot alone in its map draws them itself (central mapper)."""
        return self._home is None and len(self.groups[group].robots) == 1

    def _is_map_used(self, group: int) -> bool:
        """Whether a robot uses this mapper's map of a group of several robots; only asked with scans on request, where
        there are no segments."""
        robots = self.groups[group].robots
        return len(robots) > 1 and (self._home is None or self._home in robots)
