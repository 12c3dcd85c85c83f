"""Trained models as teams of a benchmark (extra `train`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any

from twc_env.config import EnvConfig, override
from twc_env.errors import DataError
from twc_env.exploration.environment import ExplorationEnv
from twc_env.records.input_file import input_path
from twc_env.running.learning_libraries import learning_libraries
from twc_env.running.terminal import tell
from twc_env.suite.entries import Entry


def model_bytes(entry: Entry) -> bytes:
    """Content of the model file of a team. Raises DataError if it cannot be read."""
    path = _model_path(entry)
    try:
        return input_path(path).read_bytes()
    except OSError as error:
        raise DataError(
            f"cannot read the model {path}: {error.strerror}; name the folder of a run or its model.safetensors"
        ) from error


def _model_path(entry: Entry) -> Path:
    with learning_libraries():
        from twc_env.training.run_folder import model_in
        from twc_env.training.shipped import LEARNED, shipped_for

    if entry.team != LEARNED:
        path: Path = model_in(Path(entry.team))
        return path
    folder = shipped_for(entry.config)
    if folder.name != entry.task.rpartition("/")[2]:
        _tell_once(f"learned: {entry.task} has no policy of its own; it plays the one for {folder.name}")
    path = model_in(folder)
    return path


_tell_once = cache(tell)


def model_for(entry: Entry) -> tuple[Path, EnvConfig]:
    """The model file of the team, and the settings of the task with the actions and observations of its training.

    Raises DataError for a model that cannot be read.
    """
    with learning_libraries():
        from twc_env.training.run_folder import read_settings, task_of

    path = _model_path(entry)
    trained = task_of(read_settings(path.parent)).config
    view = {"action": asdict(trained.action), "observation": asdict(trained.observation)}
    return path, override(entry.config, view)


def model_in_task(entry: Entry) -> tuple[ExplorationEnv, Callable[[dict[str, Any]], dict[str, Any]]]:
    """The environment of an entry for its model, and what the model does in it. Raises DataError as `model_for`."""
    with learning_libraries():
        from twc_env.training.trained_policy import chooser_of

    path, config = model_for(entry)
    env = ExplorationEnv(config=config)
    choose = chooser_of(path, env, entry.number)
    return env, lambda observations: choose(observations, env.episode.steps)
