"""Model files: written atomically, and read with clear errors."""

from __future__ import annotations

from pathlib import Path

from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv

from twc_env.errors import DataError


def save_model(model: PPO, path: Path) -> None:
    """Save atomically: a crash leaves the old model intact."""
    part = path.with_name("model.part.zip")
    model.save(part)
    part.replace(path)


def load_model(path: Path, policy: type, seen: spaces.Space, chosen: spaces.Space, teams: VecEnv | None = None) -> PPO:
    """Load a model with these observation and action spaces; `teams` are needed to continue training.

    Raises DataError for a file that is missing, invalid, or the model of another task.
    """
    if not path.is_file():
        raise DataError(f"there is no model {path}; train one, or name the model.zip of a run folder")
    try:
        model = PPO.load(path, device="cpu", custom_objects={"policy_class": policy})
    except Exception as error:  # an invalid archive raises almost any exception
        raise DataError(f"cannot read the model {path}: {error}; train anew, or name another") from error
    if (model.observation_space, model.action_space) != (seen, chosen):
        raise DataError(f"{path} was trained with other observations or actions than config.json beside it says")
    if teams is not None:
        model.set_env(teams)
    return model
