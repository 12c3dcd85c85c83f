"""Proximal policy optimisation (stable-baselines3): one policy shared by all robots of all teams. Runnable alone.

Each robot chooses between the frontiers of its map, a sign, a teammate, or staying. One small network scores every
choice from its features, so weights are shared between choices. Masked choices have probability 0.
"""

from __future__ import annotations

import csv
import math
import time
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import MultiInputActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecEnv
from torch import nn

from twc_env.errors import DataError, WorkerError
from twc_env.records.whole_file import whole_file
from twc_env.running.command_line import alone_in
from twc_env.vector.sb3 import TeamVecEnv

from .model_file import load_into, save_model
from .progress import progress_bar
from .run_folder import Task, read_settings, write_settings
from .team_notes import NotedTeams

COLUMNS = ("steps", "episodes", "mean_return", "mean_length", "steps_per_s")
EPISODES_SHOWN = 100
"""Number of most recent episode rows over which mean return and length are computed."""


@dataclass(frozen=True, slots=True)
class Settings:
    """Hyperparameters; defaults are those of stable-baselines3 unless noted."""

    seed: int = 0
    """Seed of the policy's weights, its sampling and the episodes."""
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
    learning_rate: float = 1e-3
    """Initial Adam step size (stable-baselines3: 3e-4), annealed linearly to 0 so that the result does not depend on
    the noise of the last few rollouts (stable-baselines3: constant)."""
    discount: float = 1.0
    """Discount per decision (stable-baselines3: 0.99). Decisions have different durations, so discounting would favour
    long ones, of which fewer are needed to reach the end."""
    entropy_weight: float = 0.005
    """Entropy bonus, against premature convergence (stable-baselines3: 0)."""


class ChoiceFeatures(BaseFeaturesExtractor):
    """One row of features per choice, and the state of the robot and its team, as one vector.

    Rows: the features of a frontier and its distance to goals (zeros for the other choices), then the kind of choice.
    Images are omitted: frontier features summarise the relevant part of the map and train in minutes.
    """

    def __init__(self, observation_space: spaces.Dict):
        shapes = {key: tuple(space.shape or ()) for key, space in observation_space.items()}
        self.choices = math.prod(shapes.pop("action_mask"))
        self.slots, figures = shapes.pop("frontiers")
        figures += shapes.pop("goals")[1]
        shapes.pop("gained")
        self.row = figures + 1 + self.choices - self.slots
        self.others = sorted(key for key, shape in shapes.items() if len(shape) < 3)
        self.context = sum(math.prod(shapes[key]) for key in self.others)
        super().__init__(observation_space, self.choices * (self.row + 1) + self.context + 1)
        kinds = torch.zeros(self.choices, self.row - figures)
        kinds[: self.slots, 0] = 1.0
        kinds[self.slots :, 1:] = torch.eye(self.choices - self.slots)
        self.register_buffer("kinds", kinds)

    def forward(self, seen: dict[str, torch.Tensor]) -> torch.Tensor:
        """(batch, choices * row), (batch, choices) mask, (batch, context) and (batch, 1) gain, side by side."""
        frontiers = torch.cat([seen["frontiers"], seen["goals"]], 2)
        count = len(frontiers)
        rows = torch.cat([frontiers, frontiers.new_zeros(count, self.choices - self.slots, frontiers.shape[2])], 1)
        rows = torch.cat([rows, self.kinds.expand(count, -1, -1)], 2)
        parts = [rows.reshape(count, -1), seen["action_mask"].reshape(count, -1).float()]
        for key in self.others:
            block = seen[key].reshape(count, -1).float()
            parts.append(torch.sign(block) * torch.log1p(torch.abs(block)))  # compresses metres
        return torch.cat([*parts, seen["gained"]], 1)


