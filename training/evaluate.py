"""Mean return of a trained policy against one that acts at random, on the same episodes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from stable_baselines3 import PPO
from tqdm import tqdm

from training.run_folder import Task, read_settings
from twc_env.errors import DataError

Policy = Callable[[dict], np.ndarray]


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Returns per episode, in the order of the seeds."""

    seeds: tuple[int, ...]
    trained: tuple[float, ...]
    random: tuple[float, ...]

    @property
    def table(self) -> str:
        """Mean and standard deviation of both, as text."""
        lines = [f"{'policy':<10}{'mean return':>14}{'std':>10}{'episodes':>10}"]
        for name, returns in (("trained", self.trained), ("random", self.random)):
            lines.append(f"{name:<10}{np.mean(returns):>14.3f}{np.std(returns):>10.3f}{len(returns):>10}")
        return "\n".join(lines)


def evaluate(model_path: Path, seeds: Sequence[int], show_progress: bool = True) -> Evaluation:
    """Run one episode per seed and policy on the task that the model was trained for.

    Raises DataError when the model or the settings of its run cannot be read.
    """
    torch.set_num_threads(1)
    task = Task(**read_settings(model_path.parent)["task"])
    try:
        model = PPO.load(model_path, device="cpu")
    except (OSError, ValueError, KeyError) as error:
        raise DataError(f"cannot read the model {model_path}: {error}") from error
    environment = task.make()
    returns: dict[str, list[float]] = {"trained": [], "random": []}
    try:
        for seed in tqdm(seeds, unit="seed", disable=not show_progress):
            environment.action_space.seed(seed)
            returns["trained"].append(_episode_return(environment, seed, lambda seen: model.predict(seen)[0]))
            returns["random"].append(_episode_return(environment, seed, lambda _: environment.action_space.sample()))
    finally:
        environment.close()
    return Evaluation(tuple(seeds), tuple(returns["trained"]), tuple(returns["random"]))


def _episode_return(environment, seed: int, policy: Policy) -> float:
    torch.manual_seed(seed)
    observation, _ = environment.reset(seed=seed)
    total, ended = 0.0, False
    while not ended:
        observation, reward, terminated, truncated, _ = environment.step(policy(observation))
        total += float(reward)
        ended = terminated or truncated
    return total
