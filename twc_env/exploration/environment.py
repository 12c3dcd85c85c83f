"""Cooperative exploration with SLAM inside every step (ids: `twc_env.tasks`)."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import spaces
from gymnasium.utils import EzPickle
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from twc_env.config import EnvConfig, override
from twc_env.errors import ConfigError, TwcError
from twc_env.exploration import actions as action_blocks
from twc_env.exploration import evaluation, rewards, verdicts
from twc_env.exploration.compilation import FIRST_START, announce_compilation
from twc_env.exploration.episode_record import EpisodeRecord
from twc_env.exploration.observation_blocks import observation_space
from twc_env.exploration.observations import ObservationBuilder, first_observations
from twc_env.exploration.pilot import Pilot, Scout, frontier_space, waypoint_space
from twc_env.exploration.reset_options import ResetOptions, checked_seed
from twc_env.exploration.settings import resolve
from twc_env.exploration.snapshot import Snapshot, restore_snapshot, take_snapshot
from twc_env.maps import load_map
from twc_env.messages import Belief, Contacts
from twc_env.random_streams import random_stream
from twc_env.slam.modes import Engine, make_engine
from twc_env.team_messages import TeamFrames
from twc_env.world.failures import Failures
from twc_env.world.floorplan import Floorplan
from twc_env.world.link import Link
from twc_env.world.thinning import thinned
from twc_env.world.world import World

if TYPE_CHECKING:
    from twc_env.exploration.viewer import Viewer

Array = NDArray

STATE_LIMIT = 1e4
_NOT_BEGUN = "no episode has begun: call reset() first"


class ExplorationEnv(ParallelEnv, EzPickle):
    """Several robots explore a building while a cooperative SLAM engine maps it inside every step.

    Robots start with no common frame, their odometry drifts, rooms look alike and signs repeat. What an agent does
    decides which places the engine recognises, and so how good the team's map becomes; that map is what is rewarded.

    Agents: "robot_0" ... "robot_{n-1}". All live for the whole episode, which is truncated after `max_cycles` time
    steps of `dynamics.time_step_s`.

    Actions, by `action.kind`:

    | kind | space | meaning |
    |---|---|---|
    | `velocity` | `Box(-1, 1, (2,))` | speed, turn rate (left positive), as shares of the maxima; one time step |
    | `waypoint` | `Box(-1, 1, (2,))` | goal ahead, to the left, in units of `action.waypoint_reach_m` |
    | `frontier` | `Discrete(slots + 3)` | a row of `frontiers`; then: nearest sign, nearest mate, stay |

    A waypoint is the reachable known place nearest to the goal. Waypoints and frontiers are planned and followed on the
    estimated map, which takes many time steps; a step ends when all robots are done (`action.timing = "synchronous"`:
    who is early waits), or as soon as one is ("asynchronous": the others go on, and their next actions do not count),
    at the latest after `action.decision_max_s`. Rewards of the time steps are added up. `info["is_deciding"]` tells
    whose next action counts, `info["time_steps"]` how long the step was. For `frontier`, `action_mask` stands in the
    observation and in `info`; a choice that it rules out counts as stay, and stay means "go on" to a busy robot.

    Observation, a `Dict` of the blocks that `observation` asks for, built from sensor frames and estimates only:

    | key | shape | range | meaning |
    |---|---|---|---|
    | `lidar` | (beams,) | [0, 1] | range over maximum range; beam 0 ahead, counter-clockwise |
    | `map` | (7, 64, 64) uint8 | 0, 255 | around the robot, which looks along +column: free, wall, unknown, frontier, |
    | | | | own path, mates, signs |
    | `overview` | (4, 32, 32) uint8 | 0..255 | the whole merged map, shrunk: free, wall, this robot, mates |
    | `pose` | (8,) | m, m, -, -, m, m, rad, m | x, y, cos, sin of the heading in the map frame of the robot's group; |
    | | | | standard deviations and path length since the last closure |
    | `wifi` | (16,) | [0, 1] | strength per transmitter, -100..-20 dBm; a slot keeps its transmitter; 0: not heard |
    | `signs` | (4, 5) | [-1, 1] | recent readings, newest first: present, bearing / pi, distance d / (d + 10 m), age, |
    | | | | c / (c + 2) where the text is known from c other places |
    | `team` | (n-1, 5) | [-1, 1] | per mate: shares my map, bearing / pi, d / (d + 10 m), heading / pi, |
    | | | | age a / (a + 10 s) of its last message |
    | `frontiers` | (8, 6) | [-1, 1] | candidates, nearest first: present, bearing / pi, d / (d + 10 m), |
    | | | | path l / (l + 10 m), size s / (s + 5 m), a mate is nearer |
    | `action_mask` | (11,) int8 | 0, 1 | which choices count (only with `action.kind = "frontier"`) |
    | `radio` | (2, 64, 64) uint8 | 0, 255 | with `slam.k_visibility.enabled`: probably free, probably wall, told by |
    | | | | signal strength alone, as `map` |

    With `observation.kind = "flat"` the blocks come as one vector of float32, pictures scaled to [0, 1].

    Reward: sum of named terms times the weights of `reward`; `twc_env.exploration.rewards` has their table, and they
    stand in `info["reward_terms"]`. By default each agent gets the gain in `coverage_correct` of the largest rightly
    merged group, so that an episode's sum is that share at its end. The team is judged every `reward.period_steps` time
    steps and at the last. The last `info` also holds the scalar figures of the report (docs/figures.md).

    `slam.mode = "off"` runs no engine: `pose` is odometry summed up, `map` and `team` stay zero, `coverage` pays
    nothing (there is no map), and `result()` judges dead reckoning.

    Arguments: `map` (bundled name or file), `robots`, `max_cycles` and `render_mode` ("human", "rgb_array" or None);
    `config` (an EnvConfig, a dict of overrides, dotted keys allowed) holds everything else; `task` names a standard
    task that the overrides change; `render_signal=True` lays WiFi strength over the pictures. In mode "human" a window
    shows every time step, at `metadata["render_fps"]`; who shuts it ends the pictures, not the episode.
    `reset(options=...)` holds for one episode: `{"starts": "map"}` uses the map's own starts instead of drawing them by
    seed, `{"map": NAME}` plays in another building, `{"split": "train"}` (or validation, test) in one of that split,
    drawn by the seed.

    `belief(agent)` gives a planner what the robot knows; `result()` judges the episode so far against the truth;
    `snapshot()` and `restore()` save and bring back a moment, exactly.

    Versions: v0, first release.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "name": "twc_env_explore_v0",
        "render_modes": ["human", "rgb_array"],
        "is_parallelizable": True,
        "render_fps": 10,
    }

    def __init__(
        self,
        map: str | None = None,
        robots: int | None = None,
        max_cycles: int | None = None,
        config: EnvConfig | Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        floorplan: Floorplan | None = None,
        task: str | None = None,
        render_signal: bool = False,
    ):
        announce_compilation()
        self.config = resolve(config, task, {"map": map, "robots": robots, "max_cycles": max_cycles})
        # Copies are made from the resolved values: a dict may be changed by its owner later.
        EzPickle.__init__(
            self, config=self.config, render_mode=render_mode, floorplan=floorplan, render_signal=render_signal
        )
        FIRST_START.is_engine_wanted |= self.config.slam.mode != "off"
        self.metadata = copy.deepcopy(type(self).metadata)
        self.render_mode = render_mode
        self._viewer = _make_viewer(render_mode, self.metadata["render_fps"], render_signal)
        self._own_floorplan = floorplan if floorplan is not None else load_map(self.config.map)
        self._world_of(self.config, self._own_floorplan)
        count = self.config.robots
        self.possible_agents = [f"robot_{i}" for i in range(count)]
        self.agents: list[str] = []
        self._all_false, self._all_true = (dict.fromkeys(self.possible_agents, each) for each in (False, True))
        self._numbered = tuple(enumerate(self.possible_agents))
        shared_observation, shared_action = observation_space(self.config), self._action_space()
        self.observation_spaces = dict.fromkeys(self.possible_agents, shared_observation)
        self.action_spaces = dict.fromkeys(self.possible_agents, shared_action)
        self.state_space = spaces.Box(-STATE_LIMIT, STATE_LIMIT, (6 * count,), np.float32)
        self._weights = rewards.weights_of(self.config.reward)
        self._failures = Failures(self.config.failure, count)
        self._engine: Engine | None = None
        self._frames_of_step: list[TeamFrames] = []
        self._seed: int | None = None

    def observation_space(self, agent: str) -> spaces.Space:
        """The same object for every agent, at every call."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space:
        """The same object for every agent, at every call."""
        return self.action_spaces[agent]

    def reset(self, seed: int | None = None, options: dict | None = None):
        """Begin an episode. The same seed gives the same episode; without one, the next seed after the last is used.

        Raises MapError for a map that cannot be loaded. Options of other environments are ignored. After a reset that
        failed no episode is under way.
        """
        self.agents, self._engine = [], None
        seed = self._next_seed() if seed is None else checked_seed(seed)
        chosen = ResetOptions.of(options, seed)
        self._move_into(chosen.building)
        self._seed = seed
        self._world.reset(self._seed, chosen.starts)
        count = self.config.robots
        self._engine = make_engine(self.config, count)
        if self.config.slam.oracle != "none":
            self._engine.give_starts(self._world.poses_home.copy())
        if self.config.slam.k_visibility.are_transmitters_known:
            self._engine.give_transmitters(*self._world.transmitters_home, self._world.poses_home.copy())
        self._link = Link(self.config.link, count, self.floorplan.home.wall_index, random_stream(self._seed, "link"))
        self._builder = ObservationBuilder(self.config)
        self._pilot = Pilot(self.config) if self._lasts else None
        self._scout = Scout(self.config) if self.config.observation.frontiers else None
        self._record = EpisodeRecord(count)
        self._standing = rewards.Standing.nothing(count)
        self._steps = 0
        self._frames_of_step = []
        if self._viewer is not None:
            self._viewer.begin()
        self.agents = self.possible_agents[:]
        frames = self._world.sense()
        if FIRST_START.is_helped:  # it is with the engine: no need to wait for it yet
            first_observations(self.config, frames)
        self._think(frames)
        self._notice()
        self._bytes_judged = self.bytes_sent
        return self._observe(), self._infos()

    def step(self, actions: Mapping[str, Any]):
        """Act, sense, run SLAM, judge: one time step, or as many as the action lasts.

        Raises ActionError for a missing, malformed, non-finite or out-of-range action, or one for an agent that is not
        in the episode; nothing has happened then.
        """
        if not self.agents:
            raise TwcError("step() was called after the episode's end: call reset() first")
        agents, began = self.agents, self._steps
        action_blocks.check_agents(actions, agents)
        commands = None
        if self._pilot is not None:
            self._pilot.assign(actions, agents, self._beliefs)
        else:
            commands = action_blocks.decode_velocity(actions, agents, self.config.dynamics)
        self._frames_of_step = []
        values = self._fly() if commands is None else self._tick(commands)
        is_last = self._steps >= self.config.max_cycles
        observations, infos = self._observe(), self._infos(self._steps - began, values)
        if is_last:
            figures = {k: v for k, v in self.result().figures.items() if isinstance(v, (int, float))}
            for info in infos.values():
                info.update(figures)
            self.agents = []
        earned = self._by_agent(rewards.weigh(values, self._weights))
        truncated = self._all_true if is_last else self._all_false
        return observations, earned, self._all_false.copy(), truncated.copy(), infos

    @property
    def engine(self) -> Engine:
        """The SLAM engine of this episode. Raises TwcError before the first `reset`."""
        if self._engine is None:
            raise TwcError(_NOT_BEGUN)
        return self._engine

    def _held(self, name: str) -> Any:
        """An attribute that `reset` makes. Raises TwcError where no episode has begun."""
        if self._engine is None:
            raise TwcError(_NOT_BEGUN)
        return getattr(self, name)

    @property
    def frames(self) -> TeamFrames:
        """What each robot sensed in the last time step; `twc_env.datasets.write_frame_log` records them."""
        return self._held("_frames")

    @property
    def frames_of_step(self) -> list[TeamFrames]:
        """The same for each time step of the last `step`: one for velocities, many for actions that last."""
        return self._frames_of_step

    @property
    def record(self) -> EpisodeRecord:
        """What truly happened in this episode, for judging; no agent may read it."""
        return self._held("_record")

    @property
    def contacts(self) -> Contacts:
        """Who heard whom in the last step."""
        return self._held("_contacts")

    def belief(self, agent: str) -> Belief:
        """What one robot knows: the merged map of its group and where it is in it. Estimates only.

        Raises TwcError for a name that is no robot's.
        """
        if agent not in self.action_spaces:
            raise TwcError(f"there is no agent {agent!r}; the team is {', '.join(self.possible_agents)}")
        return self.engine.belief(self.possible_agents.index(agent))

    @property
    def bytes_sent(self) -> int:
        """Bytes put on the air so far, by all robots."""
        return sum(self.engine.bytes_sent.values())

    def state(self) -> Array:
        """(6 robots,) float32 for centralised critics; holds truth: each robot's true, then its estimated pose."""
        estimated = [self.engine.pose_map_robot(r) for r in range(self.config.robots)]
        both = np.concatenate([self._world.poses, np.array(estimated)], axis=1)
        return np.clip(both, -STATE_LIMIT, STATE_LIMIT).astype(np.float32).ravel()

    def result(self) -> evaluation.EpisodeResult:
        """Judge the episode so far against the truth; call it before the next `reset`."""
        return evaluation.evaluate(
            self._episode_config, self._seed or 0, self.floorplan, self.engine, self._record, self.engine.bytes_sent
        )

    def render(self) -> Array | None:
        """(height, width, 3) uint8 picture of truth and belief; None without a render_mode, or if a window shows it."""
        return None if self._viewer is None else self._viewer.draw(self)

    def snapshot(self) -> Snapshot:
        """This moment of the episode: world, engine, pose graph and random streams. Raises TwcError before `reset`."""
        return take_snapshot(self, self.engine)

    def restore(self, snapshot: Snapshot) -> None:
        """Go on from a moment that an environment of the same config and version took.

        Raises ConfigError when the config or the version differs.
        """
        restore_snapshot(self, snapshot)

    def close(self) -> None:
        """Shut the window of render_mode "human"; there is nothing else to release."""
        if self._viewer is not None:
            self._viewer.close()

    def _next_seed(self) -> int:
        return int(np.random.default_rng().integers(2**31)) if self._seed is None else self._seed + 1

    def _action_space(self) -> spaces.Space:
        kind = self.config.action.kind
        self._lasts = kind != "velocity"
        if kind == "frontier":
            return frontier_space(self.config.action)
        return waypoint_space() if self._lasts else action_blocks.velocity_space()

    def _move_into(self, building: str | None) -> None:
        """The building of the coming episode; None: the environment's own."""
        plan = self._own_floorplan if building is None else load_map(building)
        if plan is not self._plan:
            config = self.config if building is None else override(self.config, {"map": building})
            self._world_of(config, plan)

    def _world_of(self, config: EnvConfig, floorplan: Floorplan) -> None:
        self._episode_config, self._plan = config, floorplan
        self.floorplan = thinned(floorplan, config.building)
        self._world, self._cells = World(config, self.floorplan), self.floorplan.cells()

    def _tick(self, commands: Array) -> list[dict[str, float]]:
        """One time step: the reward terms of each robot."""
        if not (self._failures.is_nothing or self._failures.are_all_alive(self._steps)):
            is_alive = self._failures.is_alive(self._steps)
            self._world.anchor(np.flatnonzero(~is_alive))
            commands = commands * is_alive[:, None]
        self._steps += 1
        is_last = self._steps >= self.config.max_cycles
        self._think(self._world.tick(commands))
        if is_last:
            self.engine.finish()
        self._notice()
        return self._judge(is_last)

    def _fly(self) -> list[dict[str, float]]:
        """Time steps until the next decision: the sums of the reward terms of each robot."""
        pilot = self._pilot
        assert pilot is not None
        sums: list[dict[str, float]] = []
        while True:
            values = self._tick(pilot.commands(self._beliefs))
            sums = [{k: s[k] + v[k] for k in v} for s, v in zip(sums, values, strict=True)] if sums else values
            if pilot.is_decision_due() or self._steps >= self.config.max_cycles:
                return sums

    def _think(self, frames: TeamFrames) -> None:
        """Front ends, link and mappers take in one set of frames."""
        self._frames = frames
        self._frames_of_step.append(frames)
        world, engine, failures = self._world, self.engine, self._failures
        self._contacts = self._link.contacts(world.poses_home)
        if failures.is_nothing:
            engine.track(frames)
        else:
            self._contacts = failures.contacts(self._steps, self._contacts)
            is_alive = failures.is_alive(self._steps)
            if is_alive.all():
                engine.track(frames)
            elif is_alive.any():
                engine.track([frame for frame in frames if is_alive[frame.robot]])
        engine.absorb(self._steps, self._contacts)
        self._record.append(world.poses, engine.poses_odom, frames.odometry, world.contacts)

    def _notice(self) -> None:
        """What the robots believe now, and what their observations must remember of it."""
        self._beliefs = self.engine.beliefs()
        self._builder.notice(self._frames, self._beliefs)
        if self._viewer is not None:
            self._viewer.follow(self)

    def _judge(self, is_last: bool) -> list[dict[str, float]]:
        config, before, sent_before = self.config, self._standing, self._bytes_judged
        self._bytes_judged = self.bytes_sent
        if is_last or self._steps % config.reward.period_steps == 0:
            self._standing = verdicts.standing(self.engine, self._record, self._cells, is_last)
        sent = (self._bytes_judged - sent_before) / config.robots
        transition = rewards.Transition(before, self._standing, self._world.contacts, sent, config.max_cycles)
        return rewards.terms(transition, config.reward.sharing)

    def _observe(self) -> dict[str, Any]:
        """Observations of all robots; where one chooses among frontiers, they are worked out here."""
        pilot, looker, masks = self._pilot, self._pilot or self._scout, None
        if looker is None:
            return self._by_agent(self._builder.build())
        looker.look(self._beliefs)
        if pilot is not None and self.config.action.kind == "frontier":
            masks = [pilot.mask(robot) for robot in range(self.config.robots)]
        return self._by_agent(self._builder.build(looker.candidates, masks))

    def _by_agent(self, values: Sequence[Any]) -> dict[str, Any]:
        """One value per robot, under the names of the agents."""
        named = {}
        for robot, agent in self._numbered:
            named[agent] = values[robot]
        return named

    def _infos(self, time_steps: int = 0, terms: Sequence[dict[str, float]] = ()) -> dict[str, dict[str, Any]]:
        infos: dict[str, dict[str, Any]] = {}
        for robot, agent in self._numbered:
            infos[agent] = {"reward_terms": terms[robot]} if terms else {}
        if self._pilot is not None:
            for robot, info in enumerate(infos.values()):
                info["is_deciding"], info["time_steps"] = bool(self._pilot.is_deciding[robot]), time_steps
                if self.config.action.kind == "frontier":
                    info["action_mask"] = self._pilot.mask(robot)
        return infos


def _make_viewer(render_mode: str | None, frames_per_s: float, with_signal: bool) -> Viewer | None:
    """What draws in a render_mode; loaded only where one is asked for."""
    if render_mode is None:
        return None
    if render_mode not in ExplorationEnv.metadata["render_modes"]:
        raise ConfigError(f"render_mode must be 'human', 'rgb_array' or None; got {render_mode!r}")
    from twc_env.exploration.viewer import Viewer

    return Viewer(render_mode, frames_per_s, with_signal)
