"""From new keyframes to measured closures: who looks alike, what was tried before, and whose turn it is."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig
from twc_env.geometry import between
from twc_env.messages import Keyframe, LoopCandidate, LoopClosure
from twc_env.slam.group_maps import GroupMaps
from twc_env.slam.loop_verification import LoopVerifier, SignVerifier
from twc_env.slam.meeting_recogniser import MEETING, MeetingRecogniser
from twc_env.slam.place_recognition import ProposalFilter, make_recogniser
from twc_env.slam.team_graph import TeamGraph
from twc_env.slam.text_wifi_recogniser import TextWifiRecogniser
from twc_env.slam.wayside_recognisers import SignlessRecogniser

REPEAT_REACH_M = 2.0
"""Proposals nearer than this, along both paths, to an earlier one of the same kind are not tried again ..."""
REPEAT_REACH_APART_M = 0.75
"""... while the two robots do not share a map yet, when every closure counts."""
PROXIMITY_PERIOD_M = 1.5
"""Path length between two searches for near keyframes."""
MATE_MARGIN_M = 0.1
"""Things wider than a robot by more are none."""
TIED_M = 3.0
"""Inside one map, a robot whose last closure is nearer than this along its path needs no other yet."""


class ClosureSearch:
    """Candidates wait in queues; each step verifies a few of them."""

    def __init__(self, config: EnvConfig, graph: TeamGraph, maps: GroupMaps, robot_count: int):
        self._rule, self._on_request = config.slam.place_recognition, config.link.scan_on_request
        self._graph, self._maps = graph, maps
        self._recogniser = make_recogniser(config.slam.place_recognition, config.lidar.range_max_m)
        self._asks_first = isinstance(self._recogniser, TextWifiRecogniser)
        """Whether it makes no candidate of what is not new."""
        self._filters = {name: ProposalFilter() for name in (self._recogniser.name, "wifi", MEETING, "proximity")}
        if isinstance(self._recogniser, TextWifiRecogniser):
            self._recogniser.is_wanted = partial(_is_new, maps, self._filters[self._recogniser.name])
        self._signless: SignlessRecogniser | None = None
        self._meetings: MeetingRecogniser | None = None
        if self._recogniser.name == "twc" and config.slam.cues.lidar:
            if self._rule.spares_missing_cues:
                self._signless = SignlessRecogniser(self._rule, config.lidar.range_max_m, robot_count)
            if self._rule.meets_by_wifi:
                self._meetings = MeetingRecogniser(self._rule, robot_count)
        self._verifier: LoopVerifier | SignVerifier = SignVerifier()
        if config.slam.cues.lidar:
            self._verifier = LoopVerifier(config.slam.verification, config.slam.odometry_filter, config.lidar)
        self._mate_width_m = 2 * config.dynamics.robot_radius_m + MATE_MARGIN_M
        self._waiting: dict[str, deque[LoopCandidate]] = {name: deque() for name in self._filters}
        self.waiting_count = 0
        """Candidates that may have their turn."""
        self._without_scans: list[LoopCandidate] = []
        self._searched_m = [0.0] * robot_count
        self._tied_for_m = TIED_M if config.slam.cues.lidar else 0.0
        """Path length after a closure on which none is needed; without laser each tells what odometry is off by."""
        self._tied_m = [-np.inf] * robot_count
        """Path length up to the last closure of each robot that was not loose ..."""
        self._loosely_tied_m = [-np.inf] * robot_count
        """... and up to the last one of any kind."""

    def propose(self, keyframe: Keyframe) -> None:
        """Queue what a new keyframe looks like."""
        is_tied, is_loosely_tied = self._is_tied(keyframe), self._is_tied(keyframe, loosely=True)
        mates = self._maps.groups[self._maps.group_of[keyframe.robot]].robots
        candidates = self._recogniser.propose(keyframe, mates if is_tied else ())
        new, candidates = (candidates, []) if self._asks_first else ([], candidates)
        if self._signless is not None:
            candidates += self._signless.propose(keyframe, mates if is_loosely_tied else ())
        if self._meetings is not None:
            candidates += self._meetings.propose(keyframe, mates)
        near = None if is_loosely_tied else self._near_keyframe(keyframe)
        if near is not None:
            candidates.append(near)
        for candidate in candidates:
            ends = self._graph.keyframe(candidate.target), self._graph.keyframe(candidate.source)
            if _is_new(self._maps, self._filters[candidate.recogniser], *ends):
                new.append(candidate)
        for candidate in new:
            self._waiting[candidate.recogniser].append(candidate)
            self.waiting_count += 1

    def _is_tied(self, keyframe: Keyframe, loosely: bool = False) -> bool:
        """Whether a closure already ties this part of its robot's path to the map; loosely: a loose one will do."""
        tied_m = self._loosely_tied_m if loosely else self._tied_m
        return keyframe.travel_m - tied_m[keyframe.robot] < self._tied_for_m

    def _near_keyframe(self, keyframe: Keyframe) -> LoopCandidate | None:
        """The nearest keyframe of the same map that the path alone does not tie to this one."""
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

    def note_tie(self, closure: LoopClosure) -> None:
        """A closure was accepted: its robots need no other for a while, or none of its kind where it is loose."""
        for key in (closure.candidate.target, closure.candidate.source):
            travel_m = self._graph.keyframe(key).travel_m
            for tied_m in (self._loosely_tied_m,) if closure.is_loose else (self._loosely_tied_m, self._tied_m):
                tied_m[key[0]] = max(tied_m[key[0]], travel_m)

    def untie(self, robots: tuple[int, ...]) -> None:
        """The ties of these robots hold no longer: look for others at once."""
        for robot in robots:
            self._tied_m[robot] = self._loosely_tied_m[robot] = -np.inf

    def forget(self, _: Array) -> None:
        """Keyframes have been forgotten: nothing is compared with them, and what they were tried with is no matter."""
        held = {keyframe.key for path in self._graph.keyframes for keyframe in path}
        for recogniser in (self._recogniser, self._signless, self._meetings):
            if recogniser is not None:
                recogniser.forget(lambda keyframe: keyframe.key in held)
        latest_m = [path[-1].travel_m if path else 0.0 for path in self._graph.keyframes]
        for tried in self._filters.values():
            tried.forget([travel_m - REPEAT_REACH_M for travel_m in latest_m])
        for queue in self._waiting.values():
            waiting = [c for c in queue if c.target in held and c.source in held]
            self.waiting_count += len(waiting) - len(queue)
            queue.clear()
            queue += waiting

    def next_closure(self) -> LoopClosure | None:
        """Verify the first candidate that is needed and whose scans are here; None when none waits.

        Missing scans are asked for. Inside one map a candidate is not needed once another closure ties its keyframe.
        """
        while self.waiting_count:
            candidate = next(filter(None, self._waiting.values())).popleft()
            self.waiting_count -= 1
            (target, _), (source, index) = candidate.target, candidate.source
            paths = self._graph.keyframes[target], self._graph.keyframes[source]
            is_one_map = self._maps.group_of[target] == self._maps.group_of[source]
            if is_one_map and self._is_tied(self._graph.keyframe((source, index)), candidate.sign_m is None):
                continue
            if self._on_request and self._maps.ask_for(self._verifier.compared(candidate, *paths)):
                self._without_scans.append(candidate)
            else:
                closure = self._verifier.verify(candidate, *paths)
                if candidate.sign_m is None:
                    self._doubt(closure, *paths)
                if self._meetings is not None and candidate.recogniser == MEETING:
                    self._meetings.note(closure)
                return closure
        return None

    def _doubt(self, closure: LoopClosure, target_path: Sequence[Keyframe], source_path: Sequence[Keyframe]) -> None:
        """Refuse a closure without a sign that only robots in the way hold in place, as along a corridor."""
        if closure.status != "accepted" or closure.is_loose or not isinstance(self._verifier, LoopVerifier):
            return
        if not self._verifier.rests_on_walls(closure, target_path, source_path, self._mate_width_m):
            closure.status, closure.reason = "rejected", "nothing but what may be robots fixes its place"

    def wake(self) -> None:
        """Scans have come: candidates that waited for them have their turn first."""
        for candidate in reversed(self._without_scans):
            self._waiting[candidate.recogniser].appendleft(candidate)
        self.waiting_count += len(self._without_scans)
        self._without_scans.clear()


def _is_new(maps: GroupMaps, earlier: ProposalFilter, target: Keyframe, source: Keyframe) -> bool:
    """Whether no earlier proposal of the same kind is repeated; notes this one."""
    is_one_map = maps.group_of[target.robot] == maps.group_of[source.robot]
    return earlier.is_new(target, source, REPEAT_REACH_M if is_one_map else REPEAT_REACH_APART_M)
