"""What the present episodes of several teams have earned so far."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

ENDS = "merged_robots", "wrong_merges", "team_ate_m"
"""Of the last info of an episode."""


class EpisodeTotals:
    """Per team the sums of its episode: `score` (the mean over time, as it is paid), `return`, `steps` (time steps),
    and each term of the reward; means over the robots."""

    def __init__(self, teams: int):
        self.of: list[dict[str, float]] = [{} for _ in range(teams)]

    def add(self, team: int, paid: Array, rewards: Array, infos: Sequence[dict[str, Any]], has_ended: bool) -> dict:
        """Add a step, given what its robots were paid and rewarded with. Returns what the episode was like if it has
        ended, else nothing."""
        terms = [info["reward_terms"] for info in infos]
        new = {"score": np.mean(paid), "return": np.mean(rewards), "steps": infos[0]["time_steps"]}
        new |= {f"terms/{name}": np.mean([each[name] for each in terms]) for name in terms[0]}
        before = self.of[team]
        self.of[team] = total = {name: before.get(name, 0.0) + float(value) for name, value in new.items()}
        if not has_ended:
            return {}
        self.of[team] = {}
        return {**total, **{name: infos[0][name] for name in ENDS}}
