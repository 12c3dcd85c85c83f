"""Evolution strategy: weights of the rule that are kept for whole episodes, and moved towards those that scored more.

Runnable alone: `python training/evolution.py --task ExploreQuick-v1`, or `twc-env train es`.

One decision of hundreds changes the score of an episode by far less than chance does, so gradients from noise on
actions drown (`mappo` moves its rule by nothing). Here the weights themselves are varied (Salimans et al. 2017,
"Evolution strategies as a scalable alternative to reinforcement learning"): two teams play the same building with the
same random numbers, one with a random change of the weights, one with its opposite (mirrored sampling, common random
numbers), and the weights move along the changes times the differences in score, as multiples of their root mean square.
Only the few weights of `RULE` are varied: the noise of a step grows with their number.

Each update begins new episodes, and everything random comes from streams named by seed and update. So the result
depends neither on the number of processes nor on whether the run was killed and resumed.
"""

from __future__ import annotations

import time
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray as Array
from twc_env.training.blindness import hidden
from twc_env.training.checkpoint import below, load, save
from twc_env.training.encoder import USED, Actor, logits_of_rule, rule_for
from twc_env.training.episode_totals import EpisodeTotals
from twc_env.training.learning_curve import LearningCurve
from twc_env.training.run_folder import Task, check_choices, check_run, open_run
from twc_env.training.team_notes import TeamNotes
from twc_env.training.weights import arrays_of, fill

from twc_env.errors import ConfigError
from twc_env.records.random_streams import random_stream
from twc_env.vector.teams import VectorTeams


@dataclass(frozen=True, slots=True)
class Settings:
    """Hyperparameters."""

    seed: int = 0
    """Seed of the changes and of the episodes."""
    steps: int = 500_000
    """Total decisions, rounded up to whole updates."""
    environments: int = 32
    """Teams that play at once: half as many buildings, each with a change of the weights and with its opposite."""
    workers: int = 2
    """Processes that share the environments; results do not depend on them."""
    learning_rate: float = 1.0
    """Step, in `RULE`'s spreads, where all differences in score are explained by one weight; annealed linearly to 0."""
    hidden_size: int = 64
    """Width of the networks, which add nothing to the rule here."""
    blind: tuple[str, ...] = ()
    """What the policy does not know of: some of teammates, signs and map (`blindness`)."""


