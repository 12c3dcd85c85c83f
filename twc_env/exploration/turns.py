"""The environment under PettingZoo's AEC API, in which the robots are asked for their actions one after another."""

from __future__ import annotations

from typing import Any

from pettingzoo.utils.conversions import parallel_to_aec_wrapper

from twc_env.exploration.actions import one_by_one
from twc_env.exploration.macro_actions import parsed_action
from twc_env.exploration.snapshot import Snapshot


class TurnsEnv(parallel_to_aec_wrapper):
    """PettingZoo's own conversion, except for `unwrapped`, and that a malformed action is refused at its robot's turn.

    `unwrapped` of PettingZoo is the parallel environment, which has no rewards or terminations that wrappers such as
    `TerminateIllegalWrapper` could change, and an object of PettingZoo's own class fails its `api_test`.
    """

    env: Any

    def step(self, action: Any) -> None:
        """Take the action of the robot whose turn it is; raises ActionError for a malformed one, and it stays its
        turn."""
        agent = self.agent_selection
        if not (self.terminations[agent] or self.truncations[agent]):
            config = self.env.unwrapped.config.action
            if config.kind == "velocity":
                one_by_one({agent: action}, [agent])
            else:
                parsed_action(config, action, agent)
        super().step(action)

    def restore(self, snapshot: Snapshot) -> None:
        """Continue from a snapshot (`ExplorationEnv.restore`); the first robot's turn begins."""
        begun = self.env.unwrapped.restore(snapshot)
        if not self.env.agents:  # the episode was over
            self.agents.clear()
            return
        env, self.env = self.env, _Restored(self.env.agents, begun)
        try:
            super().reset()
        finally:
            self.env = env

    @property
    def unwrapped(self) -> Any:
        """The turns, and what only the parallel environment has, such as `result()`."""
        return _Unwrapped(self)


class _Restored:
    """What PettingZoo's `reset` of the turns asks the parallel environment for."""

    def __init__(self, agents: list[str], begun: tuple[dict, dict]):
        self.agents, self._begun = agents, begun

    def reset(self, seed: int | None = None, options: dict | None = None) -> tuple[dict, dict]:
        """Observations and infos of the restored episode."""
        return self._begun


class _Unwrapped:
    """Attributes of the turns, or else of the parallel environment; new values are those of the turns."""

    def __init__(self, turns: TurnsEnv):
        self.__dict__["_turns"] = turns

    def __getattr__(self, name: str) -> Any:
        turns = self.__dict__["_turns"]
        return getattr(turns if hasattr(turns, name) else turns.env, name)

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(self.__dict__["_turns"], name, value)
