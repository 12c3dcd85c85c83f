"""The team `learned` (extra `train`): a trained policy chooses goals, and robots drive there as in the environment."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig, FailureConfig, override, robot_configs
from twc_env.errors import ConfigError, DataError
from twc_env.exploration.macro_actions import MacroActions
from twc_env.exploration.observation.observation_blocks import block_spaces
from twc_env.exploration.observation.observations import ObservationBuilder
from twc_env.planning import as_action
from twc_env.records.messages import Belief, SensorFrame
from twc_env.records.team_messages import TeamBeliefs
from twc_env.running.terminal import tell

Frames = Callable[[], Sequence[SensorFrame]]


class LearnedTeam:
    """A `Policy` (twc_env.agents) whose robots choose as a trained policy: that of a run, or the shipped one that suits
    the settings best."""

    def __init__(self, config: EnvConfig, model: Path | None = None):
        """model: the folder of a run, or its model; None: the shipped one. Raises ConfigError for settings that it
        cannot play, DataError for a model that cannot be read, and if no policy is shipped or a library lacks."""
        if config.failure != FailureConfig() or config.slam.mode == "off":
            raise ConfigError(
                "learned needs the sensors of all robots and their maps: remove failure.* and slam.mode=off"
            )
        try:
            from twc_env.training.run_folder import model_in, read_settings, task_of
            from twc_env.training.shipped import shipped_for
            from twc_env.training.trained_policy import load_actor, sampling
        except ModuleNotFoundError as error:
            raise DataError(f"learned needs {error.name}; install it with: pip install 'twc_env[train]'") from None
        path = model_in(model or shipped_for(config))
        folder = path.parent
        trained = task_of(read_settings(folder)).config
        view: dict[str, Any] = {"action": asdict(trained.action), "observation": asdict(trained.observation)}
        self._config = override(config, view)
        actor = load_actor(path, spaces.Dict(block_spaces(self._config)))
        self._sampling = partial(sampling, actor, self._config)
        which = f"learned: the shipped policy for {folder.name}" if model is None else f"{folder}: a policy"
        tell(
            f"{which}, trained with {trained.robots} robots in {trained.map}; "
            f"here {config.robots} robots in {config.map}"
        )

    def reset(self, seed: int, agents: Sequence[str]) -> None:
        """Prepare for a new episode."""
        self._choose = self._sampling(seed)
        self._actions, self._builder = MacroActions(self._config), ObservationBuilder(self._config)
        self._agents, self._own = list(agents), robot_configs(self._config)
        self._ticks, self._is_due = 0, True

    def watch(self, frames: Frames) -> None:
        """What robots sense, of which beliefs do not tell all: `frames()` gives that of the latest time step."""
        self._frames = frames

    def act(self, beliefs: dict[str, Belief]) -> dict[str, Array]:
        """As in `Policy`."""
        team = TeamBeliefs.of(list(beliefs.values()))
        self._builder.notice(self._frames(), team)
        if self._ticks:
            self._is_due = self._actions.is_decision_due(np.ones(len(beliefs), bool))
        if self._is_due:
            self._actions.look(team)
            masks = [self._actions.mask(robot) for robot in range(len(beliefs))]
            seen = self._builder.build(self._actions.candidates, masks)
            choices = self._choose(dict(zip(self._agents, seen, strict=True)), self._ticks)
            self._actions.assign(choices, self._agents, team)
        self._ticks += 1
        commands = zip(self._agents, self._actions.commands(team).tolist(), self._own, strict=True)
        return {agent: as_action(command[0], command[1], own.dynamics) for agent, command, own in commands}

    def finished(self, beliefs: dict[str, Belief]) -> bool:
        """Never: who has nothing left to explore stays."""
        return False
