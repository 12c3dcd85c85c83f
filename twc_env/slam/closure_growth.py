"""The back end `ours`: grow the map from the surest closures outwards, and take back what the rest contradicts.

Closures that follow one another and agree within the odometry between them form a group, and a group has one voice
however many members it has, because alike rooms make false closures that agree. A group is believed when its evidence,
the likelihood of what it says given the map so far against any other place in the building, is strong; while drift is
too large for that, groups must speak for each other. After each belief the map is optimised, gradually more robustly,
which sharpens the next test; whatever then contradicts the majority is revoked.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import PoseGraphConfig
from twc_env.slam import pose_graph
from twc_env.slam.closure_agreement import Pairs, groups_of_neighbours
from twc_env.slam.map_prediction import MapPrediction
from twc_env.slam.odometry_chains import Chains
from twc_env.slam.pose_graph import GATE, Graph
from twc_env.slam.twists import squared_length

KEEP_GATE = 25.0
"""A closure that the rest of the map contradicts by more is refused: 1.5e-5 of true ones at honest covariances."""
LONE_GATE = 9.348
"""In the end, a closure that has no group to vouch for it is held to 97.5 % of chi squared."""
UNCHECKED_BELOW = 0.25
"""Least share of its own noise that a closure's residual keeps after the fit when others check it."""
DOUBTS_MAX, DOUBT_ROUNDS_MAX, REVOKED_MAX = 12, 10, 3
"""Up to so many unchecked closures are doubted (more of them are dead ends of a well tied path); rounds of believing
without one of them; how often a group may be taken back."""
ODDS_SURE, ODDS_LIKELY, ODDS_TOGETHER = 8.0, 1.5, 3.0
"""Log odds from which groups are believed by the dozen; the best one, when there are no such; several together, when
none is likely alone."""
PRIOR_GROUPS = 30
"""Weight, in groups, of the share of true ones among all against that among the undecided."""
TRUST = (3, 1)
"""True and false groups of each kind imagined before any is heard: what nothing speaks against is rather true."""
CHOIR_MAX, CHOIR_SEEDS, CHOIR_VOICES = 150, 40, 12
"""Groups considered together while none is believed alone, how many are tried as the first, and how many join it."""
ROUNDS_MAX = 200


