"""Loop closure detection: candidates for each new keyframe, their queues, and geometric verification."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig
from twc_env.records.geometry import between
from twc_env.records.messages import Keyframe, LoopCandidate, LoopClosure
from twc_env.slam.mapping.group_maps import GroupMaps
from twc_env.slam.mapping.team_graph import TeamGraph
from twc_env.slam.matching.loop_verification import LoopVerifier, SignVerifier
from twc_env.slam.places.place_recognition import ProposalFilter, make_recogniser
from twc_env.slam.places.signless_recognisers import SignlessRecogniser
from twc_env.slam.places.text_wifi_recogniser import TextWifiRecogniser

REPEAT_REACH_M = 2.0
"""A candidate is a repetition if an earlier one of the same recogniser is nearer than this along both paths."""
REPEAT_REACH_APART_M = 0.75
"""The same between robots that share no map: more closures are verified there."""
PROXIMITY_PERIOD_M = 1.5
"""Path length between two searches for nearby keyframes."""
ROBOT_MARGIN_M = 0.1
"""Objects wider than a robot by more than this are not robots."""
CLOSURE_PERIOD_M = 3.0
"""Path length after a closure on which a robot needs no other closure inside its map."""


class ClosureSearch:
    """Candidates wait in one queue per recogniser; each step verifies a few of them."""

    def __init__(self, config: EnvConfig, graph: TeamGraph, maps: GroupMaps, robot_count: int):
        self._rule, self._on_request = config.slam.place_recognition, config.link.scan_on_request
        self._graph, self._maps, self._robot_count = graph, maps, robot_count
        self._recogniser = make_recogniser(config.slam.place_recognition, config.lidar.range_max_m)
        self._drops_repetitions = isinstance(self._recogniser, TextWifiRecogniser)
        """Whether the recogniser itself drops repetitions, before it computes a candidate."""
        self._filters = {name: ProposalFilter() for name in (self._recogniser.name, "wifi", "proximity")}
        if isinstance(self._recogniser, TextWifiRecogniser):
            self._recogniser.is_wanted = partial(_is_new, maps, self._filters[self._recogniser.name])
        self._signless: SignlessRecogniser | None = None
        if self._recogniser.name == "twc" and config.slam.cues.lidar and self._rule.spares_missing_cues:
            self._signless = SignlessRecogniser(self._rule, config.lidar.range_max_m, robot_count)
        self._verifier: LoopVerifier | SignVerifier = SignVerifier()
        if config.slam.cues.lidar:
            self._verifier = LoopVerifier(config.slam.verification, config.slam.odometry_filter, config.lidar)
        self._robot_width_m = 2 * config.dynamics.robot_radius_m + ROBOT_MARGIN_M
        self._waiting: dict[str, deque[LoopCandidate]] = {name: deque() for name in self._filters}
        self.waiting_count = 0
        """Candidates in the queues; those in `_awaiting_scans` are not counted."""
        self._awaiting_scans: list[LoopCandidate] = []
        """Candidates whose scans have been requested."""
        self._searched_m = [0.0] * robot_count
        """Path length of each robot at its last search for nearby keyframes."""
        self._closure_period_m = CLOSURE_PERIOD_M if config.slam.cues.lidar else 0.0
        """`CLOSURE_PERIOD_M`, or 0 without laser, where every closure corrects the odometry."""
        self._closure_m = [-np.inf] * robot_count
        """Path length of each robot at its last accepted closure that was not loose ..."""
        self._any_closure_m = [-np.inf] * robot_count
        """... and at its last accepted closure, loose or not."""

    def add_robot(self) -> None:
        """Make room for one more robot."""
        self._searched_m.append(0.0)
        self._closure_m.append(-np.inf)
        self._any_closure_m.append(-np.inf)
        if self._signless is not None:
            self._signless.add_robot()

    def learn(self, keyframe: Keyframe) -> None:
        """Store the place of a keyframe without looking for closures, as of a map of an earlier session."""
        own = (keyframe.robot,)
        self._recogniser.propose(keyframe, own)
        if self._signless is not None:
            self._signless.propose(keyframe, own)

    def propose(self, keyframe: Keyframe) -> None:
        """Queue the candidates of a new keyframe."""
        has_closure, has_any_closure = (
            self._has_recent_closure(keyframe),
            self._has_recent_closure(keyframe, counts_loose=True),
        )
        teammates = self._maps.groups[self._maps.group_of[keyframe.robot]].robots
        candidates = self._recogniser.propose(keyframe, teammates if has_closure else ())
        new, candidates = (candidates, []) if self._drops_repetitions else ([], candidates)
        if self._signless is not None:
            is_lost = keyframe.robot >= self._robot_count and len(teammates) == 1
            candidates += self._signless.propose(keyframe, teammates if has_any_closure else (), is_lost)
        near = None if has_any_closure else self._near_keyframe(keyframe)
        if near is not None:
            candidates.append(near)
        for candidate in candidates:
            ends = self._graph.keyframe(candidate.target), self._graph.keyframe(candidate.source)
            if _is_new(self._maps, self._filters[candidate.recogniser], *ends):
                new.append(candidate)
        for candidate in new:
            self._waiting[candidate.recogniser].append(candidate)
            self.waiting_count += 1

    def _has_recent_closure(self, keyframe: Keyframe, counts_loose: bool = False) -> bool:
        """Whether the robot had an accepted closure within the last `CLOSURE_PERIOD_M` of its path."""
        last_m = self._any_closure_m if counts_loose else self._closure_m
        return keyframe.travel_m - last_m[keyframe.robot] < self._closure_period_m

    def _near_keyframe(self, keyframe: Keyframe) -> LoopCandidate | None:
        """A candidate with the nearest keyframe of the same map, within `proximity_m`; None if there is none.

        Keyframes of the same robot must be `revisit_travel_m` of path away.
        """
        reach_m = self._rule.proximity_m
        if reach_m <= 0 or keyframe.travel_m - self._searched_m[keyframe.robot] < PROXIMITY_PERIOD_M:
            return None
        self._searched_m[keyframe.robot] = keyframe.travel_m
        node, best, best_m = self._graph.node(keyframe.key), None, reach_m
        for robot in self._maps.groups[self._maps.group_of[keyframe.robot]].robots:
            latest_m = keyframe.travel_m - self._rule.revisit_travel_m if robot == keyframe.robot else np.inf
            nearest, away_m = self._graph.nearest(robot, node, latest_m)
            if away_m < best_m:
                best, best_m = self._graph.keyframes[robot][nearest].key, away_m
        if best is None:
            return None
        poses = self._graph.poses
        guess = between(poses[self._graph.node(best)], poses[node])
        return LoopCandidate(best, keyframe.key, guess, "proximity")

    def note_accepted(self, closure: LoopClosure) -> None:
        """Note an accepted closure: its robots need no other for a while, or no other loose one if it is loose."""
        for key in (closure.candidate.target, closure.candidate.source):
            travel_m = self._graph.keyframe(key).travel_m
            for last_m in (self._any_closure_m,) if closure.is_loose else (self._any_closure_m, self._closure_m):
                last_m[key[0]] = max(last_m[key[0]], travel_m)

    def drop_closures_of(self, robots: tuple[int, ...]) -> None:
        """The closures of these robots no longer hold: search for others at once."""
        for robot in robots:
            self._closure_m[robot] = self._any_closure_m[robot] = -np.inf

    def sparsify(self, _: Array) -> None:
        """Drop removed keyframes from the recognisers, the filters and the queues."""
        held = {keyframe.key for path in self._graph.keyframes for keyframe in path}
        for recogniser in (self._recogniser, self._signless):
            if recogniser is not None:
                recogniser.sparsify(lambda keyframe: keyframe.key in held)
        latest_m = [path[-1].travel_m if path else 0.0 for path in self._graph.keyframes]
        for tried in self._filters.values():
            tried.drop_before([travel_m - REPEAT_REACH_M for travel_m in latest_m])
        for queue in self._waiting.values():
            waiting = [c for c in queue if c.target in held and c.source in held]
            self.waiting_count += len(waiting) - len(queue)
            queue.clear()
            queue += waiting

    def next_closure(self) -> LoopClosure | None:
        """Verify the next candidate whose scans are here; None if the queues are empty.

        Missing scans are requested. Inside one map, candidates of a robot with a recent closure are dropped.
        """
        while self.waiting_count:
            candidate = next(filter(None, self._waiting.values())).popleft()
            self.waiting_count -= 1
            (target, _), (source, index) = candidate.target, candidate.source
            paths = self._graph.keyframes[target], self._graph.keyframes[source]
            is_one_map = self._maps.group_of[target] == self._maps.group_of[source]
            if is_one_map and self._has_recent_closure(self._graph.keyframe((source, index)), candidate.sign_m is None):
                continue
            if self._on_request and self._maps.ask_for(self._verifier.scans_needed(candidate, *paths)):
                self._awaiting_scans.append(candidate)
            else:
                closure = self._verifier.verify(candidate, *paths)
                if candidate.sign_m is None:
                    self._reject_if_fixed_by_robots(closure, *paths)
                return closure
        return None

    def _reject_if_fixed_by_robots(
        self, closure: LoopClosure, target_path: Sequence[Keyframe], source_path: Sequence[Keyframe]
    ) -> None:
        """Reject a closure without a sign if only objects that may be robots constrain it, as along a corridor."""
        if closure.status != "accepted" or closure.is_loose or not isinstance(self._verifier, LoopVerifier):
            return
        if not self._verifier.is_fixed_by_walls(closure, target_path, source_path, self._robot_width_m):
            closure.status, closure.reason = "rejected", "dependence on objects that may be robots"

    def scans_arrived(self) -> None:
        """Requested scans have arrived: put the candidates that waited for them at the front of their queues."""
        for candidate in reversed(self._awaiting_scans):
            self._waiting[candidate.recogniser].appendleft(candidate)
        self.waiting_count += len(self._awaiting_scans)
        self._awaiting_scans.clear()


def _is_new(maps: GroupMaps, earlier: ProposalFilter, target: Keyframe, source: Keyframe) -> bool:
    """Whether a pair of keyframes repeats no earlier one; the filter stores the pair."""
    is_one_map = maps.group_of[target.robot] == maps.group_of[source.robot]
    return earlier.is_new(target, source, REPEAT_REACH_M if is_one_map else REPEAT_REACH_APART_M)
