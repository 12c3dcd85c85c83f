"""Proximal policy optimisation (stable-baselines3): one policy shared by all robots of all teams. Runnable alone.

Each robot chooses between the frontiers of its map, a sign, a teammate, or staying; `encoder` scores the choices.
Masked choices have probability 0. Unlike `mappo`, this is the standard algorithm: a busy robot counts as one that
decides to go on, and the discount counts decisions.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import MultiInputActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from torch import Tensor, nn
from twc_env.training.checkpoint import FILE_NAME, below, load, save
from twc_env.training.encoder import Actor, Encoder
from twc_env.training.learning_curve import LearningCurve
from twc_env.training.run_folder import Task, check_choices, check_same_run, write_settings
from twc_env.training.team_notes import TeamNotes
from twc_env.training.weights import arrays_of, arrays_of_adam, fill, fill_adam

from twc_env.errors import DataError, WorkerError
from twc_env.running.output_folder import alone_in
from twc_env.vector.sb3 import TeamVecEnv

ACTOR = "policy.mlp_extractor.actor."
"""Prefix of the policy's own weights in a checkpoint."""


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


class Seen(BaseFeaturesExtractor):
    """Passes all blocks on, by name."""

    def __init__(self, observation_space: spaces.Dict):
        super().__init__(observation_space, 1)

    def forward(self, seen: dict[str, Tensor]) -> dict[str, Tensor]:
        """The blocks."""
        return seen


class ChoiceNetworks(nn.Module):
    """Logits of the choices, and features of the value, which has its own encoder and also sees the return so far."""

    def __init__(self, space: spaces.Dict, width: int):
        super().__init__()
        self.latent_dim_pi, self.latent_dim_vf = (space["frontiers"].shape or (0,))[0], width
        self.actor, self.judge = Actor(space, width), Encoder(space, width)
        self.worth = nn.Sequential(nn.Linear(width + 1, width), nn.Tanh())

    def forward(self, seen: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        """Logits, and the features of the value."""
        return self.forward_actor(seen), self.forward_critic(seen)

    def forward_actor(self, seen: dict[str, Tensor]) -> Tensor:
        """(batch, choices) logits."""
        logits: Tensor = self.actor(seen)
        return logits

    def forward_critic(self, seen: dict[str, Tensor]) -> Tensor:
        """(batch, width)."""
        worth: Tensor = self.worth(torch.cat([self.judge(seen)[1], seen["gained"]], 1))
        return worth


class ChoicePolicy(MultiInputActorCriticPolicy):
    """The standard actor-critic over `ChoiceNetworks`, whose first output is the logits."""

    def __init__(self, *arguments, width: int = 64, **options):
        self._width = width
        super().__init__(*arguments, **{**options, "features_extractor_class": Seen})

    def _build_mlp_extractor(self) -> None:
        self.mlp_extractor = ChoiceNetworks(self.observation_space, self._width)

    def _build(self, lr_schedule) -> None:
        super()._build(lr_schedule)
        self.action_net = nn.Identity()
        self.optimizer = self.optimizer_class(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)


class NotedTeams(VecEnvWrapper):
    """Adds the observations of `TeamNotes`, and rewards the mean over time: what is mapped when a share of the time is
    left pays that share.

    The time limit is the end of the episode, as the clock is seen and there is no return after it.
    """

    def __init__(self, teams: TeamVecEnv, max_cycles: int):
        super().__init__(teams, TeamNotes.space(teams.observation_space))
        self._teams, self._robots = teams.num_envs // teams.robots, teams.robots
        self._new_notes = partial(TeamNotes, self._teams, teams.robots, max_cycles)

    def reset(self):
        """Reset the teams and the added observations."""
        self.notes, self.seen = self._new_notes(), self.venv.reset()
        self._earned: list[dict[str, float]] = [{} for _ in range(self._teams)]
        return self.notes.beside(self.seen)

    def step_async(self, actions):
        """Send actions to the teams, and record the goals."""
        self.notes.note_choices(self.seen, actions)
        self.venv.step_async(actions)

    def step_wait(self):
        """Results of the teams, without `TimeLimit.truncated`, so that no value is added at the time limit. The first
        info of a team whose episode has ended has `told`, what it was like."""
        self.seen, rewards, dones, infos = self.venv.step_wait()
        took = np.array([info["time_steps"] for info in infos])
        self.notes.note_outcome(took)
        paid = rewards * self.notes.time_left()
        self.notes.note_outcome(0, rewards, dones)
        for info in infos:
            info.pop("TimeLimit.truncated", None)
        for k, earned in enumerate(self._earned):
            rows = slice(k * self._robots, (k + 1) * self._robots)
            own = {"score": paid[rows].mean(), "return": rewards[rows].mean(), "steps": took[rows.start]}
            terms = [info["reward_terms"] for info in infos[rows]]
            own |= {f"terms/{name}": np.mean([each[name] for each in terms]) for name in terms[0]}
            for name, value in own.items():
                earned[name] = earned.get(name, 0.0) + float(value)
            if dones[rows.start]:
                ends = "coverage_correct", "merged_robots", "wrong_merges", "team_ate_m"
                infos[rows.start]["told"] = {**earned, **{name: infos[rows.start][name] for name in ends}}
                self._earned[k] = {}
        return self.notes.beside(self.seen), paid.astype(np.float32), dones, infos


def train(task: Task, settings: Settings, folder: Path, resume: bool = False, show_progress: bool = True) -> Path:
    """Train until a total of `settings.steps` decisions; returns the path of the saved model.

    `resume` continues from the model in `folder`; task and settings must be the same, except for the workers. Episodes
    are drawn from the seed and the step count, so a resumed run is reproducible but differs from an uninterrupted one
    (that of `mappo` does not). Raises DataError if there is nothing to resume, if the folder holds a run and `resume`
    is not given, or if another process trains in it.
    """
    torch.set_num_threads(1)
    config, model_path = check_choices(task), folder / FILE_NAME
    if resume:
        check_same_run(folder, "ppo", task, settings)
    elif model_path.exists():
        raise DataError(f"{folder} already holds a model; continue with --resume or name another folder with --out")
    raw = TeamVecEnv(settings.environments, config, settings.workers, task.training_maps, settings.seed)
    teams = NotedTeams(raw, config.max_cycles)
    try:
        with alone_in(folder, patience_s=0.0):
            model, told = _new_model(teams, settings), {}
            if resume:
                told = load_into(model, model_path)
                teams.seed(settings.seed + model.num_timesteps)
                model.set_random_seed(settings.seed + model.num_timesteps)
            else:
                write_settings(folder, "ppo", task, asdict(settings))
            if settings.steps > model.num_timesteps:
                with LearningCurve(folder, settings.steps, model.num_timesteps, told, show_progress) as curve:
                    saving = Saving(curve, model_path)
                    model.learn(settings.steps - model.num_timesteps, saving, reset_num_timesteps=False)
                    save_model(model, model_path, curve.values())
    except WorkerError as error:
        remedy = "--resume continues from the last saved model, if any"
        raise DataError(f"a worker process has died (out of memory or killed); {remedy}") from error
    finally:
        teams.close()
    return model_path


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
        policy_kwargs={"width": settings.hidden_size},
        device="cpu",
    )


