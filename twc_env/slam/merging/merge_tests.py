"""Evidence for and against merging the maps of two groups of robots."""

from __future__ import annotations

import itertools
import math
from bisect import bisect_left
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import MergingConfig
from twc_env.records.geometry import compose, inverse
from twc_env.records.messages import GridMap, LoopClosure
from twc_env.slam.mapping.team_graph import TeamGraph
from twc_env.slam.merging import map_merging
from twc_env.slam.merging.map_merging import MergeProposal, Weight
from twc_env.slam.merging.mutual_observations import CONTRADICTION_MIN, MutualObservations
from twc_env.slam.merging.sign_consistency import SignsRead, count_shared, found_apart
from twc_env.slam.places.heard_places import HeardPlaces
from twc_env.slam.places.sign_table import MISSING_AFTER_S

HYPOTHESES_MAX = 16
"""Of the hypotheses of single closures, the latest so many are tested by mutual observations."""
TOLD_APART = 0.9
"""Radio tells two hypotheses apart if the places that one brings together differ by less than this share of what those
of the other differ by."""
WALLS_SLACK = 2.0
"""An existing merge, or one with the map of an earlier session, may contradict walls by this factor more than a new
one: since that session doors were shut and furniture was moved."""
RADIO_SLACK = 1.1
"""An existing merge may contradict radio by this factor more than a new one."""
SCANS_ALONE_MIN = 8
"""Where neither signs nor fingerprints are compared and robots do not look for each other, places this many,
`spread_min_m` apart, must agree: rooms and whole wings of a building look alike."""
REPEATED_MAX = 0.05
"""Largest probability that a name is repeated elsewhere with which names alone merge maps."""
UNSEEN_MAX = 0.6
"""Largest difference by radio, of the reference, with which closures without a sign merge robots that never saw each
other."""

Solution = tuple[Sequence[LoopClosure], Array]
"""Accepted closures of a solution and its node poses (n, 3)."""


