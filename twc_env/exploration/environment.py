"""Cooperative exploration with SLAM inside every step (ids: `twc_env.tasks`)."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from os import PathLike
from types import NoneType
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import spaces
from gymnasium.utils import EzPickle
from numpy.typing import NDArray as Array
from pettingzoo import ParallelEnv

from twc_env.config import EnvConfig, override
from twc_env.config.checks import refuse_arguments, whole_number
from twc_env.errors import ConfigError, TwcError
from twc_env.exploration.actions import velocity_space
from twc_env.exploration.assessment import evaluation, rewards
from twc_env.exploration.earlier_session import prior_in
from twc_env.exploration.episode import Episode
from twc_env.exploration.macro_actions import MacroActions, frontier_space, waypoint_space
from twc_env.exploration.observation.observation_blocks import beams_shown, observation_space
from twc_env.exploration.reset_options import read_options
from twc_env.exploration.settings import resolve
from twc_env.exploration.snapshot import Snapshot, restore_snapshot, take_snapshot
from twc_env.kernels.compilation import announcer
from twc_env.maps import load_map
from twc_env.records.messages import Belief, Contacts, SensorFrame
from twc_env.records.one_thread import OneThread
from twc_env.slam.modes import Engine
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.building.splits import is_set, one_of
from twc_env.world.building.subsampling import subsampled
from twc_env.world.world import World

if TYPE_CHECKING:
    from twc_env.exploration.drawing.window import Window
    from twc_env.exploration.viewer import Viewer

STATE_LIMIT = 1e4
UNNAMED = "unnamed"
"""Map of reports of a floor plan made in memory that has no name."""
NO_RENDER_MODE = (
    "render() shows nothing without a render_mode: make the environment with render_mode='rgb_array' or 'human'"
)


class ExplorationEnv(ParallelEnv, EzPickle):
    """A team of robots explores a building while a cooperative SLAM engine maps it inside every step.

    Robots start without a common frame, their odometry drifts, rooms look alike and signs repeat. The agents' actions
    determine which places the engine recognises and hence the quality of the team's map, which is what is rewarded.

    Agents: "robot_0" ... "robot_{n-1}". All stay in the episode until it is truncated after `max_cycles` time steps of
    `dynamics.time_step_s`, or, with `episode.ends_at_coverage`, terminated as soon as that share of the floor is mapped
    correctly.

    Actions, by `action.kind`:

    | kind | space | meaning |
    |---|---|---|
    | `velocity` | `Box(-1, 1, (2,))` | speed and turn rate (left positive), as fractions of the maxima; one time step |
    | `waypoint` | `Box(-1, 1, (2,))` | goal ahead and to the left, in units of `action.waypoint_reach_m` |
    | `frontier` | `Discrete(slots + 3)` | a row of `frontiers`; then: nearest sign, nearest teammate, stay |

    A waypoint goal is moved to the nearest reachable known place. Waypoints and frontiers are planned and followed on
    the estimated map, which takes many time steps. A step ends when all robots have arrived
    (`action.timing = "synchronous"`: early robots wait) or as soon as one has ("asynchronous": the others continue, and
    their next actions are ignored), at the latest after `action.decision_max_s`. With "in-turn" one robot decides
    at a time, knowing what the others have decided: one that has arrived, or whose last decision was so long ago, and
    of several that for which it was longest. A robot that is stuck or finds no way
    gives up, which counts as arriving. Rewards of the time steps are summed.
    `info["is_deciding"]` says whether a robot's next action counts, `info["time_steps"]` how long the step was. For
    `frontier`, `action_mask` is in the observation and in `info`. A masked choice counts as stay; for a busy robot,
    stay means "continue". A robot that has failed decides nothing, and no step waits for it.

    Observation: a `Dict` of the blocks enabled in `observation`, built from sensor frames and estimates only:

    | key | shape | range | meaning |
    |---|---|---|---|
    | `lidar` | (beams,) | [0, 1] | range / maximum range; beam 0 ahead, counter-clockwise, or as `lidar` settings say |
    | `map` | (7, 64, 64) uint8 | 0, 255 | egocentric, robot facing +column: free, wall, unknown, frontier, |
    | | | | own path, teammates, signs |
    | `overview` | (4, 32, 32) uint8 | 0..255 | the merged map, downscaled: free, wall, this robot, teammates; robots |
    | | | | beside its known part are marked at the rim |
    | `pose` | (8,) | m, m, -, -, m, m, rad, m | x, y, cos, sin of heading in the map frame of the robot's group; |
    | | | | standard deviations of x, y, heading and path length since the last closure |
    | `wifi` | (16,) | [0, 1] | last scan: RSSI per transmitter, -100..-20 dBm; slots keep their transmitter; 0: not |
    | | | | heard, or weaker |
    | `signs` | (4, 5) | [-1, 1] | recent readings, newest first: present, bearing / pi, distance d / (d + 10 m), age |
    | | | | / `sign_memory_s`, c / (c + 2) if the text is known from c other places |
    | `team` | (n-1, 5) | [-1, 1] | per teammate: shares my map, bearing / pi, d / (d + 10 m), heading / pi, |
    | | | | age a / (a + 10 s) of the last contact: 0 now, 1 before the first. Contact is that of the |
    | | | | central mapper with the teammate, or with one mapper per robot, of both robots directly |
    | `frontiers` | (8, 6) | [-1, 1] | candidates, nearest (views: best) first: present, bearing / pi, d / (d + 10 m), |
    | | | | path cost l / (l + 10 m) in metres of open floor (more beside walls), size s / (s + 5 m), |
    | | | | whether some teammate's distance is less than l |
    | `gains` | (8,) | [0, 1] | with `observation.gains`: unknown area a that a scan from each of `frontiers` would |
    | | | | show, if no wall is where none is known, as a / (a + 10 m2) |
    | `other_maps` | (8,) | [0, 1] | with `observation.other_maps`: expected distance d of each of `frontiers` to the |
    | | | | path of robots of another map, as d / (d + 10 m); 0 if it is not known, or they come here |
    | `time_left` | (1,) | [0, 1] | with `observation.time_left`: share of `max_cycles` that is left |
    | `action_mask` | (11,) int8 | 0, 1 | valid choices (only with `action.kind = "frontier"`) |
    | `radio` | (2, 64, 64) uint8 | 0, 255 | with `slam.k_visibility.enabled`: probably free, probably wall, estimated |
    | | | | from signal strength alone; egocentric like `map` |

    A robot that has failed measures nothing: its `lidar` and `wifi` are 0. In a mixed team (`robot`), `lidar` is as
    long as the robot's own scan and a share of its own range; with `observation.equal_shapes` shorter ones end in
    zeros.

    With `observation.kind = "flat"` the blocks are concatenated to one float32 vector, images scaled to [0, 1].

    Reward: a weighted sum of named terms. `twc_env.exploration.assessment.rewards` lists the terms, `reward` has the
    weights, and `info["reward_terms"]` the values. By default each agent receives the increase in correctly mapped
    floor of the best correctly merged group, so the return of an episode is that share at its end: `coverage_correct`,
    unless another group has more robots. The map is evaluated every `reward.period_steps` time steps and at the last
    one. The last `info` also contains the scalar metrics of the report (docs/figures.md).

    `slam.mode = "off"` runs no engine: `pose` is integrated odometry, `map` shows the own path in unknown space,
    `team` stays zero, `coverage` pays nothing, only `velocity` actions are possible (there is no map), and
    `localisation` and `result()` evaluate dead reckoning.

    Arguments: `map` (bundled name or file), `robots`, `max_cycles`; `render_mode` ("human", "rgb_array" or None);
    `config` (an EnvConfig or a dict of overrides, dotted keys allowed) for everything else; `task`, a standard task to
    which the overrides apply; `render_signal=True` overlays WiFi signal strength. With "human" a window shows every
    time step at `metadata["render_fps"]`; closing it ends the display, not the episode.

    `reset(options=...)` applies to one episode. `{"starts": "map"}` uses the map's own start poses instead of random
    ones, `{"starts": "entrance"}` poses side by side, `{"starts": [(x, y, heading), ...]}` the given ones [m, m,
    rad], in the building frame; robots that would overlap a wall or each other are refused. `{"map": NAME}` plays in
    another building, `{"split": "train"}` (or validation, test) in a building of that split drawn by the seed, of the
    family of `map` if it has one; `floorplan.name` is its name. `{"prior": FILE}` begins with a map that an engine
    saved earlier (`slam.prior`).

    `belief(agent)` is what a robot knows, for planners; `result()` evaluates the episode so far against ground truth;
    `snapshot()` and `restore()` save and restore the exact state.

    Versions: v0, first release; v1, tasks with splits of their own that end at a coverage (`twc_env.tasks`).
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "name": "twc_env_explore_v0",
        "render_modes": ["human", "rgb_array"],
        "is_parallelizable": True,
        "render_fps": 10,
    }

    def __init__(
        self,
        map: str | PathLike[str] | None = None,
        robots: int | None = None,
        max_cycles: int | None = None,
        config: EnvConfig | Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        floorplan: Floorplan | None = None,
        task: str | None = None,
        render_signal: bool = False,
        **unknown: Any,
    ):
        refuse_arguments(unknown, ExplorationEnv)
        if not isinstance(floorplan, (Floorplan, NoneType)):
            raise ConfigError(f"floorplan must be a Floorplan; got {floorplan!r}: name a map or a file as `map`")
        announcer()
        building = (floorplan.name or UNNAMED) if map is None and floorplan is not None else map
        self.config = resolve(config, task, {"map": building, "robots": robots, "max_cycles": max_cycles})
        # Copies are made from the resolved values: a dict may be changed by its owner later.
        kept = {"render_mode": render_mode, "floorplan": floorplan, "render_signal": render_signal}
        EzPickle.__init__(self, map=self.config.map, config=self.config, **kept)
        self.metadata = copy.deepcopy(type(self).metadata)
        self.render_mode = render_mode
        self._viewer = _make_viewer(render_mode, self.metadata["render_fps"], render_signal)
        self._watch = None if self._viewer is None else self._viewer.follow
        self._spectators: list[Callable[[], None]] = []
        self._own_floorplan = floorplan if floorplan is not None else load_map(one_of(self.config.map, 0))
        self._draws_building = floorplan is None and is_set(self.config.map)
        self._plan: Floorplan | None = None
        self._move_into(None)
        count = self.config.robots
        self.possible_agents = [f"robot_{i}" for i in range(count)]
        self.agents: list[str] = []
        self._all_false, self._all_true = (dict.fromkeys(self.possible_agents, each) for each in (False, True))
        self._numbered = tuple(enumerate(self.possible_agents))
        beams, shared_action = beams_shown(self.config), _action_space(self.config)
        known = {length: observation_space(self.config, beams.index(length)) for length in set(beams)}
        seen = [known[length] for length in beams]
        self.observation_spaces = dict(zip(self.possible_agents, seen, strict=True))
        self.action_spaces = dict.fromkeys(self.possible_agents, shared_action)
        self.state_space = spaces.Box(-STATE_LIMIT, STATE_LIMIT, (6 * count,), np.float32)
        self._weights = rewards.weights_of(self.config.reward)
        self._weighed: tuple[Sequence[dict[str, float]] | None, dict[str, float]] = None, {}
        """The terms weighted last and the resulting rewards; uneventful steps share them."""
        self._begun: Episode | None = None
        self._seed: int | None = None
        self._alone = OneThread("this environment")

    def observation_space(self, agent: str) -> spaces.Space:
        """The same object at every call, for all agents with equally many beams. Raises ConfigError for an unknown
        agent."""
        return self._space_of(agent, self.observation_spaces)

    def action_space(self, agent: str) -> spaces.Space:
        """The same object for every agent, at every call. Raises ConfigError for an unknown agent."""
        return self._space_of(agent, self.action_spaces)

    def _space_of(self, agent: str, known: Mapping[str, spaces.Space]) -> spaces.Space:
        if not isinstance(agent, str) or agent not in self.possible_agents:
            raise ConfigError(f"agents are {', '.join(self.possible_agents)}; got {agent!r}")
        return known[agent]

    def reset(self, seed: int | None = None, options: dict | None = None):
        """Begin an episode. The same seed gives the same episode; the default is the previous seed + 1.

        Options of other environments are ignored. Raises ConfigError for invalid options and MapError for a map that
        cannot be loaded; no episode is running then.
        """
        with self._alone:
            return self._reset(seed, options)

    def _reset(self, seed: int | None, options: dict | None):
        self.agents, self._begun = [], None
        seed = self._next_seed() if seed is None else whole_number("seed", seed, 0)
        starts, building = read_options(options, seed, self.config)
        if building is None and self._draws_building:
            building = one_of(self.config.map, seed)
        config = self._move_into(building)
        prior = (options or {}).get("prior")
        if prior is not None:
            config = override(config, {"slam.prior": prior})
        self._seed = seed
        known = None if not config.slam.prior else prior_in(config, self._plan or self.floorplan)
        episode = self._begun = Episode(config, self._world, seed, starts, known)
        self.agents = self.possible_agents[:]
        if self._viewer is not None:
            self._viewer.begin()
            self._viewer.follow(episode)
        return self._observed(episode)

    def _observed(self, episode: Episode) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Observations and infos of an episode in which no step was made yet, or that was restored."""
        seen = episode.observe()  # also updates the choices that the infos report
        infos: dict[str, dict[str, Any]] = {agent: {} for agent in self.possible_agents}
        if episode.macro_actions is not None:
            self._tell_choices(infos, episode.macro_actions, 0)
        return self._by_agent(seen), infos

    def step(self, actions: Mapping[str, Any]):
        """Act, sense, run SLAM, compute rewards: for one time step, or as many as the action lasts.

        Raises ActionError for a missing, malformed, non-finite or out-of-range action, or one for an unknown agent, and
        TwcError while another thread is in this environment; the state is unchanged then.
        """
        with self._alone:
            return self._step(actions)

    def _step(self, actions: Mapping[str, Any]):
        episode, agents = self._begun, self.agents
        if episode is None or not agents:
            state = "none has started" if episode is None else "this one is over"
            raise TwcError(f"step() needs a running episode, and {state}: call reset() first")
        began = episode.steps
        values = episode.step(actions, agents, self._watch)
        seen, observations, infos = episode.observe(), {}, {}
        for robot, agent in self._numbered:
            observations[agent] = seen[robot]
            infos[agent] = {"reward_terms": values[robot].copy()}
        if episode.macro_actions is not None:
            self._tell_choices(infos, episode.macro_actions, episode.steps - began)
        terminated = truncated = self._all_false
        if episode.is_over:
            numbers: dict[str, Any] = episode.numbers()
            for info in infos.values():
                info.update(numbers)
            self.agents = []
            terminated, truncated = self._all_false, self._all_true
            if episode.is_covered:
                terminated, truncated = truncated, terminated
        if values is not self._weighed[0]:
            self._weighed = values, self._by_agent(rewards.weigh(values, self._weights))
        return observations, self._weighed[1].copy(), terminated.copy(), truncated.copy(), infos

    @property
    def episode(self) -> Episode:
        """The current episode, ground truth included. Raises TwcError before the first `reset`."""
        if self._begun is None:
            raise TwcError("no episode has started: call reset() first")
        return self._begun

    @property
    def floorplan(self) -> Floorplan:
        """The true floor plan of the current building."""
        return self._world.plan

    @property
    def engine(self) -> Engine:
        """The SLAM engine of this episode. This and the following raise TwcError before the first `reset`."""
        return self.episode.engine

    @property
    def np_random(self) -> np.random.Generator:
        """A random stream of the episode's seed, reserved for wrappers (SuperSuit's frame_skip)."""
        return self.episode.np_random

    @property
    def frames(self) -> Sequence[SensorFrame]:
        """What each robot sensed in the last time step; `twc_env.datasets.logs.frame_log.write_frame_log` records
        them.

        While no robot has failed this is a `TeamFrames`, with arrays over robots. A failed robot has no frame.
        """
        return self.episode.frames

    @property
    def frames_of_step(self) -> list[Sequence[SensorFrame]]:
        """The same for each time step of the last `step`: one with `velocity`, many with other actions."""
        return self.episode.frames_of_step

    @property
    def contacts(self) -> Contacts:
        """Radio contacts between robots in the last time step."""
        return self.episode.contacts

    def belief(self, agent: str) -> Belief:
        """What one robot knows: the merged map of its group and its pose in it. Estimates only. Its `grid` is not a
        copy and changes with the next steps; `copy.deepcopy` keeps it as it is.

        Raises TwcError for an unknown agent.
        """
        if not isinstance(agent, str) or agent not in self.action_spaces:
            raise TwcError(f"there is no agent {agent!r}; the team is {', '.join(self.possible_agents)}")
        return self.episode.belief(self.possible_agents.index(agent))

    def state(self) -> Array:
        """(6 robots,) float32 for centralised critics, with ground truth: each robot's true, then its estimated
        pose."""
        estimated = [self.engine.pose_map_robot(r) for r in range(self.config.robots)]
        both = np.concatenate([self.episode.world.poses, np.array(estimated)], axis=1)
        return np.clip(both, -STATE_LIMIT, STATE_LIMIT).astype(np.float32).ravel()

    def result(self) -> evaluation.EpisodeResult:
        """Evaluate the episode so far against ground truth; call it before the next `reset`."""
        return self.episode.result()

    def render(self) -> Array | None:
        """(height, 960, 3) uint8 image of truth and estimate, with caption and legend (they need Pillow, extra `viz`);
        None with a window, and, with a warning, without a render_mode."""
        if self._viewer is None:
            warnings.warn(NO_RENDER_MODE, UserWarning, stacklevel=2)
            return None
        return self._viewer.draw(self.episode)

    @property
    def window(self) -> Window | None:
        """The window of render_mode "human", whose held keys a program may read; None in other modes."""
        return None if self._viewer is None else self._viewer.window

    def watch(self, spectator: Callable[[], None]) -> None:
        """Call `spectator` after every time step from now on, also within long actions; for example to record video.

        Until `close`; one that watches already is not called twice. Raises ConfigError for what cannot be called.
        """
        if not callable(spectator):
            raise ConfigError(f"a spectator is a function without arguments; got {spectator!r}")
        if spectator not in self._spectators:
            self._spectators.append(spectator)
        self._watch = self._tell

    def _tell(self, episode: Episode) -> None:
        if self._viewer is not None:
            self._viewer.follow(episode)
        for spectator in self._spectators:
            spectator()

    def snapshot(self) -> Snapshot:
        """The complete state of the episode: world, engine, pose graph and random streams.

        Raises TwcError before `reset`, DataError if a custom part, such as a recogniser, cannot be copied.
        """
        return take_snapshot(self.config, self.episode)

    def restore(self, snapshot: Snapshot):
        """Continue from a snapshot of an environment with the same config and version; returns the observations and
        infos then, as `reset` does.

        Raises ConfigError if the config or the version differs, DataError if the snapshot is corrupt; the current
        episode is unchanged then.
        """
        with self._alone:
            episode = self._begun = restore_snapshot(self.config, snapshot)
            self.agents = [] if episode.is_over else self.possible_agents[:]
            if episode.floorplan is not self.floorplan:
                self._plan = None
            self._world, self._seed = episode.world, episode.seed
            return self._observed(episode)

    def close(self) -> None:
        """Close the window of render_mode "human" and drop all spectators."""
        self._spectators.clear()
        if self._viewer is not None:
            self._viewer.close()

    def _next_seed(self) -> int:
        return int(np.random.default_rng().integers(2**31)) if self._seed is None else self._seed + 1

    def _move_into(self, building: str | None) -> EnvConfig:
        """Load the building of the next episode (None: the environment's own); returns the config with its name."""
        config = self.config if building is None else replace(self.config, map=building)
        plan = self._own_floorplan if building is None else load_map(building)
        if plan is not self._plan:
            self._world, self._plan = World(config, subsampled(plan, config.building)), plan
        return config

    def _by_agent(self, values: Sequence[Any]) -> dict[str, Any]:
        """The values (one per robot) by agent name."""
        named = {}
        for robot, agent in self._numbered:
            named[agent] = values[robot]
        return named

    def _tell_choices(self, infos: dict[str, dict[str, Any]], macro_actions: MacroActions, time_steps: int) -> None:
        """Add `is_deciding`, `time_steps` and, with choices among frontiers, `action_mask` to the infos."""
        for robot, info in enumerate(infos.values()):
            info["is_deciding"], info["time_steps"] = bool(macro_actions.is_deciding[robot]), time_steps
            if self.config.action.kind == "frontier":
                info["action_mask"] = macro_actions.mask(robot)


def _action_space(config: EnvConfig) -> spaces.Space:
    if config.action.kind == "frontier":
        return frontier_space(config.action)
    return waypoint_space() if config.action.kind == "waypoint" else velocity_space()


def _make_viewer(render_mode: str | None, frames_per_s: float, with_signal: bool) -> Viewer | None:
    """The viewer of a render_mode, or None without one. Raises ConfigError for an unknown mode."""
    if render_mode is None:
        return None
    if not isinstance(render_mode, str) or render_mode not in ExplorationEnv.metadata["render_modes"]:
        raise ConfigError(f"render_mode must be 'human', 'rgb_array' or None; got {render_mode!r}")
    from twc_env.exploration.viewer import Viewer

    return Viewer(render_mode, frames_per_s, with_signal)
