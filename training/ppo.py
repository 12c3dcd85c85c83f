"""Proximal policy optimisation (stable-baselines3): one policy shared by all robots of all teams. Runnable alone.

Each robot chooses between the frontiers of its map, a sign, a teammate, or staying; `encoder` scores the choices.
Masked choices have probability 0. Unlike `mappo`, this is the standard algorithm: a busy robot counts as one that
decides to go on, and the discount counts decisions.
"""

from __future__ import annotations

import time
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray as Array
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import MultiInputActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.utils import set_random_seed
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from torch import Tensor, nn
from twc_env.training.checkpoint import below, load, prefixed, save
from twc_env.training.encoder import Actor, Encoder
from twc_env.training.episode_totals import EpisodeTotals
from twc_env.training.learning_curve import LearningCurve
from twc_env.training.run_folder import Task, check_choices, check_run, open_run
from twc_env.training.team_notes import TeamNotes
from twc_env.training.weights import arrays_of, arrays_of_adam, fill, fill_adam

from twc_env.records.random_streams import random_stream
from twc_env.vector.sb3 import TeamVecEnv


@dataclass(frozen=True, slots=True)
class Settings:
    """Hyperparameters; defaults are those of stable-baselines3 unless noted."""

    seed: int = 0
    """Seed of the policy's weights, its sampling and the episodes."""
    steps: int = 181_000
    """Total decisions of all robots, rounded up to whole updates; a busy robot counts as one per step."""
    environments: int = 8
    """Number of parallel teams."""
    workers: int = 2
    """Worker processes; 0: run in this process."""
    rollout_steps: int = 64
    """Decisions per robot between two updates, including those of busy robots to continue (stable-baselines3: 2048 per
    environment)."""
    batch_size: int = 256
    """Samples per gradient step (stable-baselines3: 64)."""
    epochs: int = 10
    """Passes over each rollout."""
    learning_rate: float = 7e-4
    """Initial Adam step size (stable-baselines3: 3e-4), annealed linearly to 0 so that the result does not depend on
    the noise of the last few rollouts (stable-baselines3: constant)."""
    discount: float = 1.0
    """Discount per decision (stable-baselines3: 0.99). Decisions have different durations, so discounting would favour
    long ones, of which fewer are needed to reach the end."""
    gae_lambda: float = 0.95
    clip: float = 0.2
    entropy_weight: float = 0.005
    """Entropy bonus, against premature convergence (stable-baselines3: 0)."""
    hidden_size: int = 64
    """Width of the networks."""
    blind: tuple[str, ...] = ()
    """What the policy does not know of: some of teammates, signs and map (`blindness`). Its value function does."""
    from_rule: bool = True
    """Whether training starts from the weights of `RULE`; else from 0, where all choices are alike."""


class Seen(BaseFeaturesExtractor):
    """Passes all blocks on, by name."""

    def __init__(self, observation_space: spaces.Dict):
        super().__init__(observation_space, 1)

    def forward(self, seen: dict[str, Tensor]) -> dict[str, Tensor]:
        """The blocks."""
        return seen


