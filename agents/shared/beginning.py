"""Whether a team was reset for the episode that it plays: if not, it would take goals of another one along."""

from __future__ import annotations

from collections.abc import Iterable

from twc_env.errors import TwcError
from twc_env.records.messages import Belief


class Beginning:
    """The agents that a team was reset for, and the last step of each."""

    def __init__(self, agents: Iterable[str]):
        self._steps = dict.fromkeys(agents, -1)

    def check(self, beliefs: dict[str, Belief]) -> None:
        """Raise TwcError for beliefs of an agent that is not known, or from before the last ones."""
        for agent, belief in beliefs.items():
            known = self._steps.get(agent)
            if known is None or belief.step < known:
                told = f"it knows no {agent!r}" if known is None else f"it was at step {known} before"
                raise TwcError(
                    f"this team has not begun the episode, which is at step {belief.step}: {told}; call "
                    "twc_env.agents.begin(team, NAME, env, seed) after each reset of the environment"
                )
            self._steps[agent] = belief.step
