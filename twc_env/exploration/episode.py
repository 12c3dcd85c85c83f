"""One episode of a team in one building, independent of the interfaces of PettingZoo and gymnasium."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig, robot_configs, start_times_s
from twc_env.exploration import actions as action_blocks
from twc_env.exploration.assessment import evaluation, map_scores, rewards
from twc_env.exploration.assessment.episode_record import EpisodeRecord
from twc_env.exploration.macro_actions import CandidateSearch, MacroActions
from twc_env.exploration.observation.observations import ObservationBuilder
from twc_env.records.lasting_map import LastingMap
from twc_env.records.messages import Belief, Contacts, SensorFrame
from twc_env.records.random_streams import random_stream
from twc_env.records.team_messages import TeamFrames
from twc_env.slam.modes import Engine, make_engine
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.link import Link
from twc_env.world.motion.failures import Failures, FrameLoss, OwnClocks, silenced
from twc_env.world.world import World

_NOT_EVALUATED: tuple[object, list[map_scores.GroupScore]] = None, []


class Episode:
    """World, radio link and SLAM engine, advanced together; observations, actions, reward terms and evaluation.

    All state that changes during an episode is held here, so that pickling it saves the episode (see `snapshot`).
    """

    def __init__(self, config: EnvConfig, world: World, seed: int, starts: Any, prior: LastingMap | None):
        """Reset `world` and take the first scan; an earlier episode in this world is invalid from now on.

        starts: as in `World.reset`; prior: the map that `slam.prior` names.
        """
        self.config, self.seed, count = config, seed, config.robots
        self.steps = 0
        """Time steps so far."""
        self.is_over = False
        """Whether `max_cycles` time steps were done, or the floor is covered."""
        self.is_covered = False
        """Whether the share `episode.ends_at_coverage` of the floor was mapped correctly."""
        self._share_wanted = config.episode.ends_at_coverage or math.inf
        self.world = world
        """Ground truth."""
        world.reset(seed, starts)
        self.engine: Engine = make_engine(config, count, prior)
        if config.slam.oracle != "none":
            self.engine.give_starts(world.poses_home.copy())
        if config.slam.k_visibility.are_transmitters_known:
            self.engine.give_transmitters(*world.transmitters_home, world.poses_home.copy())
        self._failures = Failures(config.failure, start_times_s(config), config.dynamics.time_step_s)
        self._loss = FrameLoss(config.failure.frame_loss_probability, count, seed)
        self._clocks = OwnClocks(config.failure, count, seed)
        self._link = Link(config.link, count, world.plan.home.wall_index, random_stream(seed, "link"))
        self._builder = ObservationBuilder(config)
        self._velocities = action_blocks.Velocities([own.dynamics for own in robot_configs(config)], count)
        self.macro_actions = (
            None if config.action.kind == "velocity" else MacroActions(config, self._failures.is_alive(0))
        )
        """Executes waypoint and frontier actions; None with velocity actions."""
        self._search = self.macro_actions or (CandidateSearch(config) if config.observation.frontiers else None)
        """Updates the goal candidates: the macro actions, or a `CandidateSearch` for the `frontiers` block with
        velocity actions."""
        self.record = EpisodeRecord(count)
        """Ground truth and front-end poses of all steps, for evaluation only."""
        self._evaluated = _NOT_EVALUATED
        """The beliefs that were evaluated last, and their scores."""
        self._standing = rewards.Standing.nothing(count)
        self._uneventful = rewards.terms(self._transition(self._standing, np.zeros(count, bool), 0.0), "team")
        """Terms of a time step without contacts, messages and evaluation."""
        self.frames_of_step: list[Sequence[SensorFrame]] = []
        """`frames` of each time step of the last `step`."""
        self.frames: Sequence[SensorFrame]
        """What each robot sensed in the last time step; a failed robot has no frame."""
        self._shown: TeamFrames
        """The same for observations: one row per robot, with empty measurements for failed ones."""
        self.contacts: Contacts
        """Radio contacts between robots in the last time step."""
        frames = world.sense()
        self._think(frames)
        self._bytes_evaluated = self.bytes_sent

    @property
    def floorplan(self) -> Floorplan:
        """The true floor plan."""
        return self.world.plan

    @cached_property
    def np_random(self) -> np.random.Generator:
        """A random stream of the episode's seed for wrappers; not used by the episode itself."""
        return random_stream(self.seed, "wrappers")

    @property
    def bytes_sent(self) -> int:
        """Bytes sent so far by all robots."""
        return sum(self.engine.bytes_sent.values())

    def step(
        self, actions: Mapping[str, Any], agents: Sequence[str], watch: Callable[[Episode], None] | None = None
    ) -> list[dict[str, float]]:
        """Act, sense, run SLAM, evaluate: one time step, or as many as the actions last.

        Returns the reward terms of each robot, summed over the time steps. `watch` is called after each time step.
        Raises ActionError for a malformed action; the state is unchanged then.
        """
        macro_actions = self.macro_actions
        if macro_actions is None:
            commands = self._velocities.decode(actions, agents)
            self.frames_of_step = []
            values = self._tick(commands)
            if watch is not None:
                watch(self)
            return values
        macro_actions.assign(actions, agents, self._beliefs)
        self.frames_of_step = []
        sums: list[dict[str, float]] = []
        while True:
            values = self._tick(macro_actions.commands(self._beliefs))
            if watch is not None:
                watch(self)
            sums = rewards.added(sums, values) if sums else values
            if macro_actions.is_decision_due(self._failures.is_alive(self.steps)) or self.is_over:
                return sums

    def observe(self) -> list[Any]:
        """The observation of each robot; first updates the goal candidates, with macro actions or a `frontiers`
        block."""
        macro_actions, search, masks = self.macro_actions, self._search, None
        if search is None:
            return self._builder.build()
        search.look(self._beliefs, whole=self.engine.belief)
        if macro_actions is not None and self.config.action.kind == "frontier":
            masks = [macro_actions.mask(robot) for robot in range(self.config.robots)]
        return self._builder.build(search.candidates, masks)

    @property
    def coverage(self) -> float:
        """Share of the floor mapped correctly by the best correctly merged group, when the rewards were last
        evaluated."""
        return self._standing.team[0]

    @property
    def is_one_map(self) -> bool:
        """Whether all robots shared one correct map when the rewards were last evaluated."""
        return self._standing.team[1] == 1.0

    def belief(self, robot: int) -> Belief:
        """What one robot knows: its map and pose. Estimates only."""
        return self.engine.belief(robot)

    def __getstate__(self) -> dict:
        return self.__dict__ | {"_evaluated": _NOT_EVALUATED}

    def map_scores(self) -> list[map_scores.GroupScore]:
        """All maps of the team evaluated now, see `scores_of`; cached until the engine's next update."""
        self._record_all()
        believed = self.engine.beliefs()  # a new object after each update of the engine
        if self._evaluated[0] is not believed:
            self._evaluated = believed, map_scores.scores_of(self.engine, self.record, self.world.cells)
        return self._evaluated[1]

    def numbers(self) -> dict[str, float]:
        """The scalar figures of `result`."""
        self._record_all()
        paths = evaluation.EpisodePaths.of(self.engine, self.record)
        return evaluation.numbers(
            self.config, self.seed, self.world.cells, self.engine, self.record, self.map_scores(), paths
        )

    def result(self) -> evaluation.EpisodeResult:
        """Evaluate the episode so far against ground truth."""
        self._record_all()
        return evaluation.evaluate(
            self.config, self.seed, self.floorplan, self.world.cells, self.engine, self.record, self.map_scores()
        )

    def caption(self) -> str:
        """Caption of a picture: one line with time, merged robots and correctly mapped floor, from ground truth."""
        time_s = self.steps * self.config.dynamics.time_step_s
        return map_scores.told(self.map_scores(), self.world.cells, self.config.robots, time_s)

    def _tick(self, commands: Array) -> list[dict[str, float]]:
        """Advance by one time step; returns the reward terms of each robot."""
        if not (self._failures.is_nothing or self._failures.are_all_alive(self.steps)):
            is_alive = self._failures.is_alive(self.steps)
            self.world.anchor(self._failures.failed(self.steps))
            commands = commands * is_alive[:, None]
        self.steps += 1
        self.is_over = self.steps == self.config.max_cycles
        self._think(self.world.tick(commands))
        return self._reward_terms()

    def _record_all(self) -> None:
        """Record also a time step that a signal has cut off: the engine may have a keyframe of it."""
        if len(self.record.true_poses) <= self.steps:
            still = np.zeros_like(self.world.poses)
            self.record.append(self.world.poses, self.engine.poses_odom, still, self.world.contacts)

    def _think(self, frames: TeamFrames) -> None:
        """Process the frames of one time step: link, front ends, mappers, record and memory of observations."""
        world, engine, failures = self.world, self.engine, self._failures
        self.frames, self._shown = frames, frames
        self.contacts = self._link.constant or self._link.contacts(world.poses_home)
        if not failures.is_nothing:
            self.contacts = failures.contacts(self.steps, self.contacts)
            is_alive = failures.is_alive(self.steps)
            if not is_alive.all():
                self.frames = [frame for frame in frames if is_alive[frame.robot]]
                self._shown = silenced(frames, is_alive)
            if self._loss.probability:
                self.frames = self._loss.arriving(self.frames)
        if not self._clocks.are_one:
            self.frames = self._clocks.timed(self.frames)
        self.frames_of_step.append(self.frames)
        if self.frames is frames or self.frames:
            engine.track(self.frames)
        engine.absorb(self.steps, self.contacts)
        self._touching = world.contacts
        self.record.append(world.poses, engine.poses_odom, frames.odometry, self._touching)
        if world.crowd is not None:
            self.record.people_collisions = sum(world.crowd.collisions.tolist())  # a third of the time of its sum()
        if self.is_over:
            engine.finish()
        self._notice()

    def _notice(self) -> None:
        """Store the present beliefs and update what observations remember."""
        self._beliefs = self.engine.beliefs()
        self._builder.notice(self._shown, self._beliefs)

    def _reward_terms(self) -> list[dict[str, float]]:
        config, before, sent_before, contacts = self.config, self._standing, self._bytes_evaluated, self._touching
        self._bytes_evaluated = sum(self.engine.bytes_sent.values())
        if self.is_over or self.steps % config.reward.period_steps == 0:
            self._evaluate()
            self.is_covered = self.coverage >= self._share_wanted
            if self.is_covered and not self.is_over:
                self.is_over = True
                self.engine.finish()
                self._notice()
                self._evaluate()
        sent = (self._bytes_evaluated - sent_before) / config.robots
        if self._standing is before and True not in contacts.tolist():
            return rewards.quiet(self._uneventful, sent) if sent else self._uneventful
        return rewards.terms(self._transition(before, contacts, sent), config.reward.sharing)

    def _evaluate(self) -> None:
        """Evaluate the maps for the rewards, exactly if the episode is over."""
        last = self.map_scores() if self.is_over else ()
        self._standing = map_scores.standing(self.engine, self.record, self.world.cells, last)

    def _transition(self, before: rewards.Standing, contacts: Array, bytes_per_robot: float) -> rewards.Transition:
        """The present time step; before: the potentials before it."""
        return rewards.Transition(before, self._standing, contacts, bytes_per_robot, self.config.max_cycles)