class ChoiceNetworks(nn.Module):
    """Logits of the choices, and features of the value, which has its own encoder and also sees the return so far."""

    def __init__(self, space: spaces.Dict, width: int, blind: tuple[str, ...] = (), from_rule: bool = True):
        """blind, from_rule: as in `Settings`."""
        super().__init__()
        self.latent_dim_pi, self.latent_dim_vf = (space["frontiers"].shape or (0,))[0], width
        self.actor, self.critic = Actor(space, width, blind), Encoder(space, width)
        self.value = nn.Sequential(nn.Linear(width + 1, width), nn.Tanh())
        if not from_rule:
            nn.init.zeros_(self.actor.rule)

    def forward(self, seen: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        """Logits, and the features of the value."""
        return self.forward_actor(seen), self.forward_critic(seen)

    def forward_actor(self, seen: dict[str, Tensor]) -> Tensor:
        """(batch, choices) logits."""
        logits: Tensor = self.actor(seen)
        return logits

    def forward_critic(self, seen: dict[str, Tensor]) -> Tensor:
        """(batch, width)."""
        value: Tensor = self.value(torch.cat([self.critic(seen)[1], seen["gained"]], 1))
        return value


class ChoicePolicy(MultiInputActorCriticPolicy):
    """The standard actor-critic over `ChoiceNetworks`, whose first output is the logits."""

    def __init__(self, *arguments, settings: Settings, **options):
        self._settings = settings
        super().__init__(*arguments, **{**options, "features_extractor_class": Seen})

    def _build_mlp_extractor(self) -> None:
        self.mlp_extractor = ChoiceNetworks(
            self.observation_space, self._settings.hidden_size, self._settings.blind, self._settings.from_rule
        )

    def _build(self, lr_schedule) -> None:
        super()._build(lr_schedule)
        self.action_net = nn.Identity()
        self.optimizer = self.optimizer_class(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)


class NotedTeams(VecEnvWrapper):
    """Adds the observations of `TeamNotes`, and rewards the mean over time: what is mapped when a share of the time is
    left pays that share.

    The time limit is the end of the episode, as the clock is seen and there is no return after it.
    """

    def __init__(self, rows: TeamVecEnv, max_cycles: int):
        super().__init__(rows, TeamNotes.space(rows.observation_space))
        self._rows, self._robots = rows, rows.robots
        self._new_notes = partial(TeamNotes, rows.teams.count, rows.robots, max_cycles)

    def reset(self):
        """Reset the teams and the added observations."""
        self.notes, self.totals, self.seen = self._new_notes(), EpisodeTotals(self._rows.teams.count), self.venv.reset()
        return self.notes.beside(self.seen)

    def step_async(self, actions):
        """Send actions to the teams, and record the goals."""
        self.notes.note_choices(self.seen, actions)
        self.venv.step_async(actions)

    def step_wait(self):
        """Results of the teams, without `TimeLimit.truncated`, so that no value is added at the time limit. The first
        info of a team whose episode has ended has `told`, what it was like."""
        self.seen, rewards, dones, infos = self.venv.step_wait()
        self.notes.note_outcome(np.array([info["time_steps"] for info in infos]))
        paid = rewards * self.notes.time_left()
        self.notes.note_outcome(0, rewards, dones)
        for info in infos:
            info.pop("TimeLimit.truncated", None)
        for k in range(self._rows.teams.count):
            own = slice(k * self._robots, (k + 1) * self._robots)
            if told := self.totals.add(k, paid[own], rewards[own], infos[own], dones[own.start]):
                infos[own.start]["told"] = told
        return self.notes.beside(self.seen), paid.astype(np.float32), dones, infos

    def snapshot(self) -> tuple[dict[str, Array], dict[str, Any]]:
        """Arrays and values from which `restore` plays on exactly."""
        teams, notes = prefixed("teams.", self._rows.teams.snapshot()), prefixed("notes.", self.notes.arrays())
        return {**teams, **notes}, {"totals": self.totals.of}

    def restore(self, arrays: dict[str, Array], told: dict[str, Any]) -> tuple[dict[str, Array], Array]:
        """Observations, and whether they are the first of an episode."""
        self.notes, self.totals = self._new_notes(), EpisodeTotals(self._rows.teams.count)
        self.notes.fill(below(arrays, "notes."))
        self.totals.of = told["totals"]
        teams = below(arrays, "teams.")
        seen = self._rows.teams.restore(teams)
        self.seen = {name: block.reshape(-1, *block.shape[2:]) for name, block in seen.items()}
        begins = [not len(teams[f"actions.{k}"]) for k in range(self._rows.teams.count)]
        return self.notes.beside(self.seen), np.repeat(begins, self._robots)


def train(
    task: Task,
    settings: Settings,
    folder: Path,
    resume: bool = False,
    show_progress: bool = True,
    ray: str | None = None,
) -> Path:
    """Train until a total of `settings.steps` decisions; returns the path of the saved model, written after each
    update.

    `resume` continues from the model in `folder`, with the result of a run that was never interrupted; task and
    settings must be the same, except for the workers. ray: address of a Ray cluster whose workers play, or "auto"; the
    result is the same. Raises DataError if there is nothing to resume, if the folder holds a run and `resume` is not
    given, or if another process trains in it.
    """
    torch.set_num_threads(1)
    config = check_choices(task)
    check_run(folder, "ppo", task, settings, resume)
    raw = TeamVecEnv(settings.environments, config, settings.workers, task.training_maps, settings.seed, ray)
    with closing(NotedTeams(raw, config.max_cycles)) as teams, open_run(folder, "ppo", task, settings, resume) as path:
        model = _new_model(teams, settings)
        told = load_into(model, teams, path) if resume else {}
        with LearningCurve(folder, settings.steps, model.num_timesteps, told, show_progress) as curve:
            if (left := settings.steps - model.num_timesteps) > 0:
                model.learn(left, Saving(curve, settings.seed, teams, path), reset_num_timesteps=False)
    return path


def _new_model(teams: VecEnv, settings: Settings) -> PPO:
    return PPO(
        ChoicePolicy,
        teams,
        seed=settings.seed,
        n_steps=settings.rollout_steps,
        batch_size=min(settings.batch_size, settings.rollout_steps * teams.num_envs),
        n_epochs=settings.epochs,
        learning_rate=partial(falling, settings.learning_rate),
        gamma=settings.discount,
        gae_lambda=settings.gae_lambda,
        clip_range=settings.clip,
        ent_coef=settings.entropy_weight,
        policy_kwargs={"settings": settings},
        device="cpu",
    )


def falling(first: float, left: float) -> float:
    """A step size proportional to the share of remaining decisions; the last rollout may exceed the total."""
    return first * max(left, 0.0)


class Saving(BaseCallback):
    """After each update: note it on the learning curve, and save everything. What is random until the next one follows
    from the seed and the number of decisions."""

    def __init__(self, curve: LearningCurve, seed: int, teams: NotedTeams, path: Path):
        super().__init__()
        self._curve, self._seed, self._teams, self._path = curve, seed, teams, path
        self._new = 0
        """Decisions since the last update."""

    def _on_rollout_start(self) -> None:
        self._note_update()
        self._began_s, self._new, self._ended = time.perf_counter(), 0, list[dict]()
        set_random_seed(int(random_stream(self._seed, "sampling", self.num_timesteps).integers(2**31)))

    def _on_step(self) -> bool:
        self._new += self._teams.num_envs
        self._ended += [info["told"] for info in self.locals["infos"] if "told" in info]
        return True

    def _on_training_end(self) -> None:
        self._note_update()

    def _note_update(self) -> None:
        if not self._new:
            return
        figures: dict[str, Any] = {k: v for k, v in self.logger.name_to_value.items() if k.startswith("train/")}
        figures["speed/decisions_per_s"] = self._new / (time.perf_counter() - self._began_s)
        self._curve.note(self.num_timesteps, self._new, self._ended, figures)
        assert isinstance(self.model, PPO)
        save_model(self.model, self._teams, self._path, self._curve.values())


def save_model(model: PPO, teams: NotedTeams, path: Path, curve: dict[str, Any]) -> None:
    """Save whole or not at all."""
    arrays, told = teams.snapshot()
    arrays = {
        **arrays_of(model.policy, "policy."), **arrays_of_adam(model.policy.optimizer, "optimizer."),
        **prefixed("rollouts.", arrays),
    }  # fmt: skip
    save(path, arrays, {**told, "decisions": model.num_timesteps, "updates": model._n_updates, "curve": curve})


def load_into(model: PPO, teams: NotedTeams, path: Path) -> dict[str, Any]:
    """Continue a file's training in a new model of the same settings; returns what its learning curve told."""
    arrays, values = load(path)
    fill(model.policy, below(arrays, "policy."), path)
    fill_adam(model.policy.optimizer, below(arrays, "optimizer."), path)
    model.num_timesteps, model._n_updates = int(values["decisions"]), int(values["updates"])
    seen, model._last_episode_starts = teams.restore(below(arrays, "rollouts."), values)
    model._last_obs = seen
    curve: dict[str, Any] = values["curve"]
    return curve


if __name__ == "__main__":
    import runpy
    import sys

    sys.argv[1:1] = ["train", "ppo"]
    runpy.run_module("twc_env", run_name="__main__")
