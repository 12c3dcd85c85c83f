"""Schedules the optimisation of the groups' pose graphs and chooses which keyframes of a large map may move."""

from __future__ import annotations

import math
from bisect import bisect_left

import numpy as np

from twc_env.config import PoseGraphConfig
from twc_env.records.class_file import is_in_file
from twc_env.slam.mapping.group_maps import GroupMaps
from twc_env.slam.mapping.keyframe_sparsification import KeyframeSparsification
from twc_env.slam.mapping.team_graph import TeamGraph
from twc_env.slam.merging.merge_tests import MergeTests
from twc_env.slam.pose_graph import robust_back_end as robust_backend
from twc_env.slam.pose_graph.fixed_keyframes import FixedKeyframes
from twc_env.slam.pose_graph.user_back_end import OwnBackEnd
from twc_env.slam.radio.radio_constraints import RadioConstraints

PATIENCE_PERIODS = 16
"""A group with only non-urgent new closures is optimised after this many periods."""
REFUSED_MIN = 3
"""All closures of a map are re-evaluated at this many rejections, and again each time that number grows by half."""


class MapOptimiser:
    """Optimises the subgraph of each group and redraws its map where poses changed."""

    def __init__(
        self, config: PoseGraphConfig, graph: TeamGraph, maps: GroupMaps, tests: MergeTests,
        radio: RadioConstraints | None, sparsification: KeyframeSparsification | None,
    ):  # fmt: skip
        """radio: radio constraints on whole paths; sparsification: of large maps. None where not used.

        Raises ConfigError if the config names a custom back end that does not exist.
        """
        if is_in_file(config.robust):
            OwnBackEnd(config)
        self._config, self._graph, self._maps, self._tests = config, graph, maps, tests
        self._radio, self._sparsification = radio, sparsification
        self._may_hold_poses = radio is None and config.robust == "ours"
        self.fixed_keyframes = FixedKeyframes()
        """Which keyframes of large maps are held fixed, and from what size on a map is large."""
        self._unsparsified: dict[tuple[int, ...], int] = {}
        """Robots of large maps that are to be sparsified -> the first node that must be kept."""
        self._refused_before: dict[tuple[int, ...], int] = {}
        """Robots of a group -> number of rejected closures when all were last re-evaluated."""
        self._dirty: set[int] = set()
        """Groups with closures added since the last optimisation, each by its first robot."""
        self._last_step = 0
        self.due_step = math.inf
        """First step at which dirty groups are optimised; later if none of their closures is urgent."""

    def mark_dirty(self, group: int, is_urgent: bool) -> None:
        """Mark a group as dirty: a closure was added. It is urgent if the estimate does not satisfy it yet."""
        self._dirty.add(self._maps.groups[group].robots[0])
        periods = 1 if is_urgent else PATIENCE_PERIODS
        self.due_step = min(self.due_step, self._last_step + periods * self._config.period_steps)

    @property
    def is_map_large(self) -> bool:
        """Whether enough keyframes have arrived that expensive work is spread over steps."""
        return self.fixed_keyframes.is_large(self._graph.arrived_count)

    def optimise_dirty(self, step: int) -> None:
        """Optimise all dirty groups."""
        self._last_step = step
        for group in sorted({self._maps.group_of[robot] for robot in self._dirty}):
            self.optimise(group)
        self._clear_dirty()

    def finish(self) -> None:
        """Optimise all groups thoroughly (end of an episode or log)."""
        for group in range(len(self._maps.groups)):
            self.optimise(group, is_thorough=True)
        self._clear_dirty()

    def _clear_dirty(self) -> None:
        """Clear the dirty flags after all groups were optimised."""
        self._dirty.clear()
        self.due_step = math.inf

    def reset_fixed(self) -> None:
        """Robots started or stopped sharing a map: no keyframe is held fixed."""
        self.fixed_keyframes.reset()
        self._unsparsified.clear()

    def optimise(self, group: int, is_thorough: bool = False) -> None:
        """Optimise a group's map; of a large map only the part that may move, unless `is_thorough`."""
        robots, count, arrived = self._maps.groups[group].robots, self._graph.node_count, self._graph.arrived_count
        may_hold = self._may_hold_poses and not is_thorough
        first = self.fixed_keyframes.first_movable(robots, count, arrived) if may_hold else 0
        if first > 0 and self._optimise_latest(group, first):
            self.fixed_keyframes.record_optimised(robots, count, is_whole=False)
            return
        self._optimise_whole(group, is_thorough, is_last=is_thorough)
        self.fixed_keyframes.record_optimised(robots, count, is_whole=True)
        end = self.fixed_keyframes.sparsification_end(robots, count, arrived)
        if self._sparsification is not None and not is_thorough and end > 0:
            self._unsparsified[robots] = end

    @property
    def may_remove(self) -> bool:
        """Whether a large map was optimised as a whole and not sparsified since."""
        return len(self._unsparsified) > 0

    def sparsify(self) -> None:
        """Sparsify one such map. Done in a separate step, because optimising and sparsifying both take long."""
        if self._sparsification is None or not self._unsparsified:
            return
        robots, end = self._unsparsified.popitem()
        kept = self._sparsification.sparsify(robots, end)
        self._unsparsified = {others: int(np.searchsorted(kept, first)) for others, first in self._unsparsified.items()}
        self.fixed_keyframes.record_sparsified(robots, kept)

    def _optimise_latest(self, group: int, first: int) -> bool:
        """Optimise the nodes from `first` on, others held fixed; False if closures should be re-evaluated in the whole
        map."""
        robots = self._maps.groups[group].robots
        if self._is_refused_often(robots, self._graph.refused_count(robots)):
            return False
        nodes, _, graph, is_used = self._graph.subgraph(robots, first)
        held = np.arange(np.searchsorted(nodes, first))
        result = robust_backend.refit_closures(self._graph.poses[nodes], graph, is_used, self._config, held)
        if not np.array_equal(result.accepted, is_used):
            return False
        self._graph.place(nodes, result.poses)
        self._maps.redraw_if_moved(group, first)
        return True

    def _is_refused_often(self, robots: tuple[int, ...], refused: int) -> bool:
        return refused >= max(REFUSED_MIN, 1.5 * self._refused_before.get(robots, 0))

    def _optimise_whole(self, group: int, is_thorough: bool, is_last: bool) -> None:
        robots = self._maps.groups[group].robots
        nodes, edges, graph, is_used = self._graph.subgraph(robots)
        if len(nodes) < 2:
            return
        fixed = bisect_left(nodes, self._graph.anchor(robots))
        refused = int(np.count_nonzero(~is_used))
        is_thorough |= self._is_refused_often(robots, refused)
        result = robust_backend.revise(
            self._graph.poses[nodes], graph, is_used, self._config, fixed, is_thorough and refused > 0,
            lambda before, after: not self._tests.moves_robots_apart(
                (self._graph.closures_of(edges[before.accepted]), before.poses),
                (self._graph.closures_of(edges[after.accepted]), after.poses),
                nodes,
            ),
        )  # fmt: skip
        if is_thorough:
            self._refused_before[robots] = refused
        self._graph.mark(edges, result.accepted, {r.edge: r.reason for r in result.rejections})
        poses = result.poses
        if self._radio is not None:
            local = self._graph.places_among(robots, nodes)
            poses = self._radio.fit(robots, graph.of(result.accepted), poses, local, fixed, is_last)
        self._graph.place(nodes, poses)
        self._maps.redraw_if_moved(group)
