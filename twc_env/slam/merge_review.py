"""Second thoughts about merges: what has come to light since two groups were put into one map.

A merge is looked at again after some time, then after twice that time and so on, and whenever closures that contradict
it have become more. It is wrong when nothing holds it together any more, when more speaks for another place than for
this one, or closures agree on one that radio and walls confirm while they do not confirm this one, or when walls or
radio, now that more has been seen, speak against it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import MergingConfig
from twc_env.geometry import between, compose, inverse
from twc_env.messages import GridMap, LoopClosure
from twc_env.slam.group_maps import GroupMaps
from twc_env.slam.map_merging import MergeProposal, wall_contradiction
from twc_env.slam.merge_judge import MergeJudge
from twc_env.slam.team_graph import TeamGraph

FIRST_STEPS = 50
"""A merge is looked at again after so many steps, then after twice as many, and so on."""
WALLS_SLACK = 2.0
"""A standing merge may contradict walls by so much more than a new one."""
SAME_PLACE_M = 2.0
"""A merge that puts a robot this near where an undone one had put it is nearly the same."""
STRAIN_MIN, STRAIN_SHARE = 16.27, 0.5
"""A merge is wrong where odometry must err by more than 99.9 % of chi squared for one closure, and by more than this
share of what all closures that are used leave free, three each: more than right maps of training buildings pay, less
than a wrong one did, where a false closure and a true one pulled."""
IN_PLACE = np.zeros(3)


@dataclass(slots=True)
class Merge:
    """Two groups that became one."""

    a: tuple[int, ...]
    b: tuple[int, ...]
    due_step: int
    interval_steps: int = FIRST_STEPS
    refusals_seen: int = 0
    """Closures that had been refused at the last look."""


class MergeReview:
    """Remembers the merges of one mapper and says which of them are wrong, and why."""

    def __init__(self, config: MergingConfig, graph: TeamGraph, maps: GroupMaps, judge: MergeJudge):
        self._rule, self._graph, self._maps, self._judge = config, graph, maps, judge
        self.merges: list[Merge] = []
        self._next_step, self._refusals_seen = 0, 0
        """When the first of them is due, and closures that had been refused when `wrong` last found nothing."""
        self._undone: list[tuple[int, int, Array]] = []
        """Two robots that were torn apart, and where the odom frame of the second had been put in that of the first."""

    @property
    def undone_count(self) -> int:
        """Merges undone so far."""
        return len(self._undone)

    def note(self, a: tuple[int, ...], b: tuple[int, ...], step: int) -> None:
        """Two groups became one."""
        self.merges.append(Merge(a, b, step + FIRST_STEPS))
        self._next_step = min(self._next_step, step + FIRST_STEPS)

    def closures_needed(self, a: Sequence[int], b: Sequence[int], pose_a_b: Array) -> int:
        """Agreeing closures that a merge needs: twice as many for every time that nearly the same one was undone."""
        again = 0
        for i, j, before in self._undone:
            if (i in a and j in b) or (i in b and j in a):
                forth = pose_a_b if i in a else inverse(pose_a_b)
                now = between(self._graph.pose_map_odom(i), compose(forth, self._graph.pose_map_odom(j)))
                again += bool(np.hypot(*(now - before)[:2]) < SAME_PLACE_M)
        return self._rule.closures_min * 2**again

    @property
    def due_step(self) -> float:
        """The first step at which `wrong` may find anything, as far as is known now."""
        if not self.merges or not self._rule.undo:
            return math.inf
        return self._next_step if self._graph.refusals == self._refusals_seen else 0

    def wrong(self, step: int, one_by_one: bool = False) -> tuple[Merge, str] | None:
        """The first merge that turns out to be wrong, and why; None while all stand.

        one_by_one: look at one merge whose time has come, and at the others the next time.
        """
        for merge in self.merges:
            is_due = step >= merge.due_step
            why = self._objection(merge, step)
            if why:
                self._next_step = step  # the others have not been looked at
                return merge, why
            if is_due and one_by_one:
                self._next_step = step
                return None
        self._next_step = min((merge.due_step for merge in self.merges), default=0)
        self._refusals_seen = self._graph.refusals
        return None

    def forget(self, merge: Merge, sides: tuple[tuple[int, ...], tuple[int, ...]]) -> None:
        """A merge is undone and its group falls into two sides, see `part`: remember what it said."""
        self.merges.remove(merge)
        self.part(sides)
        i, j = merge.a[0], merge.b[0]
        self._undone.append((i, j, between(self._graph.pose_map_odom(i), self._graph.pose_map_odom(j))))

    def part(self, sides: tuple[tuple[int, ...], tuple[int, ...]]) -> None:
        """A group falls into two sides: of its merges each keeps what it holds together there."""
        self.merges = [part for merge in self.merges for part in _parts(merge, sides)]

    def sides(self, merge: Merge) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """All robots of the merged group on the two sides of a merge; who came later stands where most ties lead.

        Loose ones count between those who have no others.
        """
        group = self._maps.groups[self._maps.group_of[merge.a[0]]].robots
        a, b = list(merge.a), list(merge.b)
        rest = [r for r in group if r not in a and r not in b]
        while rest:
            ties = [(self._ties(r, a), self._ties(r, b)) for r in rest]
            first = max(range(len(rest)), key=lambda k: max(ties[k]))
            (a if ties[first][0] >= ties[first][1] else b).append(rest.pop(first))
        return tuple(sorted(a)), tuple(sorted(b))

    def _ties(self, robot: int, others: Sequence[int]) -> tuple[int, int]:
        """Closures between a robot and others that are believed: those that are not loose, and all."""
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
        rival = self._judge.proposal(rejected, a, len(supporters)) if is_news else None
        if rival is not None and self._is_better(rival, a, b, supporters):
            return f"{rival.support.sum()} closures agree on another place, {len(supporters)} on this one"
        return self._speaks_against(a, b) if is_due else ""

    def _latest(self, robots: Sequence[int]) -> Merge | None:
        """The last merge of a group: before it the map was sound."""
        return next((merge for merge in reversed(self.merges) if merge.a[0] in robots), None)

    def _is_strained(self, robots: Sequence[int]) -> bool:
        """Whether the closures that are used in the map of these robots contradict each other by way of odometry."""
        squared, count = self._graph.strain(robots)
        return squared > max(STRAIN_MIN, STRAIN_SHARE * 3 * count)

    def _is_better(
        self, rival: MergeProposal, a: Sequence[int], b: Sequence[int], supporters: Sequence[LoopClosure]
    ) -> bool:
        """Whether walls and radio allow another place, and signs, or radio and walls, prefer it to this one."""
        grids, there = self._grids(a, b), rival.pose_a_b
        heard = self._judge.radio_agrees(a, b, there) if self._rule.wifi_check else None
        if heard is False or self._judge.walls_disagree(*grids, there):
            return False
        if rival.weight > self._judge.weight(supporters, a):
            return True
        return heard is True and (
            self._judge.walls_disagree(*grids, IN_PLACE) or not self._judge.radio_agrees(a, b, IN_PLACE)
        )

    def _speaks_against(self, a: Sequence[int], b: Sequence[int]) -> str:
        """What walls and radio say."""
        share = wall_contradiction(*self._grids(a, b), IN_PLACE)
        if share > self._rule.contradiction_max * WALLS_SLACK:
            return f"{share:.0%} of the walls of one lie in the free space of the other"
        if self._rule.wifi_check and self._judge.radio_agrees(a, b, IN_PLACE) is False:
            return "places that it brings together sound different"
        return ""

    def _grids(self, a: Sequence[int], b: Sequence[int]) -> tuple[GridMap, GridMap]:
        group = self._maps.group_of[a[0]]
        return self._maps.known_grid(a, group), self._maps.known_grid(b, group)


def _parts(merge: Merge, sides: tuple[tuple[int, ...], ...]) -> list[Merge]:
    """What is left of a merge where its group fell apart; the merge itself where it is of another group."""
    if set(merge.a + merge.b).isdisjoint(sum(sides, ())):
        return [merge]
    parts = []
    for side in sides:
        a, b = (tuple(robot for robot in robots if robot in side) for robots in (merge.a, merge.b))
        if a and b:
            parts.append(replace(merge, a=a, b=b))
    return parts
