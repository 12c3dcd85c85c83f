"""A trained policy against a random one and the scripted nearest-frontier team, in held-out buildings."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from stable_baselines3 import PPO
from twc_env.agents.policy import make_policy

import twc_env
from twc_env.config import override
from twc_env.pictures.video import RecordEpisodes

from .model_file import load_model
from .ppo import ChoicePolicy
from .progress import progress_bar
from .run_folder import Task, model_in, read_settings, task_of
from .team_notes import TeamNotes

Choose = Callable[[dict, int], dict]
"""Observations and time steps gone by -> actions."""
_EVALUATED: dict[str, object] = {"reward.sharing": "team"}
"""Coverage is taken from the reward terms of the team, independent of the rewards used in training."""
POLICIES = ("trained", "random", "nearest", "nearest-frontier")


@dataclass(frozen=True, slots=True)
class Episode:
    """Result of one policy in one building."""

    coverage: float
    """Share of the floor mapped correctly by the largest group at the end."""
    mean_coverage: float
    """Share of the floor mapped correctly by the best correctly merged group, averaged over the episode's time
    steps."""
    merged_robots: int
    wrong_merges: int


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Episodes by policy, in the order of the seeds."""

    seeds: tuple[int, ...]
    episodes: dict[str, tuple[Episode, ...]]

    @property
    def table(self) -> str:
        """Means with 95 % intervals of each policy and of its paired difference to the trained one, as text."""
        lines = [f"{'policy':<18}{'coverage':>18}{'over time':>18}{'trained ahead by':>22}{'merged':>8}{'wrong':>7}"]
        for name, episodes in self.episodes.items():
            end, over = ([getattr(e, key) for e in episodes] for key in ("coverage", "mean_coverage"))
            ahead = "" if name == "trained" else _with_spread(*self.ahead(name), sign="+")
            merged = np.mean([e.merged_robots for e in episodes])
            wrong = sum(e.wrong_merges for e in episodes)
            lines.append(f"{name:<18}{_interval(end):>18}{_interval(over):>18}{ahead:>22}{merged:>8.2f}{wrong:>7}")
        return "\n".join(lines)

    def as_json(self) -> dict:
        """Every episode, and each policy's means and lead of the trained policy over it with 95 % half-widths."""
        table = {}
        for name, episodes in self.episodes.items():
            means = {key: float(np.mean([getattr(e, key) for e in episodes])) for key in Episode.__slots__}
            lead, half_width = self.ahead(name)
            table[name] = {
                "means": means, "trained_leads": lead, "trained_leads_95": half_width,
                "episodes": [{"seed": seed, **asdict(e)} for seed, e in zip(self.seeds, episodes, strict=True)],
            }  # fmt: skip
        return table

    def ahead(self, other: str) -> tuple[float, float]:
        """Mean paired lead of the trained policy over another one in `mean_coverage`, and its 95 % half-width."""
        lead = np.array([e.mean_coverage for e in self.episodes["trained"]])
        lead = lead - np.array([e.mean_coverage for e in self.episodes[other]])
        return float(lead.mean()), _half_width(lead)


def _half_width(values: Sequence[float]) -> float:
    count = len(values)
    return 1.96 * float(np.std(values, ddof=1)) / math.sqrt(count) if count > 1 else float("nan")


def _interval(values: Sequence[float]) -> str:
    return _with_spread(float(np.mean(values)), _half_width(values))


def _with_spread(mean: float, half_width: float, sign: str = "") -> str:
    """One episode has no spread."""
    return f"{mean:{sign}.3f}" + ("" if math.isnan(half_width) else f" +- {half_width:.3f}")


def evaluate(
    model_path: Path, seeds: Sequence[int], show_progress: bool = True, films: Path | None = None
) -> Evaluation:
    """One episode per seed and policy, each seed in its own held-out building; optionally with films of the trained
    team.

    model_path: a model file or a run folder. Raises DataError if the model or the settings of its run cannot be read,
    or films cannot be written.
    """
    torch.set_num_threads(1)
    model_path = model_in(model_path)
    task = task_of(read_settings(model_path.parent))
    env = twc_env.parallel_env(config=task.config)
    model = load_model(
        model_path, ChoicePolicy, TeamNotes.space(env.observation_space("robot_0")), env.action_space("robot_0")
    )
    episodes: dict[str, list[Episode]] = {name: [] for name in POLICIES}
    filmed = None
    if films is not None:
        filmed = RecordEpisodes(_team(task, "rgb_array"), films)
    for seed in progress_bar(seeds, unit=" buildings", disable=not show_progress):
        choosers = {"trained": _trained(model, task, seed), "random": _random(seed), "nearest": _nearest}
        for name, choose in choosers.items():
            env = (filmed if name == "trained" else None) or _team(task)
            episodes[name].append(_played(task, seed, env, choose))
        episodes["nearest-frontier"].append(_scripted(task, seed))
    return Evaluation(tuple(seeds), {name: tuple(values) for name, values in episodes.items()})


def _trained(model: PPO, task: Task, seed: int) -> Choose:
    """Samples as in training: two robots that always take their most likely choice may wait for each other forever."""
    torch.manual_seed(seed)
    notes = TeamNotes(1, task.config.robots, task.max_cycles)
    elapsed_before = 0

    def choose(seen: dict, elapsed: int) -> dict:
        nonlocal elapsed_before
        rows = {name: np.stack([o[name] for o in seen.values()]) for name in next(iter(seen.values()))}
        notes.note_outcome(elapsed - elapsed_before)
        elapsed_before = elapsed
        actions = model.predict(notes.beside(rows), deterministic=False)[0]
        notes.note_choices(rows, actions)
        return dict(zip(seen, actions.tolist(), strict=True))

    return choose


def _random(seed: int) -> Choose:
    random = np.random.default_rng(seed)
    return lambda seen, _: {agent: int(random.choice(np.flatnonzero(o["action_mask"]))) for agent, o in seen.items()}


def _nearest(seen: dict, _: int) -> dict:
    """The first valid choice: the frontier with the shortest path, else a sign, a teammate, or stay."""
    return {agent: int(np.argmax(o["action_mask"])) for agent, o in seen.items()}


def _team(task: Task, render_mode: str | None = None) -> twc_env.ExplorationEnv:
    return twc_env.parallel_env(config=override(task.config, _EVALUATED), render_mode=render_mode)


def _scripted(task: Task, seed: int) -> Episode:
    """The scripted team of `agents` with velocity commands; its advantage is that it decides at every time step."""
    config = override(task.config, {"action.kind": "velocity", **_EVALUATED})
    env, policy = twc_env.parallel_env(config=config), make_policy("nearest-frontier", config)
    policy.reset(seed, env.possible_agents)
    return _played(task, seed, env, lambda _seen, _: policy.act({agent: env.belief(agent) for agent in env.agents}))


def _played(task: Task, seed: int, env: RecordEpisodes | twc_env.ExplorationEnv, choose: Choose) -> Episode:
    observations, _ = env.reset(seed, {"map": task.held_out_map(seed)})
    reached, total, elapsed = 0.0, 0.0, 0
    while env.agents:
        observations, _, _, _, infos = env.step(choose(observations, elapsed))
        info = infos["robot_0"]
        took = info.get("time_steps", 1)
        elapsed += took
        total += took * reached  # what a step gains is known at its end
        reached += info["reward_terms"]["coverage"]
    return Episode(info["coverage_correct"], total / task.max_cycles, info["merged_robots"], info["wrong_merges"])
