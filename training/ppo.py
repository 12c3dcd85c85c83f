"""Proximal policy optimisation (stable-baselines3): one policy drives every robot of every team. Runnable alone.

Each robot chooses among the frontiers of its map; choices that the mask rules out get no probability.
"""

from __future__ import annotations

import csv
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import MultiInputActorCriticPolicy
from tqdm import tqdm

from training.run_folder import Task, read_settings, write_settings
from twc_env.errors import DataError
from twc_env.sb3 import TeamVecEnv

COLUMNS = ("steps", "episodes", "mean_return", "mean_length", "steps_per_s")
EPISODES_SHOWN = 100
"""Mean return and length are those of so many rows of episodes that ended last."""


@dataclass(frozen=True, slots=True)
class Settings:
    """Settings of the algorithm; the defaults are those of stable-baselines3 where not noted."""

    seed: int = 0
    """Seeds the policy's weights, its sampling and the episodes."""
    environments: int = 8
    """Teams that explore side by side."""
    workers: int = 2
    """Processes that run them; 0: this one."""
    rollout_steps: int = 64
    """Decisions of each robot between two updates (stable-baselines3: 2048 of one environment)."""
    batch_size: int = 256
    """Samples per gradient step (stable-baselines3: 64)."""
    epochs: int = 10
    """Passes over each rollout."""
    learning_rate: float = 3e-4
    """Adam step size."""
    discount: float = 0.97
    """Weight of the next decision's return: one lasts up to ten seconds (stable-baselines3: 0.99)."""
    entropy_weight: float = 0.01
    """Keeps the policy from settling too early (stable-baselines3: 0)."""


class MaskedPolicy(MultiInputActorCriticPolicy):
    """The usual actor-critic, whose choices that `action_mask` rules out get no probability."""

    _mask: torch.Tensor

    def forward(self, obs, deterministic: bool = False):
        """Act, and say what it is worth."""
        self._remember(obs)
        return super().forward(obs, deterministic)

    def evaluate_actions(self, obs, actions: torch.Tensor):
        """How likely actions are now, and what they are worth."""
        self._remember(obs)
        return super().evaluate_actions(obs, actions)

    def get_distribution(self, obs):
        """The choices with their probabilities; `predict` asks for it."""
        self._remember(obs)
        return super().get_distribution(obs)

    def _remember(self, obs) -> None:
        mask = obs["action_mask"]
        self._mask = mask.reshape(len(mask), -1) > 0

    def _get_action_dist_from_latent(self, latent_pi: torch.Tensor):
        logits = self.action_net(latent_pi).masked_fill(~self._mask, -1e9)
        return self.action_dist.proba_distribution(action_logits=logits)


def train(
    task: Task, settings: Settings, steps: int, folder: Path, resume: bool = False, show_progress: bool = True
) -> Path:
    """Train until `steps` decisions have been taken in all; returns the path of the saved model.

    `resume` goes on from the model in `folder`; its task and settings must be the same. Episodes are drawn anew from
    the seed and the step count, so a resumed run is reproducible but not equal to an uninterrupted one.
    Raises DataError when there is nothing to resume, or when the folder holds a run and `resume` is not asked for.
    """
    torch.set_num_threads(1)
    model_path = folder / "model.zip"
    if resume:
        _check_same_run(folder, task, settings)
    elif model_path.exists():
        raise DataError(f"{folder} already holds a model; go on with --resume or name another folder with --out")
    teams = TeamVecEnv(settings.environments, task.config, settings.workers, task.training_maps, settings.seed)
    try:
        write_settings(folder, "ppo", task, asdict(settings))
        if resume:
            model = PPO.load(model_path, teams, device="cpu")
            teams.seed(settings.seed + model.num_timesteps)
            model.set_random_seed(settings.seed + model.num_timesteps)
        else:
            model = _new_model(teams, settings, folder)
        if steps > model.num_timesteps:
            progress = Progress(folder, steps, show_progress)
            model.learn(steps - model.num_timesteps, progress, tb_log_name="ppo", reset_num_timesteps=False)
            _save(model, model_path)
    finally:
        teams.close()
    return model_path


def _new_model(teams: TeamVecEnv, settings: Settings, folder: Path) -> PPO:
    return PPO(
        MaskedPolicy,
        teams,
        seed=settings.seed,
        n_steps=settings.rollout_steps,
        batch_size=settings.batch_size,
        n_epochs=settings.epochs,
        learning_rate=settings.learning_rate,
        gamma=settings.discount,
        ent_coef=settings.entropy_weight,
        tensorboard_log=str(folder / "tensorboard"),
        stats_window_size=EPISODES_SHOWN,
        device="cpu",
    )


def _check_same_run(folder: Path, task: Task, settings: Settings) -> None:
    record = read_settings(folder)
    if not (folder / "model.zip").exists():
        raise DataError(f"{folder} has no model.zip to resume from; start without --resume")
    asked = {"task": {**asdict(task), "kinds": list(task.kinds)}, "settings": asdict(settings)}
    changed = [part for part, values in asked.items() if record[part] != values]
    if changed:
        raise DataError(f"{folder} was trained with another {' and '.join(changed)}; name the same or another --out")


def _save(model: PPO, path: Path) -> None:
    """Save so that a crash in between leaves the old model whole."""
    part = path.with_name("model.part.zip")
    model.save(part)
    part.replace(path)


class Progress(BaseCallback):
    """After each rollout: a line in metrics.csv, a saved model, and the progress bar moves."""

    def __init__(self, folder: Path, steps: int, show: bool):
        super().__init__()
        self.folder, self.steps, self.show = folder, steps, show
        self.episodes = 0

    def _on_training_start(self) -> None:
        self.started, self.steps_before = time.perf_counter(), self.num_timesteps
        self.bar = tqdm(total=self.steps, initial=self.num_timesteps, unit="decision", disable=not self.show)
        self.path = self.folder / "metrics.csv"
        if self.num_timesteps > 0 and self.path.exists():
            with self.path.open(newline="") as file:
                self.episodes = max((int(row["episodes"]) for row in csv.DictReader(file)), default=0)
        else:
            with self.path.open("w", newline="") as file:
                csv.writer(file).writerow(COLUMNS)

    def _on_step(self) -> bool:
        self.bar.update(self.training_env.num_envs)
        self.episodes += int(np.sum(self.locals["dones"])) // self.training_env.get_attr("robots")[0]
        return True

    def _on_rollout_end(self) -> None:
        episodes = self.model.ep_info_buffer or []
        mean_return = float(np.mean([episode["r"] for episode in episodes])) if episodes else float("nan")
        mean_length = float(np.mean([episode["l"] for episode in episodes])) if episodes else float("nan")
        rate = (self.num_timesteps - self.steps_before) / (time.perf_counter() - self.started)
        with self.path.open("a", newline="") as file:
            row = (self.num_timesteps, self.episodes, f"{mean_return:.4f}", f"{mean_length:.1f}", f"{rate:.1f}")
            csv.writer(file).writerow(row)
        self.bar.set_postfix_str(f"mean return {mean_return:.3f}")
        if self.num_timesteps > self.steps_before:
            _save(self.model, self.folder / "model.zip")

    def _on_training_end(self) -> None:
        self.bar.close()
