"""One mapper of the team: keyframes of all robots in, merged maps and corrected poses out."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig
from twc_env.geometry import between
from twc_env.messages import GridMap, Keyframe, LoopCandidate, LoopClosure
from twc_env.slam.closure_search import ClosureSearch
from twc_env.slam.forgetting import Forgetting
from twc_env.slam.group_maps import Group, GroupMaps
from twc_env.slam.map_optimiser import MapOptimiser
from twc_env.slam.merge_judge import MergeJudge
from twc_env.slam.merge_review import MergeReview
from twc_env.slam.merge_trial import MergeTrials
from twc_env.slam.radio_ties import RadioTies
from twc_env.slam.team_graph import TeamGraph
from twc_env.team_messages import KnownSigns

URGENT_SQUARED_ERROR = 1.0
"""A closure that the estimate already meets this well is not urgent."""
DRIFT_BASE_M, DRIFT_PER_M, DRIFT_RAD = 0.8, 0.03, 0.35
"""A closure inside one map may disagree with the present estimate by this much."""
MORE_PART = 16
"""Of the closures between two maps that were no case for a merge, this part must come anew for another try."""
BACKLOG_PART = 32
"""Of many candidates that wait this part is verified in a step, so that they do not become ever more."""
RETRY_STEPS = 50
"""Merges that lacked evidence are tried again this often, whether or not another closure came."""
OVERLAP_REACH_M = 5.0
"""Where scans come on request, keyframes this near the other group's are asked for theirs before a merge."""


