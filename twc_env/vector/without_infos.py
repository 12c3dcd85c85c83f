"""A wrapper with empty infos, for tools that require infos with fixed keys (TorchRL)."""

from __future__ import annotations

from typing import Any

from pettingzoo import AECEnv
from pettingzoo.utils import BaseParallelWrapper
from pettingzoo.utils.wrappers import BaseWrapper


class WithoutInfos(BaseParallelWrapper):
    """The wrapped environment with empty infos; `action_mask` is also part of the observations.

    Of either API: that of an AEC environment is an AEC environment again.
    """

    def __new__(cls, env: Any) -> Any:
        """The wrapper of the environment's API."""
        return _TurnsWithoutInfos(env) if isinstance(env, AECEnv) else super().__new__(cls)

    def reset(self, seed: int | None = None, options: dict | None = None):
        """Begin an episode."""
        observations, infos = super().reset(seed=seed, options=options)
        return observations, _emptied(infos)

    def step(self, actions: dict[str, Any]):
        """One step."""
        *seen, infos = super().step(actions)
        return *seen, _emptied(infos)


class _TurnsWithoutInfos(BaseWrapper):
    @property
    def infos(self) -> dict[str, Any]:
        return _emptied(self.env.infos)


def _emptied(infos: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {agent: {} for agent in infos}