class Episodes:
    """Plays one episode in each environment, with weights of the rule of its own."""

    def __init__(self, task: Task, settings: Settings, ray: str | None = None):
        """ray: address of a Ray cluster whose workers play."""
        self._teams = VectorTeams(settings.environments, task.config, settings.workers, task.training_maps, ray)
        self.space = TeamNotes.space(self._teams.observation_space)
        self._used = [name for name in USED if name in self.space.spaces]
        self._count, self._robots, self._max_cycles = settings.environments, self._teams.robots, task.config.max_cycles
        self._blind = settings.blind

    def play(self, weights: Array, seeds: list[int]) -> tuple[list[dict], int]:
        """What the episodes were like (`EpisodeTotals`), in the order of weights (environments, k) and seeds; and how
        many decisions were made."""
        notes, totals = TeamNotes(self._count, self._robots, self._max_cycles), EpisodeTotals(self._count)
        found: dict[int, dict] = {}
        ids, seen, decisions = np.arange(self._count), self._teams.reset(seeds), 0
        in_flight = 0
        while len(found) < self._count:
            if len(ids):
                rows = {name: block.reshape(-1, *block.shape[2:]) for name, block in seen.items()}
                noted = notes.beside(rows, ids)
                tensors = {name: torch.from_numpy(np.asarray(noted[name], np.float32)) for name in self._used}
                own = torch.from_numpy(np.repeat(weights[ids], self._robots, 0).astype(np.float32))
                actions = logits_of_rule(hidden(tensors, self._blind), own).argmax(1).numpy()
                decisions += int((rows["action_mask"].sum(1) > 1).sum())
                notes.note_choices(rows, actions, ids)
                self._teams.send(actions.reshape(len(ids), -1), ids)
                in_flight += len(ids)
            ids, seen, rewards, ended, infos = self._teams.recv(
                max(1, in_flight // 2) if self._teams.workers > 1 else in_flight
            )
            in_flight -= len(ids)
            took = np.array([info[0]["time_steps"] for info in infos])
            notes.note_outcome(np.repeat(took, self._robots), 0.0, False, ids)
            paid = rewards * notes.time_left(ids).reshape(len(ids), -1)
            for i, k in enumerate(ids.tolist()):
                if told := totals.add(k, paid[i], rewards[i], infos[i], ended[i]):
                    found[k] = told
            ids, seen = ids[~ended], {name: block[~ended] for name, block in seen.items()}
        return [found[k] for k in range(self._count)], decisions

    def close(self) -> None:
        """End the worker processes."""
        self._teams.close()


def step_of(changes: Array, scores: Array) -> Array:
    """(k,) step in spreads: changes (n, k) times half the differences of scores (n, 2), as multiples of their root mean
    square."""
    halves = (scores[:, 0] - scores[:, 1]) / 2.0
    size = float(np.sqrt(np.mean(halves**2)))
    found: Array = changes.T @ halves / (len(halves) * size) if size > 0.0 else np.zeros(changes.shape[1])
    return found


def train(
    task: Task,
    settings: Settings,
    folder: Path,
    resume: bool = False,
    show_progress: bool = True,
    ray: str | None = None,
) -> Path:
    """Train for `settings.steps` decisions; returns the path of the checkpoint, which is written after each update.

    `resume`, `ray` and errors as in `mappo.train`.
    """
    torch.set_num_threads(1)  # the networks are small, and the environments need the cores
    check_choices(task)
    if settings.environments % 2:
        raise ConfigError(f"--environments must be even, as teams play in pairs; got {settings.environments}")
    check_run(folder, "es", task, settings, resume)
    with (
        closing(Episodes(task, settings, ray)) as episodes,
        open_run(folder, "es", task, settings, resume) as path,
    ):
        with torch.random.fork_rng():
            torch.manual_seed(settings.seed)
            actor = Actor(episodes.space, settings.hidden_size, settings.blind)
        rule_of = rule_for(episodes.space)
        spreads = np.array([spread for _, spread in rule_of.values()])
        told: dict[str, Any] = {"update": 0, "decisions": 0, "curve": {}}
        if resume:
            arrays, told = load(path)
            fill(actor, below(arrays, "actor."), path)
        update, decisions, pairs = told["update"], told["decisions"], settings.environments // 2
        with LearningCurve(folder, settings.steps, decisions, told["curve"], show_progress) as curve:
            while decisions < settings.steps:
                began = time.perf_counter()
                changes = random_stream(settings.seed, "changes", update).standard_normal((pairs, len(rule_of)))
                rule = actor.rule.detach().numpy().astype(float)
                weights = np.stack([rule + spreads * changes, rule - spreads * changes], 1).reshape(-1, len(rule_of))
                first = 1_000_003 * settings.seed + pairs * update
                played, count = episodes.play(weights, [first + k // 2 for k in range(2 * pairs)])
                scores = np.array([each["score"] for each in played]).reshape(-1, 2)
                step = settings.learning_rate * (1.0 - decisions / settings.steps) * spreads * step_of(changes, scores)
                with torch.no_grad():
                    actor.rule += torch.from_numpy(step.astype(np.float32))
                update, decisions = update + 1, decisions + count
                figures = {f"rule/{name}": float(weight) for name, weight in zip(rule_of, rule + step, strict=True)}
                figures["speed/decisions_per_s"] = count / (time.perf_counter() - began)
                curve.note(decisions, count, played, figures)
                told = {"update": update, "decisions": decisions, "curve": curve.values()}
                save(path, arrays_of(actor, "actor."), told)
    return path


if __name__ == "__main__":
    import runpy
    import sys

    sys.argv[1:1] = ["train", "es"]
    runpy.run_module("twc_env", run_name="__main__")