class TeamMapper:
    """Place recognition, loop closure, map merging and joint optimisation over the keyframes of all robots.

    `home` is the robot it runs on, whose scans it has at once; None for the one mapper of a central topology.
    """

    def __init__(self, config: EnvConfig, robot_count: int, home: int | None = None):
        self._config, self._on_request = config.slam, config.link.scan_on_request
        self._turns, self._turn = (1, 0) if home is None else (robot_count, home)
        """Of so many steps the one in which this mapper, and no other, has second thoughts about merges and does what
        takes long with large maps."""
        scale_std = None if config.slam.cues.lidar else config.slam.odometry_filter.odometry_scale_std
        keeps_refused = config.slam.pose_graph.robust == "ours"
        self._graph = TeamGraph(robot_count, config.lidar.beam_count, keeps_refused, scale_std)
        self._maps = GroupMaps(config, self._graph, home, robot_count)
        self.groups: list[Group] = self._maps.groups
        """Robots that share a map."""
        self.keyframes: list[list[Keyframe]] = self._graph.keyframes
        """Of each robot, as far as they have arrived and are not forgotten."""
        self.closures: list[LoopClosure] = self._graph.closures
        """The closures that were verified, with what became of them, but those between keyframes that are forgotten."""
        self.wanted: Collection[tuple[int, int]] = self._maps.wanted
        """(robot, keyframe index) of scans to ask for, as they are now."""
        self._search = ClosureSearch(config, self._graph, self._maps, robot_count)
        places = config.slam.place_recognition
        self._judge = MergeJudge(config.slam.merging, self._graph, places.spares_missing_cues, places.meets_by_wifi)
        self._review = MergeReview(config.slam.merging, self._graph, self._maps, self._judge)
        radio = config.slam.radio_slam
        self._radio = RadioTies(radio, robot_count, config.slam.cues.lidar) if radio.online else None
        forgetting = None
        if self._radio is None and not self._on_request:  # else something looks back at all keyframes
            forgetting = Forgetting(self._graph, (self._search, self._judge, self._maps))
        self._trials = None if config.slam.cues.lidar else MergeTrials(config.slam.pose_graph, self._graph)
        self.optimiser = MapOptimiser(
            config.slam.pose_graph, self._graph, self._maps, self._judge, self._radio, forgetting
        )
        """When the maps of groups are optimised, and how much of them."""
        self._no_case: dict[tuple[tuple[int, ...], tuple[int, ...]], int] = {}
        """Two groups, by their robots, and how many closures between them were no case for a merge when last tried."""
        self._unplaced: set[tuple[tuple[int, ...], tuple[int, ...]]] = set()
        """Two groups whose closures agreed and did not fix where their robots lie: tried again from time to time."""
        self._seeks_closures = config.slam.oracle != "poses"
        self._given_starts: Array | None = None
        self._step = self._last_retried_step = 0
        self._due_step: float = 0
        self._settled = -1
        """Before this step, and while the graph has changed so often, there is nothing to do if nothing arrives."""
        self._signs: dict[tuple[int, ...], tuple[tuple[int, int], KnownSigns]] = {}

    def update(self, step: int, keyframes: Sequence[Keyframe], scans: Sequence[tuple[int, int]] = ()) -> bool:
        """Take in keyframes and wanted scans; verify, merge and optimise as far as this step's budget goes.

        Whether there was anything to do.
        """
        if step < self._due_step and self._graph.changes == self._settled and not keyframes and not scans:
            self._step = step
            return False
        if scans:
            self._maps.receive(scans)
            self._search.scans_arrived()
        for keyframe in keyframes:
            self._maps.add(keyframe, self._graph.add_keyframe(keyframe))
            if self._graph.learn_scale(keyframe):
                self.optimiser.soil(self.group_index(keyframe.robot), True)
            if self._seeks_closures:
                self._search.propose(keyframe)
            if self._radio is not None and self._radio.add(keyframe):
                self.optimiser.soil(self.group_index(keyframe.robot), True)
        if self._given_starts is not None:
            self._merge_given(self._given_starts)
        self._step = step
        if self._search.waiting_count:
            backlog = max(self._config.verification.backlog_per_step, self._search.waiting_count // BACKLOG_PART)
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
                self._part_strayed(self._trials)
            self._retry_merges()
        if is_turn and self.optimiser.may_forget:
            self.optimiser.forget()
        elif is_turn and step >= self.optimiser.due_step:
            self.optimiser.optimise_soiled(step)
        self._graph.end_step()
        self._due_step, self._settled = self._next_due_step(), self._graph.changes
        return True

    def _next_due_step(self) -> float:
        """The first step with anything to do even if nothing arrives."""
        if self._search.waiting_count or self._given_starts is not None or self.optimiser.may_forget:
            return self._step + 1
        return min(self._review.due_step, self._last_retried_step + RETRY_STEPS, self.optimiser.due_step)

    def give_starts(self, poses: Array) -> None:
        """Tell the mapper where all robots started (robots, 3), in any one frame: an oracle, for comparison only."""
        self._given_starts, self._settled = poses, -1

    def finish(self) -> None:
        """Work off everything that still waits (end of an episode or log)."""
        while self._verify_one():
            pass
        self._retry_merges()
        self.optimiser.finish()
        self._settled = -1

    @property
    def regroupings(self) -> int:
        """Grows whenever robots come to share a map or no longer do."""
        return self._maps.regroupings

    def counts(self) -> tuple[int, int, int, int]:
        """How often a keyframe arrived, poses moved or a closure was judged; robots came together or fell apart; a map
        came to lie elsewhere or was drawn anew; a text was read that may change what signs are known."""
        return self._graph.changes, self._maps.regroupings, self._maps.changes, sum(self._graph.sign_news)

    @property
    def merges_undone(self) -> int:
        """How many merges turned out to be wrong and were taken back."""
        return self._review.undone_count

    def group_index(self, robot: int) -> int:
        """Which of `groups` the robot belongs to."""
        return self._maps.group_of[robot]

    def poses_of(self, robot: int) -> Array:
        """(keyframes, 3) of one robot in its group's map frame, with those that are forgotten."""
        return self._graph.poses_of(robot)

    @property
    def nodes(self) -> tuple[Array, Array, Array, Array]:
        """Of all keyframes as they arrived: poses (n, 3) in the maps of their groups, and steps (n,). Then, of each
        robot, which of them are its own (robots, k), of which that many (robots,) count.

        Of a map that has become large without those that are forgotten.
        """
        graph = self._graph
        return graph.poses, graph.step_of_node, *graph.paths

    def latest_pose_of(self, robot: int) -> Array:
        """(3,) of the robot's newest keyframe in its group's map frame."""
        return self._graph.latest_pose_of(robot)

    def keyframe_steps(self, robot: int) -> Array:
        """(keyframes,) the step at which each was taken."""
        return self._graph.steps_of(robot)

    def scans_of(self, robot: int) -> tuple[Array, list[Array]]:
        """Steps (k,) and scans (beams,) [m] of the keyframes that are held."""
        return self._graph.step_of_node[self._graph.path_of(robot)], self._graph.scans_of(robot)

    @property
    def closures_verified(self) -> int:
        """How many closures were verified, with those that are forgotten."""
        return self._graph.closures_verified

    def pose_map_odom(self, robot: int) -> Array:
        """(3,) where the robot's odom frame lies in its group's map; a robot without keyframes is its own map."""
        return self._graph.pose_map_odom(robot)

    def locate(self, robots: Array, others: Array, into: tuple[Array, Array, Array, Array]) -> None:
        """Where some robots are in the maps of their groups, see `GraphArrays.locate`."""
        self._graph.locate(robots, others, into)

    def grid_of(self, group: int) -> GridMap:
        """The merged map of a group, as it is now."""
        return self.groups[group].grid.snapshot()

    def known_box_of(self, group: int) -> tuple[int, int, int, int]:
        """First row and column, end row and column of the part of a group's map in which anything is known."""
        return self.groups[group].grid.known_box()

    def signs_of(self, group: int) -> KnownSigns:
        """The texts read by a group, each once per place."""
        robots, version = self.groups[group].robots, self.groups[group].version
        news = self._graph.sign_news
        key = (sum([news[r] for r in robots]), version) if len(robots) > 1 else (news[robots[0]], version)
        held = self._signs.get(robots)
        if held is None or held[0] != key:
            held = self._signs[robots] = (key, self._graph.signs(robots))
        return held[1]

    def graph(self) -> dict[str, Array | list[str]]:
        """The pose graph as arrays: nodes, node_ids, edges_ij, edges_z, edges_information, edges_kind."""
        return self._graph.as_arrays()

    # --- closures ---

    def _verify_one(self) -> bool:
        """Verify one candidate and act on it; False when none waits."""
        closure = self._search.next_closure()
        if closure is None:
            return False
        self._graph.add_closure(closure)
        if closure.status == "accepted":
            a, b = sorted(self._groups_of(closure))
            if a == b:
                self._judge_inside_map(closure)
            else:
                self._graph.let_wait([closure])
                self._try_merge(a, b, is_patient=True)
        return True

    def _groups_of(self, closure: LoopClosure) -> tuple[int, int]:
        return self.group_index(closure.candidate.target[0]), self.group_index(closure.candidate.source[0])

    def _judge_inside_map(self, closure: LoopClosure) -> None:
        """Take a closure of one map unless it contradicts the estimate by more than drift can explain."""
        away, turned, squared = self._graph.disagreement(closure)
        travel = self._travel_between(closure.candidate)
        if away > DRIFT_BASE_M + DRIFT_PER_M * travel or turned > DRIFT_RAD:
            self._graph.refuse(closure, f"{away:.1f} m and {turned:.2f} rad from the estimate")
            return
        self._graph.accept(closure)
        self._search.note_accepted(closure)
        self.optimiser.soil(self._groups_of(closure)[0], squared > URGENT_SQUARED_ERROR)

    def _travel_between(self, candidate: LoopCandidate) -> float:
        """Path length over which drift could have gathered: between the keyframes, or since the robots' last tie."""
        (target, _), (source, _) = candidate.target, candidate.source
        if target == source:
            first, last = self._graph.keyframe(candidate.target), self._graph.keyframe(candidate.source)
            return min(abs(last.travel_m - first.travel_m), 40.0)
        return 20.0

    # --- merging ---

    def _try_merge(self, a: int, b: int, is_patient: bool = False) -> bool:
        """Put group b into the map of group a if enough speaks for it and nothing against; whether it was done.

        When `is_patient`, nothing is asked before enough closures have come since the last try.
        """
        if not self._config.merging.enabled:
            return False
        robots_a, robots_b = self.groups[a].robots, self.groups[b].robots
        pending = self._graph.waiting.between(robots_a, robots_b)
        tried = self._no_case.get((robots_a, robots_b), 0)
        if is_patient and tried < len(pending) < tried + tried // MORE_PART:
            return False
        if is_patient and (robots_a, robots_b) in self._unplaced:
            return False
        self._no_case[robots_a, robots_b] = len(pending)
        proposal = self._judge.proposal(pending, robots_a)
        if proposal is None:
            return False
        pose_a_b = proposal.pose_a_b
        if proposal.support.sum() < self._review.closures_needed(robots_a, robots_b, pose_a_b):
            return False
        if not self._judge.is_one_building(robots_a, robots_b, proposal):
            return False
        if self._judge.signs_disagree(robots_a, robots_b, pose_a_b):
            return False
        if self._on_request and self._maps.ask_for(self._judge.overlap(robots_a, robots_b, pose_a_b, OVERLAP_REACH_M)):
            return False
        grids = self._maps.known_grid(robots_a, a), self._maps.known_grid(robots_b, b)
        if self._judge.walls_disagree(*grids, pose_a_b):
            return False
        if self._trials is not None and not self._trials.is_placed(robots_a, robots_b, proposal):
            self._unplaced.add((robots_a, robots_b))
            return False
        self._maps.merge(a, b, pose_a_b)
        self.optimiser.unsettle()
        self._review.note(robots_a, robots_b, self._step)
        merged = self.group_index(robots_a[0])
        self.optimiser.soil(merged, True)
        for closure in pending:
            self._judge_inside_map(closure)
        self.optimiser.optimise(merged, is_thorough=self._trials is not None)
        return True

    def _merge_given(self, starts: Array) -> None:
        """Put all groups that have been heard of into one; the frame of a group is where its first robot started."""
        known = [g for g, group in enumerate(self.groups) if any(self.keyframes[r] for r in group.robots)]
        for b in reversed(known[1:]):
            first, second = self.groups[known[0]].robots[0], self.groups[b].robots[0]
            self._maps.merge(known[0], b, between(starts[first], starts[second]))

    def _retry_merges(self) -> None:
        """Try all groups with pending closures: new keyframes, walls or merges may have made the case for them."""
        while True:
            pairs = {tuple(sorted(map(self.group_index, robots))) for robots in self._graph.waiting.pairs()}
            if not any(self._try_merge(a, b) for a, b in sorted(pairs)):
                return

    def _undo_wrong_merge(self) -> None:
        """Take a group apart where its merge turned out to be wrong; its closures do not speak for a merge again."""
        found = self._review.wrong(self._step, self.optimiser.is_map_large)
        if found is None:
            return
        merge, why = found
        a, b = self._review.sides(merge)
        rivals = self._graph.closures_between(a, b, "rejected")
        for closure in self._graph.closures_between(a, b, "accepted"):
            self._graph.refuse(closure, f"the merge it spoke for was undone: {why}")
        self._graph.let_wait(rivals)
        self._review.forget(merge, (a, b))
        self._take_apart(a, b)
        self._retry_merges()

    def _part_strayed(self, trials: MergeTrials) -> None:
        """Take groups apart whose robots have gone so far since their closures that these fix them no more.

        The closures wait for others, with which they do.
        """
        for robots in [group.robots for group in self.groups if len(group.robots) > 1]:
            sides = trials.strayed(robots)
            if sides is None:
                continue
            closures = self._graph.closures_between(*sides, "accepted")
            for closure in closures:
                self._graph.refuse(closure, "its robots have strayed")
            self._graph.let_wait(closures)
            self._review.part(sides)
            self._take_apart(*sides)

    def _take_apart(self, a: tuple[int, ...], b: tuple[int, ...]) -> None:
        """Two sides of a group have maps of their own again."""
        self._maps.split(self.group_index(a[0]), (a, b))
        self.optimiser.unsettle()
        self._search.forget_closures_of(a + b)
        for side in (a, b):
            self.optimiser.optimise(self.group_index(side[0]))
