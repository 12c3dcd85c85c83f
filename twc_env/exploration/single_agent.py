"""One robot's view as a gymnasium environment (ids: `twc_env.tasks`), for single-agent tools."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from os import PathLike
from typing import Any

import gymnasium
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

from twc_env.config import EnvConfig
from twc_env.config.checks import refuse_arguments, whole_number
from twc_env.errors import ConfigError
from twc_env.exploration.assessment.evaluation import EpisodeResult
from twc_env.exploration.environment import ExplorationEnv
from twc_env.exploration.settings import resolve
from twc_env.records.messages import Belief

TEAM_SETTINGS = "robots", "team", "robot"
"""Settings that say how many robots there are."""


class SingleRobotEnv(gymnasium.Env):
    """`ExplorationEnv` with one robot: same observation, action and reward, without the dictionaries per agent."""

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 10}  # noqa: RUF012

    def __init__(
        self,
        map: str | PathLike[str] | None = None,
        max_cycles: int | None = None,
        config: EnvConfig | Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        task: str | None = None,
        render_signal: bool = False,
        **unknown: Any,
    ):
        """Arguments as of `ExplorationEnv`. Raises ConfigError for unknown arguments, and for `robots` other
        than 1, also in a dict of settings."""
        _refuse(unknown)
        if "robots" not in unknown:
            _refuse_team(config, task)
        self._team = ExplorationEnv(
            map=map,
            robots=1,
            max_cycles=max_cycles,
            config=config,
            render_mode=render_mode,
            task=task,
            render_signal=render_signal,
        )
        self._agent = self._team.possible_agents[0]
        self._spec: EnvSpec | None = None
        self.render_mode = render_mode
        self.observation_space = self._team.observation_space(self._agent)
        self.action_space = self._team.action_space(self._agent)

    @property
    def parallel(self) -> ExplorationEnv:
        """The wrapped environment."""
        return self._team

    @property
    def spec(self) -> EnvSpec | None:
        """The spec that `gymnasium.make` sets; where each step lasts one time step, with `max_cycles` as
        `max_episode_steps`, which some wrappers read."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = copy.copy(spec)
        is_of_time_steps = self._team.config.action.kind == "velocity"
        if self._spec is not None and self._spec.max_episode_steps is None and is_of_time_steps:
            self._spec.max_episode_steps = self._team.config.max_cycles

    def reset(self, *, seed: int | None = None, options: dict | None = None):
        """Begin an episode, see `ExplorationEnv.reset`. Without a seed, one is drawn by those drawn before, so that
        environments with neighbouring first seeds play different episodes."""
        seed = None if seed is None else whole_number("seed", seed, 0)
        super().reset(seed=seed)
        if seed is None:
            seed = int(self.np_random.integers(2**31))
        observations, infos = self._team.reset(seed, options)
        return observations[self._agent], infos[self._agent]

    def step(self, action):
        """One step, see `ExplorationEnv.step`."""
        observations, rewards, terminated, truncated, infos = self._team.step({self._agent: action})
        agent = self._agent
        return observations[agent], float(rewards[agent]), terminated[agent], truncated[agent], infos[agent]

    def action_masks(self) -> NDArray:
        """(choices,) bool: valid next choices; sb3-contrib's MaskablePPO calls this.

        Raises ConfigError unless `action.kind = "frontier"`.
        """
        macro_actions, kind = self._team.episode.macro_actions, self._team.config.action.kind
        if macro_actions is None or kind != "frontier":
            raise ConfigError(f"only choices have masks: action.kind must be 'frontier'; it is {kind!r}")
        return macro_actions.mask(0).astype(bool)

    def belief(self) -> Belief:
        """What the robot knows, see `ExplorationEnv.belief`."""
        return self._team.belief(self._agent)

    def result(self) -> EpisodeResult:
        """All figures of the episode so far, see `ExplorationEnv.result`; behind wrappers `env.unwrapped.result()`."""
        return self._team.result()

    def render(self):
        """See `ExplorationEnv.render`."""
        return self._team.render()

    def close(self) -> None:
        """Close the window of render_mode "human"."""
        self._team.close()


def _refuse(unknown: Mapping[str, Any]) -> None:
    """Raise ConfigError for unknown arguments and for a number of robots other than 1."""
    if unknown.get("robots", 1) != 1:
        robots = unknown["robots"]
        raise ConfigError(
            f"robots={robots!r}: this is the view of one robot; a team is twc_env.parallel_env(robots={robots!r}), "
            "or pettingzoo.make with the same id"
        )
    refuse_arguments(unknown.keys() - {"robots"}, SingleRobotEnv)


def _refuse_team(config: EnvConfig | Mapping[str, Any] | None, task: str | None) -> None:
    """Raise ConfigError for a dict of settings that asks for a team. An EnvConfig or a task has one unasked."""
    if isinstance(config, Mapping) and not config.keys().isdisjoint(TEAM_SETTINGS):
        robots = resolve(config, task, {}).robots
        if robots != 1:
            raise ConfigError(
                f"config asks for {robots} robots, and this is the view of one: also give robots=1 for the first of "
                "them, or take twc_env.parallel_env or pettingzoo.make with the same id"
            )
