"""Model files: the weights and a few numbers of a run, read without running any code that they might hold.

A file is a zip archive of `policy.pth` and `policy.optimizer.pth`, as stable-baselines3 writes them, and of `data`:
JSON with plain values only. Everything else is made anew from the settings in `config.json`. The archives that
`PPO.save` writes hold pickled objects in `data`, which run code when they are unpickled; they are refused.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.save_util import save_to_zip_file

from twc_env.errors import DataError
from twc_env.records.seal import is_unbroken, seal
from twc_env.records.whole_file import whole_file

FORMAT = "twc_env/ppo-1"
BYTES_MAX = 1_000_000_000
"""Maximum size of a model, unpacked."""
_WEIGHTS = "policy", "policy.optimizer"
_REMEDY = "train anew, or name another"


def save_model(model: PPO, path: Path) -> None:
    """Save whole or not at all: a crash leaves the old model intact."""
    numbers = {
        "format": FORMAT,
        "spaces": _text_of(model.observation_space, model.action_space),
        "decisions": model.num_timesteps,
        "updates": model._n_updates,
        "episodes": [[float(each["r"]), int(each["l"])] for each in model.ep_info_buffer or ()],
    }
    with whole_file(path) as beside:
        save_to_zip_file(beside, data=numbers, params=model.get_parameters())
        seal(beside)


def load_policy(path: Path, policy: type[ActorCriticPolicy], seen: spaces.Space, chosen: spaces.Space) -> Any:
    """A policy with the weights of a file, for these observation and action spaces; it cannot be trained further.

    Raises DataError for a file that is missing or invalid, holds code, or is the model of another task.
    """
    _, weights = _read(path, seen, chosen)
    trained = policy(seen, chosen, lambda _left: 0.0)
    with _fitting(path):
        trained.load_state_dict(weights["policy"])
    return trained


def load_into(model: PPO, path: Path) -> None:
    """Continue a file's training in a new model of the same settings. Raises DataError as `load_policy`."""
    numbers, weights = _read(path, model.observation_space, model.action_space)
    with _fitting(path):
        model.set_parameters(weights, exact_match=True, device="cpu")
        model.num_timesteps, model._n_updates = int(numbers["decisions"]), int(numbers["updates"])
        episodes = [{"r": float(each[0]), "l": int(each[1]), "t": 0.0} for each in numbers["episodes"]]
        model.ep_info_buffer = deque(episodes, maxlen=model._stats_window_size)
        model.ep_success_buffer = deque(maxlen=model._stats_window_size)  # both exist or none


@contextmanager
def _fitting(path: Path) -> Iterator[None]:
    """Turns errors about weights of another shape or kind into DataError."""
    try:
        yield
    except Exception as error:  # torch and the optimizer check little, and raise anything
        raise DataError(
            f"{path} does not fit the settings in config.json beside it: {str(error)[:200]}; {_REMEDY}"
        ) from error


def _read(path: Path, seen: spaces.Space, chosen: spaces.Space) -> tuple[dict[str, Any], dict[str, Any]]:
    """The numbers and the weights of a file."""
    if not path.is_file():
        raise DataError(f"there is no model {path}; train one, or name the model.zip of a run folder")
    try:
        if not is_unbroken(path):
            raise DataError("it is not as it was written, since its checksum differs")
        with zipfile.ZipFile(path) as archive:
            if sum(part.file_size for part in archive.infolist()) > BYTES_MAX:
                raise DataError(f"it is larger than the {BYTES_MAX / 1e9:.0f} GB that are possible")
            numbers = json.loads(archive.read("data"))
            pickled = sorted(key for key, value in numbers.items() if isinstance(value, dict))
            if pickled or numbers.get("format") != FORMAT:
                what = f"pickled objects ({', '.join(pickled)[:80]}), which could run code" if pickled else "no model"
                raise DataError(f"it holds {what}, where {FORMAT} has plain numbers")
            weights = {
                name: torch.load(io.BytesIO(archive.read(f"{name}.pth")), map_location="cpu", weights_only=True)
                for name in _WEIGHTS
            }
    except Exception as error:  # an invalid archive raises almost any exception
        what = str(error) if isinstance(error, DataError) else f"{type(error).__name__}: {error}"[:200]
        raise DataError(f"cannot read the model {path}: {what}; {_REMEDY}") from error
    if numbers.get("spaces") != _text_of(seen, chosen):
        raise DataError(f"{path} was trained with other observations or actions than config.json beside it says")
    return numbers, weights


def _text_of(seen: spaces.Space, chosen: spaces.Space) -> str:
    return f"{seen} {chosen}"
