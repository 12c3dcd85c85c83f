"""A trained policy at play: its networks from a checkpoint, and what they choose in an episode."""

from __future__ import annotations

from collections.abc import Callable
from os import PathLike
from pathlib import Path

import numpy as np
import torch
from gymnasium import spaces

import twc_env
from twc_env.errors import DataError
from twc_env.records.random_streams import random_stream

from .blindness import check_blind
from .checkpoint import below, load
from .encoder import USED, Actor
from .run_folder import model_in, read_settings
from .team_notes import TeamNotes
from .weights import fill

SHARPER = 10.0
"""Factor on the logits at play: policies explore while they train, which costs floor."""
Choose = Callable[[dict, int], dict]
"""Observations and time steps gone by -> actions."""


def load_actor(model_path: Path, space: spaces.Space) -> Actor:
    """The policy of a model for observations of this space, of any number of robots and candidates.

    Raises DataError for a model that cannot be read, or was trained with other observations.
    """
    record, (arrays, _) = read_settings(model_path.parent), load(model_path)
    if not isinstance(space, spaces.Dict) or not {"frontiers", "pose", "team"} <= set(space.spaces):
        raise DataError(
            f"{model_path} chooses among candidates, which these observations lack; make the environment with the "
            "settings of its run: parallel_env(config=task_of(read_settings(FOLDER)).config)"
        )
    told = record["settings"]
    blind = tuple(told.get("blind", ()))
    check_blind(blind)
    actor = Actor(TeamNotes.space(space), int(told.get("hidden_size", 64)), blind, bool(told.get("attention", True)))
    own = below(arrays, "actor.") or below(arrays, "policy.mlp_extractor.actor.")
    fill(actor, own, model_path)
    return actor


def chooser_of(model_path: str | PathLike[str], env: twc_env.ExplorationEnv, seed: int) -> Choose:
    """What a trained model, a file or its run folder, does in one episode of an environment; the next one needs
    another. Raises DataError as `load_actor`."""
    return sampling(load_actor(model_in(Path(model_path)), env.observation_space("robot_0")), env.config, seed)


def sampling(actor: Actor, config: twc_env.EnvConfig, seed: int) -> Choose:
    """Chooses for a whole episode, at random, but `SHARPER` than in training: two robots that always take their most
    likely choice may wait for each other forever."""
    torch.set_num_threads(1)  # the networks are small
    random = random_stream(seed, "choices")
    notes = TeamNotes(1, config.robots, config.max_cycles)
    elapsed_before = 0

    def choose(seen: dict, elapsed: int) -> dict:
        nonlocal elapsed_before
        rows = {name: np.stack([o[name] for o in seen.values()]) for name in next(iter(seen.values()))}
        notes.note_outcome(elapsed - elapsed_before)
        elapsed_before = elapsed
        noted = {k: torch.from_numpy(np.asarray(v, np.float32)) for k, v in notes.beside(rows).items() if k in USED}
        with torch.inference_mode():
            reached = torch.softmax(SHARPER * actor(noted), 1).cumsum(1).numpy()
        actions = (random.random((len(reached), 1)) * reached[:, -1:] >= reached).sum(1)
        notes.note_choices(rows, actions)
        return dict(zip(seen, actions.tolist(), strict=True))

    return choose