class MergeTests:
    """Evaluates a merge of robots `a` with robots `b` by closures, fingerprints, signs and walls."""

    def __init__(
        self,
        config: MergingConfig,
        graph: TeamGraph,
        spares_deaf: bool = False,
        mutual_observations: MutualObservations | None = None,
    ):
        self._rule, self._graph = config, graph
        self._spares_deaf = spares_deaf
        self._mutual_observations = mutual_observations
        self._heard = HeardPlaces()
        """Fingerprints of the nodes, added on demand."""
        self._read = SignsRead()

    def proposal(self, closures: Sequence[LoopClosure], a: Sequence[int]) -> MergeProposal | None:
        """The merge hypothesis from closures between `a` and other robots: pose of the others' map in the map of `a`.

        Loose closures are ignored: their two places may be metres apart.
        """
        closures = [c for c in closures if not c.is_loose]
        if len(closures) < self._rule.closures_min:
            return None
        found = map_merging.largest_agreement(*self._as_a_to_b(closures, a), self._rule)
        return found and replace(found, agreeing=tuple(itertools.compress(closures, found.support)))

    def observed_proposal(
        self, closures: Sequence[LoopClosure], a: Sequence[int], b: Sequence[int]
    ) -> MergeProposal | None:
        """A merge hypothesis of few closures by signs, even of one, that mutual observations of the robots prove.

        See `mutual_observations`. Of several proven hypotheses, the one by which the robots saw each other most often.
        Loose closures are ignored, and those by radio or scans alone: there are many more wrong ones among them.
        """
        closures = [c for c in closures if c.candidate.sign_m is not None and not c.is_loose]
        if self._mutual_observations is None or not self._mutual_observations.are_known or not closures:
            return None
        in_a, in_b, measured, signs, alike = self._as_a_to_b(closures, a)
        placed = compose(in_a, measured)
        poses_a_b, is_left, best, seen_most = compose(placed, inverse(in_b)), np.ones(len(closures), bool), None, 0
        for _ in range(HYPOTHESES_MAX):
            if not is_left.any():
                break
            pose_a_b = poses_a_b[np.flatnonzero(is_left)[-1]]
            support = map_merging.agree_with(pose_a_b, placed, in_b, self._rule)  # itself included
            is_left &= ~support
            found = self._mutual_observations.count(a, b, pose_a_b)
            if found.prove and found.seen > seen_most:
                best, seen_most = (pose_a_b, support), found.seen
        if best is None:
            return None
        pose_a_b, support = best
        weight = map_merging.weight_of(signs[support], alike[support], self._rule)
        return MergeProposal(pose_a_b, support, weight, tuple(itertools.compress(closures, support)), is_proven=True)

    def agreeing_with(self, closure: LoopClosure, others: Sequence[LoopClosure]) -> list[LoopClosure]:
        """Those of other closures between the same two robots that move one against the other as this one does, and
        were measured `spread_min_m` or more away from it."""
        if not others:
            return []
        a = (closure.candidate.target[0],)
        targets, sources, measured, *_ = self._as_a_to_b([closure, *others], a)
        in_a = compose(targets, measured)
        agree = map_merging.agree_with(compose(in_a[0], inverse(sources[0])), in_a, sources, self._rule)
        is_away = np.hypot(*(sources - sources[0])[:, :2].T) >= self._rule.spread_min_m
        return list(itertools.compress(others, (agree & is_away)[1:]))

    def moves_robots_apart(self, before: Solution, after: Solution, nodes: Array) -> bool:
        """Whether solution `after`, of nodes (n,), puts two robots elsewhere to each other than most closures between
        them say that `before` accepted: only the review of merges may do that, after all tests of a merge."""
        asked = [c for c in before[0] if c.candidate.target[0] != c.candidate.source[0] and not c.is_loose]
        if not asked:
            return False
        ends = [[self._graph.node(c.candidate.target), self._graph.node(c.candidate.source)] for c in asked]
        rows, measured = np.searchsorted(nodes, np.array(ends)).T, np.array([c.pose_target_source for c in asked])
        held, holds = (
            ~map_merging.exclude(compose(poses[rows[0]], measured) - poses[rows[1]]) for poses in (before[1], after[1])
        )
        votes: Counter[frozenset[int]] = Counter()
        for closure, is_elsewhere in zip(asked, held & ~holds, strict=True):
            votes[frozenset((closure.candidate.target[0], closure.candidate.source[0]))] += 1 if is_elsewhere else -1
        return max(votes.values()) > 0

    def weight(self, closures: Sequence[LoopClosure], a: Sequence[int]) -> Weight:
        """Weight of closures for the transform between robots `a` and others; loose closures have none."""
        closures = [c for c in closures if not c.is_loose]
        if not closures:
            return 0, 0, 0
        *_, signs, alike = self._as_a_to_b(closures, a)
        return map_merging.weight_of(signs, alike, self._rule)

    def _as_a_to_b(self, closures: Sequence[LoopClosure], a: Sequence[int]) -> tuple[Array, Array, Array, Array, Array]:
        """Keyframe poses in a and in b, measured pose of the latter in the former (k, 3 each), sign positions in a (k,
        2).

        And whether both readings are identical (k,). Signs are placed from the keyframe of a, so that all are in one
        frame.
        """
        poses, node = self._graph.poses, self._graph.node
        in_a, in_b, measured, signs = [], [], [], []
        for closure in closures:
            target, source, z = closure.candidate.target, closure.candidate.source, closure.pose_target_source
            sign = closure.candidate.sign_m if closure.candidate.sign_m is not None else np.zeros(2)
            if target[0] not in a:
                sign = compose(inverse(z), [*sign, 0.0])[:2]
                target, source, z = source, target, inverse(z)
            signs.append(compose(poses[node(target)], [*sign, 0.0])[:2])
            in_a.append(poses[node(target)])
            in_b.append(poses[node(source)])
            measured.append(z)
        alike = np.array([closure.candidate.is_read_alike for closure in closures])
        return np.array(in_a), np.array(in_b), np.array(measured), np.array(signs), alike

    def cues_confirm(self, a: Sequence[int], b: Sequence[int], proposal: MergeProposal) -> bool:
        """Whether radio confirms the merge; without radio comparison, mutual observations or sign names must.

        Without a sign, radio alone does so only for robots that saw each other, or clearly (`UNSEEN_MAX`). Radio is not
        compared if switched off, or (`spares_deaf`) if one side never received anything. Then robots must have seen
        each other as the merge implies (`mutual_observations`), or `names_agree` is required if texts were compared.
        Scans alone merge nothing: whole wings of a building look alike, without anything that contradicts.
        SCANS_ALONE_MIN places are enough only where robots do not look for each other.
        """
        if self._is_heard(a, b):
            return self.radio_agrees(a, b, proposal.pose_a_b) is True and self._is_seen_or_sure(a, b, proposal)
        if self._mutual_observations is not None:
            found = self._mutual_observations.count(a, b, proposal.pose_a_b)
            if found.confirm or found.seen_through >= CONTRADICTION_MIN:
                return found.confirm
        compared = [closure.candidate for closure in proposal.agreeing]
        if self._rule.spread_min_m > 0.0 and all(candidate.sign_m is None for candidate in compared):
            looks = self._mutual_observations is not None and self._mutual_observations.are_known
            return not looks and proposal.weight[1] >= SCANS_ALONE_MIN
        is_read = not any(math.isnan(candidate.text_similarity) for candidate in compared)
        return not is_read or self.names_agree(a, b, proposal.pose_a_b)

    def most_observed(
        self, a: Sequence[int], b: Sequence[int], proposal: MergeProposal, closures: Sequence[LoopClosure]
    ) -> MergeProposal:
        """The proposal, or that of fewer closures by which the robots saw each other more often, where radio is not
        compared: where rooms look alike, most closures may be between wrong ones, and robots that drive behind each
        other may be seen where the next one should be."""
        if proposal.is_proven or self._is_heard(a, b):
            return proposal
        other = self.observed_proposal(closures, a, b)
        is_other = other is not None and map_merging.exclude((other.pose_a_b - proposal.pose_a_b)[None])[0]
        return other if other is not None and is_other else proposal

    def _is_seen_or_sure(self, a: Sequence[int], b: Sequence[int], proposal: MergeProposal) -> bool:
        """Whether a merge has a sign, or robots that saw each other, or else places that sound much alike.

        Aisles and rooms look alike, and a few metres further on sound nearly alike, too. Robots that explore one after
        the other cannot see each other.
        """
        watch, pose_a_b = self._mutual_observations, proposal.pose_a_b
        has_sign = any(closure.candidate.sign_m is not None for closure in proposal.agreeing)
        if has_sign or watch is None or not watch.are_together(a, b):
            return True
        found = watch.count(a, b, pose_a_b)
        if found.seen > found.seen_through:
            return True
        difference = self.radio_difference(a, b, pose_a_b)
        return difference is not None and difference < UNSEEN_MAX

    def _is_heard(self, a: Sequence[int], b: Sequence[int]) -> bool:
        """Whether radio is compared: it is switched on, and not spared because one side never received anything."""
        return self._rule.wifi_check and not (self._spares_deaf and (self._heard_nothing(a) or self._heard_nothing(b)))

    def _heard_nothing(self, robots: Sequence[int]) -> bool:
        paths = [self._graph.keyframes[robot] for robot in robots]
        is_late = any(path[-1].time_s >= MISSING_AFTER_S for path in paths if path)
        return is_late and not any(len(keyframe.fingerprint.macs) for path in paths for keyframe in path)

    def radio_prefers(self, a: Sequence[int], b: Sequence[int], pose_a_b: Array, other: Array) -> bool | None:
        """Whether the places that the first pose brings together are clearly more alike than those of the other; None
        if radio cannot compare them."""
        if not self._rule.wifi_check:
            return None
        here, there = (self.radio_difference(a, b, pose) for pose in (pose_a_b, other))
        return None if here is None or there is None else here < TOLD_APART * there

    def radio_agrees(self, a: Sequence[int], b: Sequence[int], pose_a_b: Array) -> bool | None:
        """Whether places that the merge brings together are more alike than those of one robot at REFERENCE_M, heard
        soon after each other or when it came back; None with too few pairs.

        Two robots hear a place at different times. Where access points change their power meanwhile, only what a robot
        hears when it comes back has the like in it.
        """
        soon = self.radio_difference(a, b, pose_a_b)
        return None if soon is None else soon < 1.0 or bool(self._agrees_later(a, b, pose_a_b, 1.0))

    def radio_still_agrees(self, a: Sequence[int], b: Sequence[int]) -> bool | None:
        """`radio_agrees` of an existing merge, with RADIO_SLACK; None also as long as no robot came back."""
        here = np.zeros(3)
        soon = self.radio_difference(a, b, here)
        return soon if soon is None else soon < RADIO_SLACK or self._agrees_later(a, b, here, RADIO_SLACK)

    def _agrees_later(self, a: Sequence[int], b: Sequence[int], pose_a_b: Array, slack: float) -> bool | None:
        later = self.radio_difference(a, b, pose_a_b, map_merging.LATER_M)
        return None if later is None else later < slack

    def radio_difference(
        self, a: Sequence[int], b: Sequence[int], pose_a_b: Array, between_m: tuple[float, float] = map_merging.SOON_M
    ) -> float | None:
        """`map_merging.wifi_difference` of this merge."""
        members, graph = [*a, *b], self._graph
        paths = [graph.path_of(robot) for robot in members]
        nodes, count_a = np.concatenate(paths), sum(map(len, paths[: len(a)]))
        poses = graph.poses[nodes]
        poses[count_a:] = compose(pose_a_b, poses[count_a:])
        return map_merging.wifi_difference(
            poses[:, :2],
            graph.robot_of_node[nodes],
            graph.travels_m[nodes],
            self._heard_everywhere(),
            nodes,
            np.arange(len(nodes)) >= count_a,
            between_m,
        )

    def sparsify(self, _: Array) -> None:
        """Drop caches after keyframes were removed (`TeamGraph.sparsify`)."""
        self._heard = HeardPlaces()
        self._read.clear()

    def signs_disagree(self, a: Sequence[int], b: Sequence[int], pose_a_b: Array) -> bool:
        """Whether of the sign places that the merge brings together more read differently than identically."""
        robots, texts, places = self._read_by((*a, *b), self._poses_with(b, pose_a_b))
        return _texts_disagree(texts, places, np.isin(robots, b))

    def names_agree(self, a: Sequence[int], b: Sequence[int], pose_a_b: Array) -> bool:
        """Whether enough places that the merge brings together have one name that was read nowhere else, more than have
        two, in a building where names seldom repeat.

        Else one more copy of a wing, with all its names, is no surprise. Of n names read more than once, r at several
        places, the next one repeats with probability (r + 1/2) / (n + 1) (Jeffreys' prior).
        """
        if self._rule.signs_read_alike_min == 0:
            return True
        robots, texts, places = self._read_by(range(len(self._graph.keyframes)), self._poses_with(b, pose_a_b))
        are_tried = np.isin(robots, (*a, *b))
        are_apart = found_apart(texts, places[:, :2], np.where(are_tried, 0, robots + 1))
        is_sure = np.bincount(texts) > 1
        if np.count_nonzero(are_apart & is_sure) + 0.5 > REPEATED_MAX * (np.count_nonzero(is_sure) + 1):
            return False
        are_told = are_tried & ~are_apart[texts]
        same, other = count_shared(texts[are_told], places[are_told], np.isin(robots[are_told], b))
        return same >= self._rule.signs_read_alike_min and same > other

    def _poses_with(self, b: Sequence[int], pose_a_b: Array) -> Array:
        """(n, 3) poses of all nodes, with those of `b` transformed to the map of `a`."""
        poses, nodes = self._graph.poses.copy(), self._graph.nodes_of(b)
        poses[nodes] = compose(pose_a_b, poses[nodes])
        return poses

    def _read_by(self, robots: Iterable[int], poses: Array) -> tuple[Array, Array, Array]:
        """All readings of some robots, with nodes at poses (n, 3): robot (k,), text number (k,), pose of each sign (k,
        3)."""
        whose, texts, places = [], [], []
        for robot in robots:
            at, numbers, local = self._read.by(robot, self._graph.keyframes[robot])
            whose.append(np.full(len(at), robot))
            texts.append(numbers)
            places.append(compose(poses[self._graph.path_of(robot)[at]], local))
        return np.concatenate(whose), np.concatenate(texts), np.concatenate(places)

    def _heard_everywhere(self) -> HeardPlaces:
        """Fingerprints of all nodes."""
        graph, heard = self._graph, self._heard
        known = len(heard)
        new = [iter(path[bisect_left(graph.path_of(r), known) :]) for r, path in enumerate(graph.keyframes)]
        heard.add([next(new[robot]).fingerprint for robot in graph.robot_of_node[known:].tolist()])
        return heard

    def overlap(self, a: Sequence[int], b: Sequence[int], pose_a_b: Array, reach_m: float) -> list[tuple[int, int]]:
        """(robot, keyframe index) of keyframes of either side that the merge would put within `reach_m` of the other
        side."""
        names = [[(r, k.index) for r in side for k in self._graph.keyframes[r]] for side in (a, b)]
        poses = [np.concatenate([self._graph.poses_of(r) for r in side]) for side in (a, b)]
        apart = poses[0][:, None, :2] - compose(pose_a_b, poses[1])[None, :, :2]
        near = np.hypot(apart[..., 0], apart[..., 1]) < reach_m
        chosen = near.any(axis=1), near.any(axis=0)
        return [
            name
            for side, is_near in zip(names, chosen, strict=True)
            for name, n in zip(side, is_near, strict=True)
            if n
        ]

    def mutual_observations_contradict(self, a: Sequence[int], b: Sequence[int], pose_a_b: Array) -> bool:
        """Whether robots saw through the places where the merge puts others at that time (`mutual_observations`)."""
        return self._mutual_observations is not None and self._mutual_observations.count(a, b, pose_a_b).contradict

    def mutual_observations_confirm(self, a: Sequence[int], b: Sequence[int], pose_a_b: Array) -> bool:
        """Whether robots saw each other where and when the merge says so, too often for chance."""
        return self._mutual_observations is not None and self._mutual_observations.count(a, b, pose_a_b).confirm

    def walls_disagree(self, grid_a: GridMap, grid_b: GridMap, pose_a_b: Array, slack: float = 1.0) -> bool:
        """Whether more than `contradiction_max`, times slack, of one map's walls lie in free space of the other."""
        return map_merging.wall_contradiction(grid_a, grid_b, pose_a_b) > self._rule.contradiction_max * slack


def _texts_disagree(texts: Array, places: Array, is_b: Array) -> bool:
    """Whether of the shared sign places more read differently than identically; arguments as in `count_shared`."""
    same, other = count_shared(texts, places, is_b)
    return other > same
