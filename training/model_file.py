"""Models on disk: written so that a crash leaves the old one whole, read so that a wrong one is named."""

from __future__ import annotations

from pathlib import Path

from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv

from twc_env.errors import DataError


def save_model(model: PPO, path: Path) -> None:
    """Save so that a crash in between leaves the old model whole."""
    part = path.with_name("model.part.zip")
    model.save(part)
    part.replace(path)


def load_model(path: Path, policy: type, seen: spaces.Space, chosen: spaces.Space, teams: VecEnv | None = None) -> PPO:
    """A model that sees and chooses what these spaces hold, to go on learning where there are teams.

    Raises DataError for a file that is missing, broken, or the model of another task.
    """
    if not path.is_file():
        raise DataError(f"there is no model {path}; train one, or name the model.zip of a run folder")
    try:
        model = PPO.load(path, device="cpu", custom_objects={"policy_class": policy})
    except Exception as error:  # a broken or foreign archive surfaces as almost any exception
        raise DataError(f"cannot read the model {path}: {error}; train anew, or name another") from error
    if (model.observation_space, model.action_space) != (seen, chosen):
        raise DataError(f"{path} was trained with other observations or actions than config.json beside it says")
    if teams is not None:
        model.set_env(teams)
    return model
