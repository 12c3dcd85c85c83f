"""Cooperative exploration with SLAM inside every step (ids: twc_env/Explore-v0)."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.utils import EzPickle
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from twc_env.config import EnvConfig, from_dict, override
from twc_env.errors import ConfigError, TwcError
from twc_env.exploration import actions as action_blocks
from twc_env.exploration import evaluation, rewards
from twc_env.exploration.observations import ObservationBuilder, observation_space
from twc_env.maps import load_map
from twc_env.messages import Belief, Contacts, SensorFrame
from twc_env.random_streams import random_stream
from twc_env.slam.modes import Engine, make_engine
from twc_env.world.floorplan import Floorplan
from twc_env.world.link import Link
from twc_env.world.world import World

Array = NDArray

STATE_LIMIT = 1e4


class ExplorationEnv(ParallelEnv, EzPickle):
    """Several robots explore a building while a cooperative SLAM engine maps it inside every step.

    Robots start with no common frame, their odometry drifts, rooms look alike and signs repeat. What an agent does
    decides which places the engine recognises, and so how good the team's map becomes; that map is what is rewarded.

    Agents: "robot_0" ... "robot_{n-1}". All live for the whole episode, which is truncated after `max_cycles` steps.

    Action, `Box(-1, 1, (2,))`: forward speed and turn rate (left positive) as shares of `dynamics.speed_max_m_s` and
    `dynamics.turn_rate_max_rad_s`.

    Observation, a `Dict`, built from sensor frames and estimates only:

    | key | shape | range | meaning |
    |---|---|---|---|
    | `lidar` | (beams,) | [0, 1] | range over maximum range; beam 0 ahead, counter-clockwise |
    | `map` | (3, 64, 64) uint8 | 0, 255 | merged map around the robot, it looks along +column: free, wall, mates |
    | `pose` | (4,) | m, m, -, - | x, y, cos, sin of the heading estimated in the map frame of the robot's group |
    | `wifi` | (16,) | [0, 1] | strength per transmitter, -100..-20 dBm; a slot keeps its transmitter; 0: not heard |
    | `signs` | (4, 3) | [-1, 1] | texts read in this step, nearest first: present, bearing / pi, range / maximum |
    | `team` | (n-1, 4) | [-1, 1] | per mate: shares my map, bearing / pi, distance d / (d + 10 m), heading / pi |

    Reward: sum of named terms times the weights of `reward`; the terms stand in `info["reward_terms"]`. By default each
    agent gets the gain in correctly mapped area [m2] of the largest rightly merged group, so that an episode's sum is
    the area at its end. The map is judged every `reward.period_steps` steps and at the last.

    `slam.mode = "off"` runs no engine: `pose` is odometry summed up, `map` and `team` stay zero, `correct_area` pays
    nothing (there is no map), and `result()` judges dead reckoning.

    Arguments: `map` (bundled name or file), `robots`, `max_cycles` and `render_mode` ("rgb_array" or None); `config`
    (an EnvConfig, a dict of overrides, dotted keys allowed) holds everything else. `reset(options={"starts": "map"})`
    uses the map's own starts instead of drawing them by seed.

    `belief(agent)` gives a planner what the robot knows; `result()` judges the episode so far against the truth.

    Versions: v0, first release.
    """

    metadata = {  # noqa: RUF012
        "name": "twc_env_explore_v0",
        "render_modes": ["rgb_array"],
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
    ):
        self.config = _resolve(config, {"map": map, "robots": robots, "max_cycles": max_cycles})
        # Copies are made from the resolved values: a dict may be changed by its owner later.
        EzPickle.__init__(self, config=self.config, render_mode=render_mode, floorplan=floorplan)
        self.metadata = copy.deepcopy(type(self).metadata)
        if render_mode not in (None, "rgb_array"):
            raise ConfigError(f"render_mode must be 'rgb_array' or None; got {render_mode!r}")
        self.render_mode = render_mode
        self.floorplan = floorplan if floorplan is not None else load_map(self.config.map)
        count = self.config.robots
        self.possible_agents = [f"robot_{i}" for i in range(count)]
        self.agents: list[str] = []
        shared_observation, shared_action = observation_space(self.config), action_blocks.velocity_space()
        self.observation_spaces = dict.fromkeys(self.possible_agents, shared_observation)
        self.action_spaces = dict.fromkeys(self.possible_agents, shared_action)
        self.state_space = spaces.Box(-STATE_LIMIT, STATE_LIMIT, (6 * count,), np.float32)
        self._world = World(self.config, self.floorplan)
        self._engine: Engine | None = None
        self._seed: int | None = None
        self._cells = self.floorplan.cells()

    def observation_space(self, agent: str) -> spaces.Space:
        """The same object for every agent, at every call."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space:
        """The same object for every agent, at every call."""
        return self.action_spaces[agent]

    def reset(self, seed: int | None = None, options: dict | None = None):
        """Begin an episode. The same seed gives the same episode; without one, the next seed after the last is used."""
        self._seed = self._next_seed() if seed is None else _checked_seed(seed)
        starts = (options or {}).get("starts", "random")
        self._world.reset(self._seed, starts)
        count = self.config.robots
        self._engine = make_engine(self.config, count)
        self._link = Link(self.config.link, count, self.floorplan.home.wall_index, random_stream(self._seed, "link"))
        self._builders = [ObservationBuilder(self.config, robot) for robot in range(count)]
        self._record = evaluation.EpisodeRecord(count)
        self._area_m2 = 0.0
        self._steps = 0
        self.agents = self.possible_agents[:]
        frames = self._world.sense()
        self._think(frames)
        return self._observe(frames), {agent: {} for agent in self.agents}

    def step(self, actions: Mapping[str, Array]):
        """Move all robots for one time step, sense, run SLAM, judge.

        Raises ActionError for a missing, malformed, non-finite or out-of-range action.
        """
        if not self.agents:
            raise TwcError("step() was called after the episode's end: call reset() first")
        self._world.step(action_blocks.decode_velocity(actions, self.agents, self.config.dynamics))
        self._steps += 1
        is_last = self._steps >= self.config.max_cycles
        frames = self._world.sense()
        self._think(frames)
        if is_last:
            self.engine.finish()
        values = self._judge(is_last)
        observations = self._observe(frames)
        agents = self.agents
        self.agents = [] if is_last else agents
        return (
            observations,
            {agent: rewards.weigh(v, self.config.reward) for agent, v in zip(agents, values, strict=True)},
            dict.fromkeys(agents, False),
            dict.fromkeys(agents, is_last),
            {agent: {"reward_terms": v} for agent, v in zip(agents, values, strict=True)},
        )

    @property
    def engine(self) -> Engine:
        """The SLAM engine of this episode. Raises TwcError before the first `reset`."""
        if self._engine is None:
            raise TwcError("no episode has begun: call reset() first")
        return self._engine

    @property
    def frames(self) -> tuple[SensorFrame, ...]:
        """What each robot sensed in the last step; `twc_env.datasets.write_frame_log` records them."""
        return self._frames

    @property
    def record(self) -> evaluation.EpisodeRecord:
        """What truly happened in this episode, for judging; no agent may read it."""
        return self._record

    @property
    def contacts(self) -> Contacts:
        """Who heard whom in the last step."""
        return self._contacts

    def belief(self, agent: str) -> Belief:
        """What one robot knows: the merged map of its group and where it is in it. Estimates only."""
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
            self.config, self._seed or 0, self.floorplan, self.engine, self._record, self.engine.bytes_sent
        )

    def render(self) -> Array | None:
        """(height, width, 3) uint8 picture of truth and merged map, or None when no render_mode was chosen."""
        if self.render_mode is None:
            return None
        from twc_env.exploration.rendering import render, scene_of

        return render(scene_of(self.floorplan, self.engine, self._record, self._cells))

    def close(self) -> None:
        """Nothing to release."""

    def _next_seed(self) -> int:
        return int(np.random.default_rng().integers(2**31)) if self._seed is None else self._seed + 1

    def _think(self, frames: tuple[SensorFrame, ...]) -> None:
        """Front ends, link and mappers take in one set of frames."""
        self._frames = frames
        self._contacts = self._link.contacts(self._world.poses_home[:, :2])
        self.engine.track(frames)
        self.engine.absorb(self._steps, self._contacts)
        self._record.append(
            self._world.poses,
            [robot.pose_odom for robot in self.engine.robots],
            [frame.odometry for frame in frames],
            self._world.contacts,
        )

    def _judge(self, is_last: bool) -> list[dict[str, float]]:
        before = self._area_m2
        if is_last or self._steps % self.config.reward.period_steps == 0:
            verdicts = evaluation.judge(self.engine, self._record, self._cells)
            self._area_m2 = evaluation.rightly_mapped_m2(verdicts)
        estimated = [self.engine.pose_map_robot(r) for r in range(self.config.robots)]
        transition = rewards.Transition(self._world.poses, estimated, self._world.contacts, self._area_m2, before)
        return [rewards.terms(transition, robot) for robot in range(self.config.robots)]

    def _observe(self, frames: tuple[SensorFrame, ...]) -> dict[str, dict[str, Array]]:
        return {
            agent: builder.build(frame, self.engine.belief(frame.robot, with_signs=False))
            for agent, builder, frame in zip(self.agents, self._builders, frames, strict=True)
        }


def _checked_seed(seed: int) -> int:
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise ConfigError(f"seed must be a whole number from 0 on; got {seed!r}")
    return int(seed)


def _resolve(config: EnvConfig | Mapping[str, Any] | None, shortcuts: dict[str, Any]) -> EnvConfig:
    """One config from a ready one or overrides (nested or dotted), with the constructor's shortcuts on top."""
    if config is None:
        resolved = EnvConfig()
    elif isinstance(config, EnvConfig):
        resolved = config
    elif isinstance(config, Mapping):
        nested = {key: value for key, value in config.items() if "." not in key}
        resolved = override(from_dict(nested), {key: value for key, value in config.items() if "." in key})
    else:
        raise ConfigError(f"config must be an EnvConfig or a dict of settings; got {config!r}")
    return override(resolved, {key: value for key, value in shortcuts.items() if value is not None})
