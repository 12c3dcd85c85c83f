"""Re-evaluates merges after new evidence and reports those that are wrong.

A merge is re-evaluated after FIRST_STEPS, then after twice that and so on, and whenever more closures contradict it. It
is wrong if no accepted closure supports it any more; if rejected closures have more weight for another transform, or
agree on one that radio and walls confirm while they do not confirm the present one; or if walls or radio, with more
data, contradict it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import MergingConfig
from twc_env.records.geometry import between, compose, inverse
from twc_env.records.messages import GridMap, LoopClosure
from twc_env.slam.mapping.group_maps import GroupMaps
from twc_env.slam.mapping.team_graph import TeamGraph
from twc_env.slam.merging.map_merging import MergeProposal, wall_contradiction
from twc_env.slam.merging.merge_tests import WALLS_SLACK, MergeTests

FIRST_STEPS = 50
"""Steps until the first re-evaluation; the interval doubles each time."""
SAME_PLACE_M = 2.0
"""A merge hypothesis this near an undone one counts as the same [m]."""
STRAIN_MIN, STRAIN_SHARE = 16.27, 0.5
"""A merge is wrong if the odometry residuals exceed STRAIN_MIN (99.9 % of chi-squared, 3 degrees of freedom: one
closure) and STRAIN_SHARE of the degrees of freedom of all used closures, three each. Correct maps of training buildings
stay below; one wrong map, with a false and a true closure in conflict, was above."""
IDENTITY = np.zeros(3)


@dataclass(slots=True)
class Merge:
    """A merge of two groups."""

    a: tuple[int, ...]
    b: tuple[int, ...]
    due_step: int
    interval_steps: int = FIRST_STEPS
    refusals_seen: int = 0
    """`TeamGraph.refusals` at the last re-evaluation."""


class MergeReview:
    """Records the merges of one mapper and reports which are wrong, and why."""

    def __init__(self, config: MergingConfig, graph: TeamGraph, maps: GroupMaps, tests: MergeTests):
        self._rule, self._graph, self._maps, self._tests = config, graph, maps, tests
        self.merges: list[Merge] = []
        self._next_step, self._refusals_seen = 0, 0
        """Step at which the first merge is due, and `TeamGraph.refusals` when `wrong` last found nothing."""
        self._undone: list[tuple[int, int, Array]] = []
        """Undone merges: two robots, and the pose of the second's odom frame in the first's."""

    @property
    def undone_count(self) -> int:
        """Number of merges undone."""
        return len(self._undone)

    def record_merge(self, a: tuple[int, ...], b: tuple[int, ...], step: int) -> None:
        """Record a merge of two groups."""
        self.merges.append(Merge(a, b, step + FIRST_STEPS))
        self._next_step = min(self._next_step, step + FIRST_STEPS)

    def closures_needed(self, a: Sequence[int], b: Sequence[int], proposal: MergeProposal) -> int:
        """Agreeing closures that a merge needs: doubled for each time that nearly the same merge was undone."""
        again = 0
        for i, j, before in self._undone:
            if (i in a and j in b) or (i in b and j in a):
                forth = proposal.pose_a_b if i in a else inverse(proposal.pose_a_b)
                now = between(self._graph.pose_map_odom(i), compose(forth, self._graph.pose_map_odom(j)))
                again += bool(np.hypot(*(now - before)[:2]) < SAME_PLACE_M)
        return (1 if proposal.is_proven else self._rule.closures_min) * 2**again

    @property
    def due_step(self) -> float:
        """First step at which `wrong` can find anything, as known now."""
        if not self.merges or not self._rule.undo:
            return math.inf
        return self._next_step if self._graph.refusals == self._refusals_seen else 0

    def wrong(self, step: int, one_by_one: bool = False) -> tuple[Merge, str] | None:
        """The first merge found wrong and the reason; None if all stand.

        one_by_one: re-evaluate only one due merge per call.
        """
        for merge in self.merges:
            is_due = step >= merge.due_step
            why = self._objection(merge, step)
            if why:
                self._next_step = step  # the others were not re-evaluated
                return merge, why
            if is_due and one_by_one:
                self._next_step = step
                return None
        self._next_step = min((merge.due_step for merge in self.merges), default=0)
        self._refusals_seen = self._graph.refusals
        return None

    def record_undone(self, merge: Merge, sides: tuple[tuple[int, ...], tuple[int, ...]]) -> None:
        """Record that a merge was undone and its group split into `sides`."""
        self.merges.remove(merge)
        self.split(sides)
        i, j = merge.a[0], merge.b[0]
        self._undone.append((i, j, between(self._graph.pose_map_odom(i), self._graph.pose_map_odom(j))))

    def split(self, sides: tuple[tuple[int, ...], tuple[int, ...]]) -> None:
        """A group is split into two sides: replace its merges by their remainders within each side."""
        self.merges = [part for merge in self.merges for part in _split_merge(merge, sides)]

    def sides(self, merge: Merge) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Partition a merged group into the two sides of a merge. Robots that joined later go to the side with more
        accepted closures to them; loose closures only break ties."""
        group = self._maps.groups[self._maps.group_of[merge.a[0]]].robots
        a, b = list(merge.a), list(merge.b)
        rest = [r for r in group if r not in a and r not in b]
        while rest:
            ties = [(self._accepted_counts(r, a), self._accepted_counts(r, b)) for r in rest]
            first = max(range(len(rest)), key=lambda k: max(ties[k]))
            (a if ties[first][0] >= ties[first][1] else b).append(rest.pop(first))
        return tuple(sorted(a)), tuple(sorted(b))

    def _accepted_counts(self, robot: int, others: Sequence[int]) -> tuple[int, int]:
        """Numbers of accepted closures between a robot and others: those that are not loose, and all."""
        closures = self._graph.closures_between((robot,), others, "accepted")
        return sum(not closure.is_loose for closure in closures), len(closures)

    def _objection(self, merge: Merge, step: int) -> str:
        is_due = step >= merge.due_step
        if not is_due and self._graph.refusals == merge.refusals_seen:
            return ""
        is_news = self._graph.refusals != merge.refusals_seen
        merge.refusals_seen = self._graph.refusals
        if is_due:
            merge.interval_steps *= 2
            merge.due_step = step + merge.interval_steps
        a, b = self.sides(merge)
        supporters = [c for c in self._graph.closures_between(a, b, "accepted") if not c.is_loose]
        if not supporters:
            return "no closure is left that speaks for it"
        if merge is self._latest(a + b) and self._is_strained(a + b):
            return "odometry would have to err by more than it does"
        rejected = self._graph.closures_between(a, b, "rejected")
        rival = self._tests.proposal(rejected, a) if is_news else None
        if rival is not None and self._is_better(rival, a, b, supporters):
            return f"{rival.support.sum()} closures agree on another place, {len(supporters)} on this one"
        return self._map_objection(a, b) if is_due else ""

    def _latest(self, robots: Sequence[int]) -> Merge | None:
        """The most recent merge of a group; only this one can have introduced the strain."""
        return next((merge for merge in reversed(self.merges) if merge.a[0] in robots), None)

    def _is_strained(self, robots: Sequence[int]) -> bool:
        """Whether used closures of these robots contradict each other through odometry (see STRAIN_MIN)."""
        squared, count = self._graph.strain(robots)
        return squared > max(STRAIN_MIN, STRAIN_SHARE * 3 * count)

    def _is_better(
        self, rival: MergeProposal, a: Sequence[int], b: Sequence[int], supporters: Sequence[LoopClosure]
    ) -> bool:
        """Whether walls, radio and mutual observations allow the rival transform, neither radio nor mutual observations
        speak for the present one, and signs, or radio and walls, prefer the rival.

        Robots that saw each other were there: no number of closures by repeated signs says otherwise.
        """
        if self._tests.mutual_observations_confirm(a, b, IDENTITY):
            return False
        grids, there = self._grids(a, b), rival.pose_a_b
        heard = self._tests.radio_agrees(a, b, there) if self._rule.wifi_check else None
        if heard is False or self._tests.walls_disagree(*grids, there):
            return False
        if self._tests.mutual_observations_contradict(a, b, there) or self._tests.radio_prefers(a, b, IDENTITY, there):
            return False
        if rival.weight > self._tests.weight(supporters, a):
            return True
        return heard is True and (
            self._tests.walls_disagree(*grids, IDENTITY) or not self._tests.radio_still_agrees(a, b)
        )

    def _map_objection(self, a: Sequence[int], b: Sequence[int]) -> str:
        """Why walls or radio contradict the merge; empty if they do not."""
        share = wall_contradiction(*self._grids(a, b), IDENTITY)
        if share > self._rule.contradiction_max * WALLS_SLACK:
            return f"{share:.0%} of the walls of one lie in the free space of the other"
        if self._rule.wifi_check and self._tests.radio_still_agrees(a, b) is False:
            return "places that it brings together sound different"
        if self._tests.mutual_observations_contradict(a, b, IDENTITY):
            return "robots saw through the places where it puts others"
        return ""

    def _grids(self, a: Sequence[int], b: Sequence[int]) -> tuple[GridMap, GridMap]:
        group = self._maps.group_of[a[0]]
        return self._maps.known_grid(a, group), self._maps.known_grid(b, group)


def _split_merge(merge: Merge, sides: tuple[tuple[int, ...], ...]) -> list[Merge]:
    """The remainders of a merge after its group was split; the merge itself if it belongs to another group."""
    if set(merge.a + merge.b).isdisjoint(sum(sides, ())):
        return [merge]
    parts = []
    for side in sides:
        a, b = (tuple(robot for robot in robots if robot in side) for robots in (merge.a, merge.b))
        if a and b:
            parts.append(replace(merge, a=a, b=b))
    return parts
