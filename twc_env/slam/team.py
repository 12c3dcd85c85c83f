"""One mapper of the team. Input: keyframes of all robots; output: merged maps and corrected poses."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig
from twc_env.errors import DataError, TwcError
from twc_env.records.geometry import between
from twc_env.records.lasting_map import LastingMap
from twc_env.records.messages import (
    LOOSE_M,
    GridMap,
    Keyframe,
    LoopCandidate,
    LoopClosure,
    MergeHypothesis,
    RadioTrail,
)
from twc_env.records.team_messages import KnownSigns
from twc_env.slam.mapping.closure_search import ClosureSearch
from twc_env.slam.mapping.group_maps import Group, GroupMaps
from twc_env.slam.mapping.keyframe_sparsification import KeyframeSparsification
from twc_env.slam.mapping.map_saving import keyframes_of, saved_map
from twc_env.slam.mapping.segments import Segments
from twc_env.slam.mapping.team_graph import TeamGraph
from twc_env.slam.merging.map_optimiser import MapOptimiser
from twc_env.slam.merging.merge_hypotheses import merge_hypotheses
from twc_env.slam.merging.merge_review import MergeReview
from twc_env.slam.merging.merge_tests import WALLS_SLACK, MergeTests
from twc_env.slam.merging.merge_trial import MergeTrials
from twc_env.slam.merging.mutual_observations import MutualObservations
from twc_env.slam.merging.rival_maps import rival_votes
from twc_env.slam.radio.radio_constraints import RadioConstraints

URGENT_SQUARED_ERROR = 1.0
"""A closure whose squared error in the present estimate is below this is not urgent."""
DRIFT_BASE_M, DRIFT_PER_M, DRIFT_RAD = 0.8, 0.03, 0.35
"""Maximum deviation of an intra-map closure from the present estimate."""
ALONE = "moves the map, and no other closure says so yet"
"""Reason for which a closure without a sign is refused that would move the map by more than LOOSE_M: along corridors
and with poor scans, one such match alone is false too often."""
RETRY_SHARE = 16
"""After a failed merge attempt, the number of closures must grow by one in this many before the next one."""
BACKLOG_SHARE = 32
"""Of many queued candidates, one in this many is verified per step, so that the queue does not grow without bound."""
RETRY_STEPS = 50
"""Interval at which merges without sufficient evidence are retried, whether or not closures arrived."""
OVERLAP_REACH_M = 5.0
"""With scans on request, scans of keyframes this near the other group's are requested before a merge."""


