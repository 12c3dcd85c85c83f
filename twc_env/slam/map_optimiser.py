"""Optimising the maps of groups: when closures came, and as much of a map as may still move."""

from __future__ import annotations

import math
from bisect import bisect_left

import numpy as np

from twc_env.class_file import is_in_file
from twc_env.config import PoseGraphConfig
from twc_env.slam import robust_backend
from twc_env.slam.forgetting import Forgetting
from twc_env.slam.group_maps import GroupMaps
from twc_env.slam.merge_judge import MergeJudge
from twc_env.slam.own_back_end import OwnBackEnd
from twc_env.slam.radio_ties import RadioTies
from twc_env.slam.settled_maps import SettledMaps
from twc_env.slam.team_graph import TeamGraph

PATIENCE_PERIODS = 16
"""An optimisation for which nothing is urgent waits for so many others."""
REFUSED_MIN = 3
"""From so many refused closures on, and half as many again each time, all of a map are weighed anew."""


class MapOptimiser:
    """Optimises what one mapper's graph holds of each group, and draws its map anew where that shows."""

    def __init__(
        self, config: PoseGraphConfig, graph: TeamGraph, maps: GroupMaps, judge: MergeJudge, radio: RadioTies | None,
        forgetting: Forgetting | None,
    ):  # fmt: skip
        """radio: what radio says of the whole path; forgetting: for large maps. Both None where there is none.

        Raises ConfigError for a back end of one's own that there is not.
        """
        if is_in_file(config.robust):
            OwnBackEnd(config)
        self._config, self._graph, self._maps, self._judge = config, graph, maps, judge
        self._radio, self._forgetting = radio, forgetting
        self._may_hold_poses = radio is None and config.robust == "ours"
        self.settled_maps = SettledMaps()
        """What becomes of large maps, and from when on they are large."""
        self._unthinned: dict[tuple[int, ...], int] = {}
        """Robots of large maps that are to be thinned, and the first node there that must stay."""
        self._refused_heard: dict[tuple[int, ...], int] = {}
        """How many closures of a group were refused when all of them were last weighed anew."""
        self._soiled: set[int] = set()
        """Groups, by their first robot, with closures that came since the last optimisation."""
        self._last_step = 0
        self.due_step = math.inf
        """From when on the groups with new closures are optimised: the later, if none of these is urgent."""

    def soil(self, group: int, is_urgent: bool) -> None:
        """A closure came into a group's map; it is urgent where the estimate does not meet it."""
        self._soiled.add(self._maps.groups[group].robots[0])
        periods = 1 if is_urgent else PATIENCE_PERIODS
        self.due_step = min(self.due_step, self._last_step + periods * self._config.period_steps)

    @property
    def is_map_large(self) -> bool:
        """Whether so many keyframes came that what takes long is spread over steps."""
        return self.settled_maps.is_large(self._graph.arrived_count)

    def optimise_soiled(self, step: int) -> None:
        """Optimise all groups with new closures."""
        self._last_step = step
        for group in sorted({self._maps.group_of[robot] for robot in self._soiled}):
            self.optimise(group)
        self._settle()

    def finish(self) -> None:
        """Optimise all groups for good (end of an episode or log)."""
        for group in range(len(self._maps.groups)):
            self.optimise(group, is_thorough=True)
        self._settle()

    def _settle(self) -> None:
        """All groups have been optimised."""
        self._soiled.clear()
        self.due_step = math.inf

    def unsettle(self) -> None:
        """Robots came to share a map or no longer do: all of it may move."""
        self.settled_maps.forget()
        self._unthinned.clear()

    def optimise(self, group: int, is_thorough: bool = False) -> None:
        """Optimise a group's map, of a large one the part that may still move; thoroughly: all of any."""
        robots, count, arrived = self._maps.groups[group].robots, self._graph.node_count, self._graph.arrived_count
        may_hold = self._may_hold_poses and not is_thorough
        first = self.settled_maps.first_movable(robots, count, arrived) if may_hold else 0
        if first > 0 and self._optimise_latest(group, first):
            self.settled_maps.note(robots, count, is_whole=False)
            return
        self._optimise_whole(group, is_thorough, is_last=is_thorough)
        self.settled_maps.note(robots, count, is_whole=True)
        end = self.settled_maps.first_unsettled(robots, count, arrived)
        if self._forgetting is not None and not is_thorough and end > 0:
            self._unthinned[robots] = end

    @property
    def may_forget(self) -> bool:
        """Whether a large map was optimised as a whole and not thinned since."""
        return len(self._unthinned) > 0

    def forget(self) -> None:
        """Thin such a map: in another step, for both take long."""
        if self._forgetting is None or not self._unthinned:
            return
        robots, end = self._unthinned.popitem()
        kept = self._forgetting.forget(robots, end)
        self._unthinned = {others: int(np.searchsorted(kept, first)) for others, first in self._unthinned.items()}
        self.settled_maps.note_thinned(robots, kept)

    def _optimise_latest(self, group: int, first: int) -> bool:
        """Optimise the nodes from `first` on and leave the others; False where closures should be weighed anew."""
        robots = self._maps.groups[group].robots
        if self._is_refused_often(robots, self._graph.refused_count(robots)):
            return False
        nodes, _, graph, is_used = self._graph.subgraph(robots, first)
        held = np.arange(np.searchsorted(nodes, first))
        result = robust_backend.second_thoughts(self._graph.poses[nodes], graph, is_used, self._config, held)
        if not np.array_equal(result.accepted, is_used):
            return False
        self._graph.place(nodes, result.poses)
        self._maps.redraw_if_moved(group, first)
        return True

    def _is_refused_often(self, robots: tuple[int, ...], refused: int) -> bool:
        return refused >= max(REFUSED_MIN, 1.5 * self._refused_heard.get(robots, 0))

    def _optimise_whole(self, group: int, is_thorough: bool, is_last: bool) -> None:
        robots = self._maps.groups[group].robots
        nodes, edges, graph, is_used = self._graph.subgraph(robots)
        if len(nodes) < 2:
            return
        fixed = bisect_left(nodes, self._graph.node((robots[0], 0))) if self._graph.keyframes[robots[0]] else 0
        refused = int(np.count_nonzero(~is_used))
        is_thorough |= self._is_refused_often(robots, refused)
        result = robust_backend.revise(
            self._graph.poses[nodes], graph, is_used, self._config, fixed, is_thorough and refused > 0,
            lambda *answers: self._judge.may_replace(
                robots, nodes, *[(self._graph.closures_of(edges[a.accepted]), a.poses) for a in answers]
            ),
        )  # fmt: skip
        if is_thorough:
            self._refused_heard[robots] = refused
        self._graph.mark(edges, result.accepted, {r.edge: r.reason for r in result.rejections})
        poses = result.poses
        if self._radio is not None:
            local = self._graph.places_among(robots, nodes)
            poses = self._radio.fit(robots, graph.of(result.accepted), poses, local, fixed, is_last)
        self._graph.place(nodes, poses)
        self._maps.redraw_if_moved(group)
