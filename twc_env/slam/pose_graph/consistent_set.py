"""The robust back end `ours`: accepts groups of closures incrementally, most certain first, and revokes outliers.

Neighbouring closures that are consistent given the odometry between them form a group. A group counts once, whatever
its size, because similar rooms produce false closures that are consistent with each other. It is accepted if its log
odds are high: the likelihood ratio of its measurement under the current map against a uniformly distributed pose, plus
a prior. While drift is too large for that, several groups are accepted jointly. After each acceptance the graph is
optimised with increasingly robust kernels; closures that then contradict the rest are revoked.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import PoseGraphConfig
from twc_env.records.twists import squared_length
from twc_env.slam.pose_graph import solver as pose_graph
from twc_env.slam.pose_graph.closure_prediction import MapPrediction
from twc_env.slam.pose_graph.odometry_chains import Chains
from twc_env.slam.pose_graph.pairwise_consistency import PairwiseConsistency, neighbour_groups
from twc_env.slam.pose_graph.solver import GATE, Graph

KEEP_GATE = 25.0
"""Largest squared leave-one-out error of an accepted closure; with correct covariances 1.5e-5 of true ones exceed
it."""
SINGLE_GATE = 9.348
"""The same in the final check of closures in a group of one: 97.5 % of chi-squared with three degrees of freedom."""
UNCHECKED_BELOW = 0.25
"""A closure whose residual keeps less than this share of its own noise after the fit is not checked by others."""
UNCHECKED_MAX, RETRY_ROUNDS_MAX, REVOCATIONS_MAX = 12, 10, 3
"""With more unchecked closures (dead ends of a well constrained graph) none is tested; rounds of acceptance without one
of them; how often a group may be revoked."""
ODDS_SURE, ODDS_LIKELY, ODDS_JOINT = 8.0, 1.5, 3.0
"""Log odds to accept many groups at once; otherwise to accept the best one; otherwise to accept several jointly."""
PRIOR_GROUPS = 30
"""Weight, in groups, of the share of true groups among all against that among the undecided ones."""
PRIOR_COUNTS = (3, 1)
"""Pseudo-counts of true and false groups of each kind: without evidence a group is more likely true."""
JOINT_GROUPS_MAX, JOINT_SEEDS, JOINT_SIZE_MAX = 150, 40, 12
"""Groups considered for joint acceptance, those of them that start a set, and the largest set."""
ROUNDS_MAX = 200
UNPROVEN = "unproven"
"""How the reason of a closure begins that is neither accepted nor contradicted."""


class ConsistentSetSearch:
    """Incremental selection of groups of closures. A group is represented by its median closure."""

    def __init__(self, graph: Graph, poses: Array, config: PoseGraphConfig, keys_max: int):
        self._graph, self._config = graph, config
        self._closures = np.flatnonzero(graph.is_closure)
        chains = Chains(graph, poses)
        self.poses = chains.dead_reckoning(poses)
        self._group = neighbour_groups(PairwiseConsistency(graph, self.poses, chains, self._closures), chains)
        self._map = MapPrediction(graph, chains, self._closures, keys_max)
        count = int(self._group.max()) + 1
        first = np.searchsorted(np.sort(self._group), np.arange(count))
        by_group = np.argsort(self._group, kind="stable")
        self._size = np.bincount(self._group, minlength=count)
        self._representative = by_group[first + self._size // 2]  # (groups,) its median closure
        self._accepted = np.zeros(count, bool)
        self._revoked = np.zeros(count, np.int64)
        self._is_member_used = np.ones(len(self._closures), bool)

    def run(self) -> tuple[Array, Array, dict[int, str]]:
        """Poses (n, 3), accepted edges (e,) bool, and the reason for each rejected edge."""
        self._grow(ROUNDS_MAX)
        self._retry_without_unchecked()
        return self._finish()

    def _grow(self, rounds_max: int) -> None:
        for _ in range(rounds_max):
            if not self._accept_more():
                break
            self._optimise_and_revoke()

    def _used(self) -> Array:
        return self._accepted[self._group] & self._is_member_used

    def _predict(self) -> None:
        self._map.update(self.poses, np.flatnonzero(self._used()))
        representatives = self._representative[self._accepted]
        self._map.estimate_scale(representatives[self._is_member_used[representatives]])

    def _prior_odds(self, groups: Array, evidence: Array) -> Array:
        """(k,) prior log odds of undecided groups, separately for single closures and for larger groups.

        Expectation maximisation of the share of true groups, regularised towards the share among all of the kind.
        """
        out = np.empty(len(groups))
        for is_single in (True, False):
            kind = (self._size[groups] == 1) == is_single
            clipped = np.clip(evidence[kind], -50, 50)
            accepted = np.count_nonzero(self._accepted[(self._size == 1) == is_single])
            share = overall = 0.5
            against = np.exp(-clipped)
            for _ in range(20):
                true = (1 / (1 + against * (1 - share) / share)).sum()
                overall = (accepted + true + PRIOR_COUNTS[0]) / (accepted + len(clipped) + sum(PRIOR_COUNTS))
                share = (true + PRIOR_GROUPS * overall) / (len(clipped) + PRIOR_GROUPS)
            out[kind] = math.log(share / (1 - share))
        return out

    # --- accepting and revoking

    def _accept_more(self) -> bool:
        """Accept the next groups; whether there were any."""
        self._predict()
        pending = np.flatnonzero(~self._accepted & (self._revoked < REVOCATIONS_MAX))
        if not len(pending):
            return False
        representative = self._representative[pending]
        error, covariance = self._map.predicted(representative)
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
            best = np.argsort(-odds, kind="stable")[:JOINT_GROUPS_MAX]
            new = best[self._joint_set(representative[best], error[best], covariance[best], odds[best], prior[best])]
        self._accepted[pending[new]] = True
        return len(new) > 0

    def _joint_set(
        self, representative: Array, error: Array, covariance: Array, odds: Array, prior: Array
    ) -> list[int]:
        """The smallest set of groups that are likely jointly though none is alone; of equal sizes the likeliest."""
        joint = self._map.joint_of(representative, covariance)
        seeds = np.argsort(-odds, kind="stable")[:JOINT_SEEDS]
        sets = [self._grow_set(int(seed), joint, error, odds, prior) for seed in seeds]
        sets = [found for found in sets if len(found[0]) > 1]
        return min(sets, key=lambda found: (len(found[0]), -found[1]))[0] if sets else []

    def _grow_set(self, seed: int, joint: Array, error: Array, odds: Array, prior: Array) -> tuple[list[int], float]:
        """A set of groups grown greedily from `seed` until its joint log odds exceed `ODDS_JOINT`, or empty; the odds.

        Each added group conditions the predicted errors of the others (Kalman update).
        """
        members, chosen, total = [seed], seed, float(odds[seed])
        is_outside = np.ones(len(error), bool)
        for _ in range(JOINT_SIZE_MAX - 1):
            gain = joint[:, :, chosen] @ np.linalg.inv(joint[chosen, :, chosen])  # (count, 3, 3)
            error = error - gain @ error[chosen]
            joint = joint - np.tensordot(gain, joint[chosen], axes=(2, 0))
            is_outside[chosen] = False
            rest = np.flatnonzero(is_outside)
            if not len(rest):
                break
            now = self._map.evidence(error[rest], joint[rest, :, rest]) + prior[rest]
            top = int(np.argmax(4 * now - 3 * odds[rest]))  # likely, and more so than on its own
            chosen = int(rest[top])
            members.append(chosen)
            total += float(now[top])
            if total > ODDS_JOINT:
                return members, total
        return [], total

    def _optimise_and_revoke(self) -> None:
        """Optimise on the accepted closures with increasingly robust DCS kernels and revoke contradicted ones."""
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
                active = self._graph.of(weight > 0)
                self.poses = pose_graph.optimise(self.poses, *active.parts, config, shared=active.shared)
            self._predict()
            if not self._revoke():
                return

    def _revoke(self) -> bool:
        """Revoke closures by their leave-one-out error, and groups of which half fail; whether any failed."""
        used = np.flatnonzero(self._used())
        failed = used[self._map.leave_one_out_errors(used) > KEEP_GATE * self._map.gate_scale]
        if not len(failed):
            return False
        self._is_member_used[failed] = False
        lost = np.bincount(self._group[failed], minlength=len(self._accepted))
        groups = np.flatnonzero(lost * 2 >= self._size)
        self._accepted[groups] = False
        self._revoked[groups] += 1
        self._is_member_used[np.isin(self._group, groups)] = True
        return True

    def _retry_without_unchecked(self) -> None:
        """Try without each single closure that no other checks: a false one may exclude several consistent ones."""
        self._predict()
        used = np.flatnonzero(self._used() & (self._size[self._group] == 1))
        if not len(used) or self._accepted.all():
            return
        unchecked = used[self._map.redundancy(used) < UNCHECKED_BELOW]
        if len(unchecked) > UNCHECKED_MAX:
            return
        for group in self._group[unchecked].tolist():
            held = self.poses, self._accepted.copy(), self._revoked.copy(), self._is_member_used.copy()
            self._accepted[group], self._revoked[group] = False, REVOCATIONS_MAX
            self._optimise_and_revoke()
            self._grow(RETRY_ROUNDS_MAX)
            if np.count_nonzero(self._accepted) <= np.count_nonzero(held[1]):
                self.poses, self._accepted, self._revoked, self._is_member_used = held

    def _finish(self) -> tuple[Array, Array, dict[int, str]]:
        """Decide about each closure individually on the final map; returns as `run`."""
        graph, closures = self._graph, self._closures
        for _ in range(3):
            self._predict()
            used = self._used()
            every = np.arange(len(closures))
            error, covariance = self._map.predicted(every)
            squared = squared_length(error, covariance)
            squared[used] = self._map.leave_one_out_errors(np.flatnonzero(used))
            evidence = self._map.evidence(error, covariance)
            loose = self._map.gate_scale
            proven = evidence + self._final_odds(evidence) > ODDS_LIKELY
            gate = np.where(self._size[self._group] == 1, SINGLE_GATE, KEEP_GATE)
            kept = (squared < np.where(used, gate, np.minimum(gate, GATE)) * loose) & (used | proven)
            same = np.array_equal(kept, used)
            self._accepted[:] = True
            self._is_member_used = kept
            weight = (~graph.is_closure).astype(float)
            weight[closures[kept]] = 1.0
            self.poses = graph.fit(self.poses, weight)
            if same:
                break
        return self.poses, weight > 0, self._reasons(kept, squared, evidence)

    def _final_odds(self, evidence: Array) -> Array:
        """(k,) prior log odds of every closure from the share of accepted ones of its kind, at most 0."""
        out = np.empty(len(evidence))
        single = self._size[self._group] == 1
        for kind in (single, ~single):
            out[kind] = math.log((self._used()[kind].sum() + 1) / ((~self._used()[kind]).sum() + 1))
        return np.minimum(out, 0.0)

    def _reasons(self, kept: Array, squared: Array, evidence: Array) -> dict[int, str]:
        share = np.bincount(self._group, kept, len(self._accepted)) / self._size
        reasons = {}
        for k in np.flatnonzero(~kept):
            group = self._group[k]
            if squared[k] < GATE:
                why = f"{UNPROVEN}: drift is too large to distinguish it from a false closure"
            elif share[group] > 0:
                why = "contradicts its group and the map"
            elif self._size[group] > 1:
                why = f"its group of {self._size[group]} is self-consistent but contradicts the map"
            else:
                why = "contradicts the map"
            reasons[int(self._closures[k])] = f"{why} (squared error {squared[k]:.1f}, log evidence {evidence[k]:.1f})"
        return reasons