class TeamMapper:
    """Place recognition, loop closure, map merging and joint optimisation over the keyframes of all robots.

    `home` is the robot that runs this mapper, whose scans are available at once; None for the single central mapper.
    """

    prior: int | None = None
    """The segment that stands for a map of an earlier session, if there is one (see `TeamGraph.prior`) ..."""
    _lasting: LastingMap | None = None
    """... and that map."""

    def __init__(self, config: EnvConfig, robot_count: int, home: int | None = None, prior: LastingMap | None = None):
        self._config, self._on_request = config.slam, config.link.scan_on_request
        self._turns, self._turn = (1, 0) if home is None else (robot_count, home)
        """Mappers take turns: only one per step re-evaluates merges and does the expensive work of large maps."""
        scale_std = None if config.slam.cues.lidar else config.slam.odometry_filter.odometry_scale_std
        keeps_refused = config.slam.pose_graph.robust == "ours"
        self._graph = TeamGraph(robot_count, config.lidar.circle_beam_count, keeps_refused, scale_std)
        self._maps = GroupMaps(config, self._graph, home, robot_count)
        self.groups: list[Group] = self._maps.groups
        """Groups of robots that share a map."""
        self.keyframes: list[list[Keyframe]] = self._graph.keyframes
        """Per robot, keyframes that have arrived and were not removed."""
        self.closures: list[LoopClosure] = self._graph.closures
        """Verified closures with their status, except those between removed keyframes."""
        self.wanted: Collection[tuple[int, int]] = self._maps.wanted
        """(robot, keyframe index) of scans to request."""
        self._search = ClosureSearch(config, self._graph, self._maps, robot_count)
        self.segments = Segments(robot_count)
        """Parts of the robots' paths between which they were carried. Inside the mapper, each is a robot of its own:
        `groups`, `keyframes`, `closures` and `nodes` number segments instead of robots."""
        places = config.slam.place_recognition
        mutual_observations = MutualObservations(config, self._graph, self._maps, self.segments)
        self._tests = MergeTests(config.slam.merging, self._graph, places.spares_missing_cues, mutual_observations)
        self._review = MergeReview(config.slam.merging, self._graph, self._maps, self._tests)
        radio = config.slam.radio_slam
        self._radio = RadioConstraints(radio, robot_count, config.slam.cues.lidar) if radio.online else None
        sparsification = None
        if self._radio is None and not self._on_request:  # both need all keyframes later
            sparsification = KeyframeSparsification(self._graph, (self._search, self._tests, self._maps))
        self._trials = None if config.slam.cues.lidar else MergeTrials(config.slam.pose_graph, self._graph)
        self.optimiser = MapOptimiser(
            config.slam.pose_graph, self._graph, self._maps, self._tests, self._radio, sparsification
        )
        """Schedules the optimisation of the groups' maps."""
        self._tried_counts: dict[tuple[tuple[int, ...], tuple[int, ...]], int] = {}
        """Two groups, by their robots -> number of closures between them at the last failed merge attempt."""
        self._uncertain: set[tuple[tuple[int, ...], tuple[int, ...]]] = set()
        """Two groups whose closures agree but do not determine the relative pose; retried every RETRY_STEPS."""
        self._seeks_closures = config.slam.oracle != "poses"
        self._given_starts: Array | None = None
        self._step = self._last_retried_step = 0
        self._due_step: float = 0
        self._idle_changes = -1
        """Without new messages there is nothing to do before `_due_step` while `TeamGraph.changes` has this value."""
        self._signs: dict[tuple[int, ...], tuple[tuple[int, int], KnownSigns]] = {}
        self._hypotheses: tuple[tuple[int, ...], dict[int, tuple[MergeHypothesis, ...]]] = (), {}
        """Cache of `hypotheses_of` for one state of graph and groups ..."""
        self._radio_trails: tuple[tuple[int, ...], list[RadioTrail]] = (), []
        """... and of `radio_trails_of`: one for each group."""
        if prior is not None:
            self._lasting, self.prior = prior, self._take_in(prior)

    def _take_in(self, prior: LastingMap) -> int:
        """Make a map of an earlier session a member of the team, in a frame of its own; returns its segment."""
        segment = self._graph.prior = self.segments.add_prior()
        for part in (self._graph, self._maps, self._search):
            part.add_robot()
        for keyframe in keyframes_of(prior, segment):
            self._graph.add_keyframe(keyframe)
            self._search.learn(keyframe)
        self._graph.place(self._graph.path_of(segment), prior.poses)
        self._maps.add_prior(segment, prior.grid)
        return segment

    def lasting_map(self) -> LastingMap:
        """The map to save: that of the prior map's group, or of the group with most keyframes. Raises DataError without
        keyframes."""
        number = self._saved_group
        robots = self.groups[number].robots
        if self._lasting is not None and len(robots) == 1:
            return self._lasting  # no robot has found it: nothing is known to have changed
        if len(self._graph.nodes_of(robots)) == 0:
            raise DataError("there is no map to save: no robot has taken a keyframe")
        return saved_map(self._graph, robots, self.grid_of(number), self._maps.range_max_m, self._lasting)

    @property
    def unsaved_robots(self) -> tuple[int, ...]:
        """Robots whose present map is not the one that `lasting_map` gives."""
        is_saved = [self.group_index(robot) == self._saved_group for robot in range(len(self.segments.current))]
        return tuple(np.flatnonzero(~np.array(is_saved)).tolist())

    @property
    def _saved_group(self) -> int:
        """Index into `groups` of the group whose map `lasting_map` gives."""
        if self.prior is not None:
            return self.group_of_segment(self.prior)
        return int(np.argmax([len(self._graph.nodes_of(group.robots)) for group in self.groups]))

    def update(self, step: int, keyframes: Sequence[Keyframe], scans: Sequence[tuple[int, int]] = ()) -> bool:
        """Add keyframes and requested scans; verify, merge and optimise within this step's budget.

        Returns whether there was anything to do.
        """
        if step < self._due_step and self._graph.changes == self._idle_changes and not keyframes and not scans:
            self._step = step
            return False
        if scans:
            self._maps.receive(scans)
            self._search.scans_arrived()
        for received in keyframes:
            keyframe = self._as_segment(received)
            self._maps.add(keyframe, self._graph.add_keyframe(keyframe))
            if self._graph.learn_scale(keyframe):
                self.optimiser.mark_dirty(self._maps.group_of[keyframe.robot], True)
            if self._seeks_closures:
                self._search.propose(keyframe)
            if self._radio is not None and self._radio.add(keyframe):
                self.optimiser.mark_dirty(self._maps.group_of[keyframe.robot], True)
        if self._given_starts is not None:
            self._merge_given(self._given_starts)
        self._step = step
        if self._search.waiting_count:
            backlog = max(self._config.verification.backlog_per_step, self._search.waiting_count // BACKLOG_SHARE)
            for _ in range(backlog):
                if not self._verify_one():
                    break
        is_turn = step % self._turns == self._turn
        if is_turn and step >= self._review.due_step and self._given_starts is None:
            self._undo_wrong_merge()
        is_turn = is_turn or not self.optimiser.is_map_large
        if step - self._last_retried_step >= RETRY_STEPS or (scans and not self.wanted):
            self._last_retried_step = step
            if self._trials is not None and self._given_starts is None:
                self._split_uncertain(self._trials)
            self._retry_merges()
        if is_turn and self.optimiser.may_remove:
            self.optimiser.sparsify()
        elif is_turn and step >= self.optimiser.due_step:
            self.optimiser.optimise_dirty(step)
        self._graph.end_step()
        self._due_step, self._idle_changes = self._next_due_step(), self._graph.changes
        return True

    def _as_segment(self, keyframe: Keyframe) -> Keyframe:
        """The keyframe as one of its robot's present segment, which may begin with it.

        Radio SLAM, scans on request and oracles know no segments: there, the path of a carried robot goes on.
        """
        has_segments = self._radio is None and not self._on_request and self._seeks_closures
        if keyframe.begins_segment and has_segments and self._given_starts is None:
            self.segments.begin(keyframe)
            for part in (self._graph, self._maps, self._search):
                part.add_robot()
        return self.segments.numbered(keyframe)

    def _next_due_step(self) -> float:
        """The first step with anything to do if no message arrives."""
        if self._search.waiting_count or self._given_starts is not None or self.optimiser.may_remove:
            return self._step + 1
        return min(self._review.due_step, self._last_retried_step + RETRY_STEPS, self.optimiser.due_step)

    def give_starts(self, poses: Array) -> None:
        """Oracle for comparison: set the start poses of all robots (robots, 3), in any common frame."""
        self._given_starts, self._idle_changes = poses, -1

    def finish(self) -> None:
        """Process all queued work (end of an episode or log)."""
        while self._verify_one():
            pass
        self._retry_merges()
        self.optimiser.finish()
        self._idle_changes = -1

    @property
    def regroupings(self) -> int:
        """Counter of merges and splits."""
        return self._maps.regroupings

    def counts(self) -> tuple[int, int, int, int]:
        """Change counters: keyframes added, poses moved or closures evaluated; merges and splits; maps redrawn or
        grown; sign texts read that may change the known signs."""
        return self._graph.changes, self._maps.regroupings, self._maps.changes, sum(self._graph.sign_news)

    @property
    def merges_undone(self) -> int:
        """Number of merges found wrong and undone."""
        return self._review.undone_count

    def group_index(self, robot: int) -> int:
        """Index into `groups` of the robot's group."""
        return self._maps.group_of[self.segments.current[robot]]

    def group_of_segment(self, segment: int) -> int:
        """Index into `groups` of the group that has this part of a robot's path."""
        return self._maps.group_of[segment]

    def poses_of(self, robot: int) -> Array:
        """(keyframes, 3) poses of one robot in its group's map frame, including removed keyframes; of a carried robot,
        each in the map of the group that has that segment. Raises TwcError for an unknown robot."""
        return np.concatenate([self._graph.poses_of(segment) for segment in self.segments.of(robot)])

    def segment_path(self, segment: int) -> tuple[Array, Array]:
        """Poses (keyframes, 3) and steps (keyframes,) of the keyframes of one segment, including removed ones."""
        return self._graph.poses_of(segment), self._graph.steps_of(segment)

    @property
    def nodes(self) -> tuple[Array, Array, Array, Array]:
        """All keyframes held, in order of arrival: poses (n, 3) in their groups' map frames, and steps (n,).

        Then node indices per robot (robots, k) and how many of each row are valid (robots,).
        """
        graph = self._graph
        return graph.poses, graph.step_of_node, *graph.paths

    def latest_pose_of(self, robot: int) -> Array:
        """(3,) pose of the robot's newest keyframe in its group's map frame; IndexError without one."""
        return self._graph.latest_pose_of(self.segments.current[robot])

    def keyframe_steps(self, robot: int) -> Array:
        """(keyframes,) step at which each was taken."""
        return np.concatenate([self._graph.steps_of(segment) for segment in self.segments.of(robot)])

    def scans_of(self, robot: int) -> tuple[Array, list[Array]]:
        """Steps (k,) and scans (beams,) [m] of the keyframes held."""
        own = self.segments.of(robot)
        steps = np.concatenate([self._graph.step_of_node[self._graph.path_of(segment)] for segment in own])
        return steps, [scan for segment in own for scan in self._graph.scans_of(segment)]

    def votes_in(self, robots: tuple[int, ...]) -> tuple[int, int]:
        """Numbers of verified closures among robots of one map that agree with it, and that contradict it; loose ones
        fit anywhere along a corridor and do not count."""
        agree, contradict = (
            sum(not closure.is_loose for closure in self._graph.closures_between(robots, robots, status))
            for status in ("accepted", "rejected")
        )
        return agree, contradict

    def rival_votes_in(self, robots: tuple[int, ...]) -> dict[tuple[int, int], tuple[int, int]]:
        """See `rival_maps.rival_votes`."""
        return rival_votes(self._graph, robots)

    @property
    def closures_verified(self) -> int:
        """Number of closures verified, including those of removed keyframes."""
        return self._graph.closures_verified

    def pose_map_odom(self, robot: int) -> Array:
        """(3,) pose of the robot's odom frame in its group's map frame; identity for a robot without keyframes."""
        return self._graph.pose_map_odom(self.segments.current[robot])

    def locate(self, robots: Array, into: tuple[Array, Array, Array]) -> None:
        """Poses of robots in the maps of their groups, see `GraphArrays.locate`."""
        if self.segments.is_whole:
            self._graph.locate(robots, into)
            return
        latest, count = self.segments.latest(robots), len(self.segments.owners)
        found = np.empty((count, 3)), np.empty((count, 3)), np.empty(count)
        self._graph.locate(latest, found)
        for rows, of_segments in zip(into, found, strict=True):
            rows[robots] = of_segments[latest]

    def grid_of(self, group: int) -> GridMap:
        """The current merged map of a group. Raises TwcError for an unknown group."""
        if not (isinstance(group, (int, np.integer)) and 0 <= group < len(self.groups)):
            raise TwcError(f"groups are 0 to {len(self.groups) - 1}; got {group!r}")
        return self.groups[group].grid.snapshot()

    def signs_of(self, group: int) -> KnownSigns:
        """The sign texts read by a group, each once per place."""
        robots, version = self.groups[group].robots, self.groups[group].version
        news = self._graph.sign_news
        key = (sum([news[r] for r in robots]), version) if len(robots) > 1 else (news[robots[0]], version)
        held = self._signs.get(robots)
        if held is None or held[0] != key:
            held = self._signs[robots] = (key, self._graph.signs(robots))
        return held[1]

    def hypotheses_of(self, group: int) -> tuple[MergeHypothesis, ...]:
        """How the maps of other groups may lie in that of a group, by closures that do not suffice to merge them."""
        key = self._graph.changes, self._graph.closures_verified, self._maps.regroupings
        if self._hypotheses[0] != key:
            self._hypotheses = key, {}
        held = self._hypotheses[1]
        if group not in held:
            held[group] = merge_hypotheses(self._graph, self.groups, group)
        return held[group]

    def radio_trails_of(self, group: int) -> tuple[RadioTrail, ...]:
        """What this group and then the others have heard of access points; without groups that have no keyframes."""
        key = self._graph.changes, self._maps.regroupings
        if self._radio_trails[0] != key:
            self._radio_trails = key, [self._radio_trail(each.robots) for each in self.groups]
        trails = self._radio_trails[1]
        return trails[group], *(one for k, one in enumerate(trails) if k != group and len(one.fingerprints))

    def _radio_trail(self, segments: tuple[int, ...]) -> RadioTrail:
        keyframes = [keyframe for segment in segments for keyframe in self._graph.keyframes[segment]]
        nodes = [self._graph.path_of(segment) for segment in segments]
        fingerprints = tuple([keyframe.fingerprint for keyframe in keyframes])
        return RadioTrail(self.segments.robots_in(segments), self._graph.poses[np.concatenate(nodes), :2], fingerprints)

    def graph(self) -> dict[str, Array | list[str]]:
        """The pose graph as arrays: nodes, node_ids, edges_ij, edges_z, edges_information, edges_kind.

        And of each keyframe node_robots (k, 2), its robot (-1: a map of an earlier session) and the index among that
        one's keyframes; node_steps (k,) and node_times_s (k,), by the robot's own frames.
        """
        graph = self._graph.as_arrays()
        return graph | {"node_robots": self.segments.of_robots(np.asarray(graph["node_ids"]))}

    # --- closures ---

    def _verify_one(self) -> bool:
        """Verify one queued candidate and process the closure; False if the queue is empty."""
        closure = self._search.next_closure()
        if closure is None:
            return False
        self._graph.add_closure(closure)
        if closure.status == "accepted":
            a, b = sorted(self._groups_of(closure))
            if a == b:
                self._test_inside_map(closure)
            else:
                self._graph.set_pending([closure])
                self._try_merge(a, b, is_patient=True)
        return True

    def _groups_of(self, closure: LoopClosure) -> tuple[int, int]:
        group_of, candidate = self._maps.group_of, closure.candidate
        return group_of[candidate.target[0]], group_of[candidate.source[0]]

    def _test_inside_map(self, closure: LoopClosure) -> None:
        """Accept a closure within one map unless it deviates from the estimate by more than drift explains."""
        away, turned, squared = self._graph.disagreement(closure)
        travel = self._travel_between(closure.candidate)
        if away > DRIFT_BASE_M + DRIFT_PER_M * travel or turned > DRIFT_RAD:
            self._graph.refuse(closure, f"{away:.1f} m and {turned:.2f} rad from the estimate")
            return
        confirmed = [closure]
        if away > LOOSE_M and closure.candidate.sign_m is None and not closure.is_loose:
            alone = [c for c in self._graph.rejected_beside(closure) if c.reason == ALONE]
            confirmed += self._tests.agreeing_with(closure, alone)
            if len(confirmed) == 1:
                self._graph.refuse(closure, ALONE)
                return
        for one in confirmed:
            self._graph.accept(one)
            self._search.note_accepted(one)
        self.optimiser.mark_dirty(self._groups_of(closure)[0], squared > URGENT_SQUARED_ERROR)

    def _travel_between(self, candidate: LoopCandidate) -> float:
        """Path length [m] for the drift bound: between keyframes of one robot; a constant for two robots."""
        (target, _), (source, _) = candidate.target, candidate.source
        if target == source:
            first, last = self._graph.keyframe(candidate.target), self._graph.keyframe(candidate.source)
            return min(abs(last.travel_m - first.travel_m), 40.0)
        return 20.0

    # --- merging ---

    def _try_merge(self, a: int, b: int, is_patient: bool = False) -> bool:
        """Merge group b into the map of group a if all tests pass; returns whether it was done.

        is_patient: skip the attempt unless enough closures have been added since the last one.
        """
        if not self._config.merging.enabled:
            return False
        if self.prior is not None and self.group_of_segment(self.prior) == b:
            a, b = b, a  # into the frame of the prior map
        robots_a, robots_b = self.groups[a].robots, self.groups[b].robots
        pending = self._graph.waiting.between(robots_a, robots_b)
        before = self._tried_counts.get((robots_a, robots_b), 0)
        if is_patient and before < len(pending) < before + before // RETRY_SHARE:
            return False
        if is_patient and (robots_a, robots_b) in self._uncertain:
            return False
        self._tried_counts[robots_a, robots_b] = len(pending)
        proposal = self._tests.proposal(pending, robots_a) or self._tests.observed_proposal(
            pending[-1:] if is_patient else pending, robots_a, robots_b
        )
        if proposal is None:
            return False
        if proposal.support.sum() < self._review.closures_needed(robots_a, robots_b, proposal):
            return False
        if not self._tests.cues_confirm(robots_a, robots_b, proposal):
            return False
        proposal = self._tests.most_observed(robots_a, robots_b, proposal, pending)
        pose_a_b = proposal.pose_a_b
        if self._tests.signs_disagree(robots_a, robots_b, pose_a_b):
            return False
        if self._on_request and self._maps.ask_for(self._tests.overlap(robots_a, robots_b, pose_a_b, OVERLAP_REACH_M)):
            return False
        if self._tests.mutual_observations_contradict(robots_a, robots_b, pose_a_b):
            return False
        grids = self._maps.known_grid(robots_a, a), self._maps.known_grid(robots_b, b)
        if self._tests.walls_disagree(*grids, pose_a_b, 1.0 if self.prior not in robots_a else WALLS_SLACK):
            return False
        tried = None if self._trials is None else self._trials.merged(robots_a, robots_b, proposal)
        if self._trials is not None and tried is None:
            self._uncertain.add((robots_a, robots_b))
            return False
        self._maps.merge(a, b, pose_a_b)
        if tried is not None:
            self._graph.place(*tried)
        self.optimiser.reset_fixed()
        self._review.record_merge(robots_a, robots_b, self._step)
        merged = self._maps.group_of[robots_a[0]]
        self.optimiser.mark_dirty(merged, True)
        for closure in pending:
            self._test_inside_map(closure)
        self.optimiser.optimise(merged, is_thorough=self._trials is not None)
        return True

    def _merge_given(self, starts: Array) -> None:
        """Merge all groups that have keyframes, by the given start poses. A group's frame is its first robot's
        start."""
        known = [g for g, group in enumerate(self.groups) if any(self.keyframes[r] for r in group.robots)]
        for b in reversed(known[1:]):
            first, second = self.groups[known[0]].robots[0], self.groups[b].robots[0]
            self._maps.merge(known[0], b, between(starts[first], starts[second]))

    def _retry_merges(self) -> None:
        """Try to merge all groups with pending closures, since new keyframes, walls or merges may be sufficient
        evidence."""
        while True:
            pairs = {tuple(sorted(map(self.group_of_segment, robots))) for robots in self._graph.waiting.pairs()}
            if not any(self._try_merge(a, b) for a, b in sorted(pairs)):
                return

    def _undo_wrong_merge(self) -> None:
        """Undo a merge found wrong and split its group. Its accepted closures are rejected and do not vote again."""
        found = self._review.wrong(self._step, self.optimiser.is_map_large)
        if found is None:
            return
        merge, why = found
        a, b = self._review.sides(merge)
        rivals = self._graph.closures_between(a, b, "rejected")
        for closure in self._graph.closures_between(a, b, "accepted"):
            self._graph.refuse(closure, f"the merge it spoke for was undone: {why}")
        self._graph.set_pending(rivals)
        self._review.record_undone(merge, (a, b))
        self._split_group(a, b)
        self._retry_merges()

    def _split_uncertain(self, trials: MergeTrials) -> None:
        """Split groups whose relative poses have become too uncertain since their last closures.

        The closures become pending; together with new ones they may support a merge again.
        """
        for robots in [group.robots for group in self.groups if len(group.robots) > 1]:
            sides = trials.uncertain_split(robots)
            if sides is None:
                continue
            closures = self._graph.closures_between(*sides, "accepted")
            for closure in closures:
                self._graph.refuse(closure, "the relative pose of its robots became too uncertain")
            self._graph.set_pending(closures)
            self._review.split(sides)
            self._split_group(*sides)

    def _split_group(self, a: tuple[int, ...], b: tuple[int, ...]) -> None:
        """Split a group into two, each with a map of its own."""
        self._maps.split(self._maps.group_of[a[0]], (a, b))
        self.optimiser.reset_fixed()
        self._search.drop_closures_of(a + b)
        for side in (a, b):
            self.optimiser.optimise(self._maps.group_of[side[0]])
