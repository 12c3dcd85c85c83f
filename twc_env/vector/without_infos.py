"""A wrapper with empty infos, for tools that require infos with fixed keys (TorchRL)."""

from __future__ import annotations

from typing import Any

from pettingzoo.utils import BaseParallelWrapper


class WithoutInfos(BaseParallelWrapper):
    """The wrapped environment with empty infos; `action_mask` is also part of the observations."""

    def reset(self, seed: int | None = None, options: dict | None = None):
        """Begin an episode."""
        observations, infos = super().reset(seed=seed, options=options)
        return observations, _emptied(infos)

    def step(self, actions: dict[str, Any]):
        """One step."""
        *seen, infos = super().step(actions)
        return *seen, _emptied(infos)


def _emptied(infos: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {agent: {} for agent in infos}