class ClosureGrowth:
    """Which groups of closures are believed, grown from the surest outwards."""

    def __init__(self, graph: Graph, poses: Array, config: PoseGraphConfig, keys_max: int):
        self._graph, self._config = graph, config
        self._closures = np.flatnonzero(graph.is_closure)
        chains = Chains(graph, poses)
        self.poses = chains.dead_reckoning(poses)
        self._group = groups_of_neighbours(Pairs(graph, self.poses, chains, self._closures), chains)
        self._map = MapPrediction(graph, chains, self._closures, keys_max)
        count = int(self._group.max()) + 1
        first = np.searchsorted(np.sort(self._group), np.arange(count))
        by_group = np.argsort(self._group, kind="stable")
        self._size = np.bincount(self._group, minlength=count)
        self._speaker = by_group[first + self._size // 2]  # (groups,) the closure in the middle speaks for its group
        self._believed = np.zeros(count, bool)
        self._revoked = np.zeros(count, np.int64)
        self._member_in = np.ones(len(self._closures), bool)

    def run(self) -> tuple[Array, Array, dict[int, str]]:
        """Poses, accepted edges (e,), and reasons of refused edges."""
        self._grow(ROUNDS_MAX)
        self._doubt()
        return self._finish()

    def _grow(self, rounds_max: int) -> None:
        for _ in range(rounds_max):
            if not self._believe_more():
                break
            self._settle()

    def _used(self) -> Array:
        return self._believed[self._group] & self._member_in

    def _look(self) -> None:
        self._map.look(self.poses, np.flatnonzero(self._used()))
        speakers = self._speaker[self._believed]
        self._map.learn_scale(speakers[self._member_in[speakers]])

    def _prior_odds(self, groups: Array, evidence: Array) -> Array:
        """(k,) log odds of undecided groups before they are heard, for single closures and for larger groups apart.

        Expectation maximisation over the share of true ones, drawn towards the share among all groups of the kind.
        """
        out = np.empty(len(groups))
        for is_single in (True, False):
            kind = (self._size[groups] == 1) == is_single
            heard = np.clip(evidence[kind], -50, 50)
            believed = np.count_nonzero(self._believed[(self._size == 1) == is_single])
            share = overall = 0.5
            for _ in range(20):
                true = (1 / (1 + np.exp(-heard) * (1 - share) / share)).sum()
                overall = (believed + true + TRUST[0]) / (believed + len(heard) + sum(TRUST))
                share = (true + PRIOR_GROUPS * overall) / (len(heard) + PRIOR_GROUPS)
            out[kind] = math.log(share / (1 - share))
        return out

    # --- believing and revoking

    def _believe_more(self) -> bool:
        self._look()
        pending = np.flatnonzero(~self._believed & (self._revoked < REVOKED_MAX))
        if not len(pending):
            return False
        speaker = self._speaker[pending]
        error, covariance = self._map.predicted(speaker)
        evidence = self._map.evidence(error, covariance)
        prior = self._prior_odds(pending, evidence)
        odds = evidence + prior
        sure = np.flatnonzero(odds > ODDS_SURE)
        if len(sure):
            spread = np.linalg.slogdet(covariance[sure])[1]
            new = sure[np.argsort(spread, kind="stable")[: max(10, len(sure) // 4)]]
        elif odds.max() > ODDS_LIKELY:
            new = np.array([np.argmax(odds)])
        else:
            best = np.argsort(-odds, kind="stable")[:CHOIR_MAX]
            new = best[self._choir(speaker[best], error[best], covariance[best], odds[best], prior[best])]
        self._believed[pending[new]] = True
        return len(new) > 0

    def _choir(self, speaker: Array, error: Array, covariance: Array, odds: Array, prior: Array) -> list[int]:
        """Groups that none believes alone but that support each other: the set with the best joint odds."""
        joint = self._map.joint_of(speaker, covariance)
        songs = [
            self._sing(int(seed), joint, error, odds, prior) for seed in np.argsort(-odds, kind="stable")[:CHOIR_SEEDS]
        ]
        songs = [song for song in songs if len(song[0]) > 1]
        return min(songs, key=lambda song: (len(song[0]), -song[1]))[0] if songs else []

    def _sing(self, seed: int, joint: Array, error: Array, odds: Array, prior: Array) -> tuple[list[int], float]:
        """The first few groups that `seed` speaks for and that are likely together, and their joint log odds."""
        members, chosen, total = [seed], seed, float(odds[seed])
        k = np.arange(len(error))
        for _ in range(CHOIR_VOICES - 1):
            gain = joint[:, :, chosen] @ np.linalg.inv(joint[chosen, :, chosen])  # (count, 3, 3)
            error = error - gain @ error[chosen]
            joint = joint - np.tensordot(gain, joint[chosen], axes=(2, 0))
            rest = np.setdiff1d(k, members)
            if not len(rest):
                break
            now = self._map.evidence(error[rest], joint[rest, :, rest]) + prior[rest]
            top = int(np.argmax(4 * now - 3 * odds[rest]))  # likely, and likelier for what was believed before
            chosen = int(rest[top])
            members.append(chosen)
            total += float(now[top])
            if total > ODDS_TOGETHER:
                return members, total
        return [], total

    def _settle(self) -> None:
        """Optimise on what is believed, gradually more robustly, and revoke what the rest then contradicts."""
        for _ in range(5):
            used = self._used()
            weight = (~self._graph.is_closure).astype(float)
            weight[self._closures[used]] = 1.0
            self.poses = self._graph.fit(self.poses, weight, 30)
            squared = self._graph.squared_errors(self.poses)[self._closures]
            if squared[used].max(initial=0.0) < KEEP_GATE:
                return
            for scale in (300.0, 30.0):
                config = replace(self._config, robust="dcs", robust_scale=scale, iterations_max=10)
                heard = self._graph.of(weight > 0)
                self.poses = pose_graph.optimise(self.poses, *heard.parts, config, shared=heard.shared)
            self._look()
            if not self._revoke():
                return

    def _revoke(self) -> bool:
        """Take back members, and groups whose speaker or half of whose members fail, by their leave-one-out error."""
        used = np.flatnonzero(self._used())
        failed = used[self._map.contradicted(used) > KEEP_GATE * self._map.gate_scale]
        if not len(failed):
            return False
        self._member_in[failed] = False
        lost = np.bincount(self._group[failed], minlength=len(self._believed))
        groups = np.flatnonzero(lost * 2 >= self._size)
        self._believed[groups] = False
        self._revoked[groups] += 1
        self._member_in[np.isin(self._group, groups)] = True
        return True

    def _doubt(self) -> None:
        """Lone closures that no other checks may keep several out that agree: see who is believed without each."""
        self._look()
        used = np.flatnonzero(self._used() & (self._size[self._group] == 1))
        if not len(used) or self._believed.all():
            return
        unchecked = used[self._map.checked_share(used) < UNCHECKED_BELOW]
        if len(unchecked) > DOUBTS_MAX:
            return
        for group in self._group[unchecked].tolist():
            held = self.poses, self._believed.copy(), self._revoked.copy(), self._member_in.copy()
            self._believed[group], self._revoked[group] = False, REVOKED_MAX
            self._settle()
            self._grow(DOUBT_ROUNDS_MAX)
            if np.count_nonzero(self._believed) <= np.count_nonzero(held[1]):
                self.poses, self._believed, self._revoked, self._member_in = held

    def _finish(self) -> tuple[Array, Array, dict[int, str]]:
        graph, closures = self._graph, self._closures
        for _ in range(3):  # with the map settled, every closure is judged on its own
            self._look()
            used = self._used()
            everyone = np.arange(len(closures))
            error, covariance = self._map.predicted(everyone)
            squared = squared_length(error, covariance)
            squared[used] = self._map.contradicted(np.flatnonzero(used))
            evidence = self._map.evidence(error, covariance)
            loose = self._map.gate_scale
            proven = evidence + self._final_odds(evidence) > ODDS_LIKELY
            gate = np.where(self._size[self._group] == 1, LONE_GATE, KEEP_GATE)
            kept = (squared < np.where(used, gate, np.minimum(gate, GATE)) * loose) & (used | proven)
            same = np.array_equal(kept, used)
            self._believed[:] = True
            self._member_in = kept
            weight = (~graph.is_closure).astype(float)
            weight[closures[kept]] = 1.0
            self.poses = graph.fit(self.poses, weight)
            if same:
                break
        return self.poses, weight > 0, self._reasons(kept, squared, evidence)

    def _final_odds(self, evidence: Array) -> Array:
        """(k,) log odds of every closure before it is heard, by the share of believed closures of its kind."""
        out = np.empty(len(evidence))
        single = self._size[self._group] == 1
        for kind in (single, ~single):
            out[kind] = math.log((self._used()[kind].sum() + 1) / ((~self._used()[kind]).sum() + 1))
        return np.minimum(out, 0.0)

    def _reasons(self, kept: Array, squared: Array, evidence: Array) -> dict[int, str]:
        share = np.bincount(self._group, kept, len(self._believed)) / self._size
        reasons = {}
        for k in np.flatnonzero(~kept):
            group = self._group[k]
            if squared[k] < GATE:
                why = "unproven: drift is too large to tell it from a false one"
            elif share[group] > 0:
                why = "contradicts its own group and the map"
            elif self._size[group] > 1:
                why = f"its group of {self._size[group]} agrees with itself but contradicts the map"
            else:
                why = "contradicts the map"
            reasons[int(self._closures[k])] = f"{why} (squared error {squared[k]:.1f}, log evidence {evidence[k]:.1f})"
        return reasons
