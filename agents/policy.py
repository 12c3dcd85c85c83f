"""Base class of team policies, and their names; FILE.py:CLASS names a user-defined one."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from twc_env.config import EnvConfig
from twc_env.errors import ConfigError, one_of
from twc_env.records.class_file import check_call, class_in, is_in_file
from twc_env.records.messages import Belief

from .roster import TEAMS

if TYPE_CHECKING:
    from twc_env import ExplorationEnv


LEARNED = "learned"
"""Name of the team that plays a policy which comes with the package (`twc_env/learned_team.py`)."""


class Policy(Protocol):
    """Controls a whole team from the robots' beliefs. Subclasses must implement `act` only."""

    def __init__(self, config: EnvConfig):
        """`config.dynamics` has the robots' limits."""

    def reset(self, seed: int, agents: Sequence[str]) -> None:
        """Prepare for a new episode with these agents; discards all state."""

    @abstractmethod
    def act(self, beliefs: dict[str, Belief]) -> dict[str, NDArray]:
        """For each agent (2,) float32 in [-1, 1]: forward speed and turn rate as fractions of their maxima."""

    def finished(self, beliefs: dict[str, Belief]) -> bool:
        """Whether there is nothing left to do, so that the episode may end early."""


def is_model(name: str) -> bool:
    """Whether a team is a trained model: a model file (also of 0.1.0, to refuse it), the folder of a run, or `learned`,
    which is shipped."""
    if name == LEARNED or str(name).endswith((".safetensors", ".zip")):
        return True
    try:
        return not is_in_file(str(name)) and (Path(str(name)) / "config.json").is_file()
    except OSError:  # no path, such as a name that is too long
        return False


def policy_names() -> tuple[str, ...]:
    """Names `make_policy` knows."""
    return tuple(sorted(TEAMS))


def make_policy(name: str, config: EnvConfig | None = None) -> Policy:
    """Create a policy for robots with the limits in `config.dynamics`; `name` may be FILE.py:CLASS, or a run folder or
    model of `twc-env train`.

    Where there are people or furniture, the robots of our teams wait for those who move close to them and remember what
    they bumped into (`careful.CarefulTeam`).

    Raises ConfigError for an unknown name, and unless `action.kind` is `velocity`; DataError for a model that cannot be
    read.
    """
    if name not in TEAMS and not is_model(name) and not is_in_file(str(name)):
        if str(name).endswith(".py"):
            raise ConfigError(f"{name} names a file and no class in it; write {name}:CLASS, for example {name}:Mine")
        begun = [team for team in TEAMS if team.startswith(str(name))]
        known = begun or [*policy_names(), LEARNED]
        told = one_of(name, known, "choose one of")
        raise ConfigError(f"unknown agent {name!r}; your own is FILE.py:CLASS or a run folder of train{told}")
    config = config or EnvConfig()
    if config.action.kind != "velocity":
        raise ConfigError(
            f"scripted teams need action.kind = 'velocity'; got {config.action.kind!r}: remove this setting"
        )
    if is_model(name):
        from twc_env.learned_team import LearnedTeam  # imports the engine, which --help does without

        learned: Policy = LearnedTeam(config, None if name == LEARNED else Path(str(name)))
        return learned
    if name in TEAMS:
        team = TEAMS[name]
        module = import_module(f"{__package__}.{team.module}")
        scripted: Policy = getattr(module, team.class_name)(config)
        if config.people.count or config.clutter.furniture:
            careful: Policy = import_module(f"{__package__}.careful").CarefulTeam(scripted, config)
            return careful
        return scripted
    return _of_user(name, config)


def _of_user(name: str, config: EnvConfig) -> Policy:
    """A policy of a class that FILE.py:CLASS names. Raises ConfigError if it cannot be called as a `Policy`."""
    remedy = "derive it from twc_env.agents.Policy, or add what lacks"
    own = class_in(name, ("reset", "act", "finished"), remedy)
    how = "as twc_env.agents.Policy says"
    check_call(f"{name}, when it is made,", how, own, config)
    policy: Policy = own(config)
    check_call(f"{name}.reset", how, policy.reset, 0, ())
    check_call(f"{name}.act", how, policy.act, {})
    check_call(f"{name}.finished", how, policy.finished, {})
    return policy


def is_finished(policy: Policy, beliefs: dict[str, Belief]) -> bool:
    """Whether a team ends the episode. Raises ConfigError if it says neither yes nor no."""
    told = policy.finished(beliefs)
    if told is not None and not isinstance(told, (bool, np.bool_, int)):
        raise ConfigError(f"{type(policy).__name__}.finished must return True or False; got {told!r:.60}")
    return bool(told)


def begin(policy: Policy, agent: str, env: ExplorationEnv, seed: int) -> None:
    """Prepare a policy made by `make_policy(agent)` for the episode that has begun; only oracles are given the truth.

    What users write as FILE.py:CLASS is never given it.
    """
    policy.reset(seed, env.possible_agents)
    if is_model(agent):
        learned: Any = policy
        learned.watch(lambda: env.frames)
    if agent in TEAMS and TEAMS[agent].is_oracle:
        oracle: Any = policy
        oracle.give_truth(env.floorplan, env.state)