def falling(first: float, left: float) -> float:
    """A step size proportional to the share of remaining decisions; the last rollout may exceed the total."""
    return first * max(left, 0.0)


class Saving(BaseCallback):
    """After each rollout: note it on the learning curve, and save the model as of the update before."""

    def __init__(self, curve: LearningCurve, path: Path):
        super().__init__()
        self._curve, self._path = curve, path
        self._ended: list[dict] = []

    def _on_training_start(self) -> None:
        self._before = self.num_timesteps

    def _on_rollout_start(self) -> None:
        self._began_s, self._from = self._curve.now_s(), self.num_timesteps

    def _on_step(self) -> bool:
        self._ended += [info["told"] for info in self.locals["infos"] if "told" in info]
        return True

    def _on_rollout_end(self) -> None:
        new = self.num_timesteps - self._from
        figures: dict[str, Any] = {k: v for k, v in self.logger.name_to_value.items() if k.startswith("train/")}
        figures["speed/decisions_per_s"] = new / (self._curve.now_s() - self._began_s)
        self._curve.note(self.num_timesteps, new, self._ended, figures)
        self._ended = []
        if self._from > self._before:
            save_model(self.model, self._path, self._curve.values())


def save_model(model: PPO, path: Path, told: dict[str, Any]) -> None:
    """Save whole or not at all."""
    arrays = {**arrays_of(model.policy, "policy."), **arrays_of_adam(model.policy.optimizer, "optimizer.")}
    save(path, arrays, {"decisions": model.num_timesteps, "updates": model._n_updates, "curve": told})


def load_into(model: PPO, path: Path) -> dict[str, Any]:
    """Continue a file's training in a new model of the same settings; returns what its learning curve told."""
    arrays, values = load(path)
    fill(model.policy, below(arrays, "policy."), path)
    fill_adam(model.policy.optimizer, below(arrays, "optimizer."), path)
    model.num_timesteps, model._n_updates = int(values["decisions"]), int(values["updates"])
    told: dict[str, Any] = values["curve"]
    return told


if __name__ == "__main__":
    import runpy
    import sys

    sys.argv[1:1] = ["train", "ppo"]
    runpy.run_module("twc_env", run_name="__main__")