class Look(nn.Module):
    """Encodes every choice with one network and the robot's situation with another."""

    def __init__(self, features: ChoiceFeatures, width: int):
        super().__init__()
        self.sizes = [features.choices * features.row, features.choices, features.context, 1]
        self.row = features.row
        self.choice = nn.Sequential(nn.Linear(features.row, width), nn.Tanh())
        self.situation = nn.Sequential(nn.Linear(features.context, width), nn.Tanh())

    def forward(self, features: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """(batch, choices, width), their maximum over valid choices, the situation, the mask and the return so far."""
        rows, mask, context, gained = torch.split(features, self.sizes, 1)
        allowed = mask > 0
        choices = self.choice(rows.reshape(len(rows), -1, self.row))
        best = choices.masked_fill(~allowed[..., None], -1.0).amax(1)
        return choices, best, self.situation(context), allowed, gained


class ChoiceScorer(nn.Module):
    """Scores every choice with one network, given the maximum over all choices and the robot's situation.

    The value function has its own network, which also receives the team's gain so far and so predicts the remaining
    return better. The policy does not use it, and it is not needed for inference.
    """

    def __init__(self, features: ChoiceFeatures, width: int = 64):
        super().__init__()
        self.latent_dim_pi, self.latent_dim_vf = features.choices, width
        self.look, self.judge = Look(features, width), Look(features, width)
        self.score = nn.Sequential(nn.Linear(3 * width, width), nn.Tanh(), nn.Linear(width, 1))
        self.worth = nn.Sequential(nn.Linear(2 * width + 1, width), nn.Tanh())

    def forward(self, features: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Logits of the choices, and the features of the value."""
        return self.forward_actor(features), self.forward_critic(features)

    def forward_actor(self, features: torch.Tensor) -> torch.Tensor:
        """(batch, choices) logits; masked choices have probability 0."""
        choices, best, situation, allowed, _ = self.look(features)
        around = torch.cat([best, situation], 1)[:, None].expand(-1, choices.shape[1], -1)
        logits = self.score(torch.cat([choices, around], 2))[..., 0]
        return logits.masked_fill(~allowed, -1e9)

    def forward_critic(self, features: torch.Tensor) -> torch.Tensor:
        """(batch, width)."""
        _, best, situation, _, gained = self.judge(features)
        return self.worth(torch.cat([best, situation, gained], 1))


class ChoicePolicy(MultiInputActorCriticPolicy):
    """The standard actor-critic over `ChoiceScorer`, whose output is the logits."""

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **{**options, "features_extractor_class": ChoiceFeatures})

    def _build_mlp_extractor(self) -> None:
        self.mlp_extractor = ChoiceScorer(self.features_extractor)

    def _build(self, lr_schedule) -> None:
        super()._build(lr_schedule)
        self.action_net = nn.Identity()
        self.optimizer = self.optimizer_class(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)


def train(
    task: Task, settings: Settings, steps: int, folder: Path, resume: bool = False, show_progress: bool = True
) -> Path:
    """Train until a total of `steps` decisions; returns the path of the saved model.

    `resume` continues from the model in `folder`; task and settings must be the same, except for the workers. Episodes
    are drawn from the seed and the step count, so a resumed run is reproducible but differs from an uninterrupted one.
    Raises DataError if there is nothing to resume, if the folder holds a run and `resume` is not given, or if another
    process trains in it.
    """
    torch.set_num_threads(1)
    action, observation = task.config.action, task.config.observation
    if task.config.slam.mode == "off":
        raise DataError("this policy chooses between frontiers, and slam.mode=off has none: remove that setting")
    if (action.kind, observation.kind) != ("frontier", "dict"):
        raise DataError("this policy chooses between frontiers: keep action.kind=frontier and observation.kind=dict")
    if not (observation.pose and observation.team):
        raise DataError("robots share their goals: keep observation.pose=true and observation.team=true")
    model_path = folder / "model.zip"
    if resume:
        _check_same_run(folder, task, settings)
    elif model_path.exists():
        raise DataError(f"{folder} already holds a model; continue with --resume or name another folder with --out")
    raw = TeamVecEnv(settings.environments, task.config, settings.workers, task.training_maps, settings.seed)
    teams = NotedTeams(raw, task.max_cycles)
    try:
        with alone_in(folder, patience_s=0.0):
            model = _new_model(teams, settings, folder)
            if resume:
                load_into(model, model_path)
                teams.seed(settings.seed + model.num_timesteps)
                model.set_random_seed(settings.seed + model.num_timesteps)
            else:
                write_settings(folder, "ppo", task, asdict(settings))
            if steps > model.num_timesteps:
                progress = Progress(folder, steps, model.num_timesteps, show_progress)
                try:
                    model.learn(steps - model.num_timesteps, progress, tb_log_name="ppo", reset_num_timesteps=False)
                except WorkerError as error:
                    remedy = "--resume continues from the last saved model, if any"
                    raise DataError(f"a worker process has died (out of memory or killed); {remedy}") from error
                finally:
                    progress.bar.close()
                save_model(model, model_path)
    finally:
        teams.close()
    return model_path


def _new_model(teams: VecEnv, settings: Settings, folder: Path) -> PPO:
    return PPO(
        ChoicePolicy,
        teams,
        seed=settings.seed,
        n_steps=settings.rollout_steps,
        batch_size=settings.batch_size,
        n_epochs=settings.epochs,
        learning_rate=partial(falling, settings.learning_rate),
        gamma=settings.discount,
        ent_coef=settings.entropy_weight,
        tensorboard_log=str(folder / "tensorboard"),
        stats_window_size=EPISODES_SHOWN,
        device="cpu",
    )


def falling(first: float, left: float) -> float:
    """A step size proportional to the share of remaining decisions; the last rollout may exceed the total."""
    return first * max(left, 0.0)


def _check_same_run(folder: Path, task: Task, settings: Settings) -> None:
    record = read_settings(folder)
    if not (folder / "model.zip").exists():
        raise DataError(f"{folder} has no model.zip to resume from; start without --resume")
    # The number of processes does not change the results.
    settings = replace(settings, workers=record["settings"].get("workers", settings.workers))
    asked = {"task": {**asdict(task), "kinds": list(task.kinds)}, "settings": asdict(settings)}
    changed = [
        f"{name}={record[part].get(name)!r} instead of {value!r}"
        for part, values in asked.items()
        for name, value in values.items()
        if record[part].get(name) != value
    ]
    if changed:
        raise DataError(f"{folder} was trained with {', '.join(changed)}; use the same settings, or name another --out")


def _rows_until(decisions: int, path: Path) -> list[list[str]]:
    """Whole rows of metrics.csv; without later ones, whose model a killed run may lack."""
    if not path.exists():
        return []
    lines = path.read_bytes().decode(errors="replace").split("\n")
    rows = [row for row in csv.reader(lines[:-1]) if len(row) == len(COLUMNS) and all(map(str.isdecimal, row[:2]))]
    return [row for row in rows if int(row[0]) <= decisions]


class Progress(BaseCallback):
    """After each rollout: append to metrics.csv, save the model, update the progress bar."""

    def __init__(self, folder: Path, steps: int, taken: int, show: bool):
        super().__init__()
        self.folder = folder
        self.episodes = 0
        self.bar = progress_bar(total=steps, initial=taken, unit=" decisions", disable=not show)

    def _on_training_start(self) -> None:
        self.started, self.steps_before = time.perf_counter(), self.num_timesteps
        self.path = self.folder / "metrics.csv"
        rows = _rows_until(self.num_timesteps, self.path) if self.num_timesteps > 0 else []
        self.episodes = int(rows[-1][1]) if rows else 0
        with whole_file(self.path) as beside, beside.open("w", newline="") as file:
            csv.writer(file).writerows([COLUMNS, *rows])

    def _on_rollout_start(self) -> None:
        self.logger.dump(self.num_timesteps)  # losses of the last update, at its number of decisions

    def _on_step(self) -> bool:
        self.bar.update(self.training_env.num_envs)
        self.episodes += int(np.sum(self.locals["dones"])) // self.training_env.get_attr("robots")[0]
        return True

    def _on_rollout_end(self) -> None:
        episodes = self.model.ep_info_buffer or []
        mean_return = float(np.mean([episode["r"] for episode in episodes])) if episodes else float("nan")
        mean_length = float(np.mean([episode["l"] for episode in episodes])) if episodes else float("nan")
        rate = (self.num_timesteps - self.steps_before) / (time.perf_counter() - self.started)
        with self.path.open("a", newline="") as file:  # in one write; what a kill leaves of it is dropped on resuming
            row = (self.num_timesteps, self.episodes, f"{mean_return:.4f}", f"{mean_length:.1f}", f"{rate:.1f}")
            csv.writer(file).writerow(row)
        self.bar.set_postfix_str(f"mean return {mean_return:.3f}", refresh=False)
        if self.num_timesteps > self.steps_before:
            save_model(self.model, self.folder / "model.zip")

    def _on_training_end(self) -> None:
        self.logger.dump(self.num_timesteps)
