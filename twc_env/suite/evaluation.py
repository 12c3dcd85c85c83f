"""A trained policy against a random one and the scripted nearest-frontier team, in held-out buildings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch

import twc_env
from twc_env.agents.policy import begin, make_policy
from twc_env.config import override
from twc_env.metrics.means import mean_interval
from twc_env.pictures.curves import draw_coverage, sampled
from twc_env.pictures.video import RecordEpisodes
from twc_env.records.json_values import write_json
from twc_env.records.text_tables import aligned_text, csv_text, latex_table
from twc_env.records.whole_file import write_text
from twc_env.running.options import refuse_code
from twc_env.running.output_folder import remove_stale
from twc_env.running.ray_cluster import spread_out
from twc_env.training.progress import progress_bar
from twc_env.training.run_folder import Task, model_in, read_settings, task_of
from twc_env.training.trained_policy import Choose, load_actor, sampling

_EVALUATED: dict[str, object] = {"reward.sharing": "team"}
"""Coverage is taken from the reward terms of the team, independent of the rewards used in training."""
POLICIES = ("trained", "random", "nearest", "nearest-frontier")


@dataclass(frozen=True, slots=True)
class Episode:
    """Result of one policy in one building."""

    coverage: float
    """Share of the floor in a correctly merged map, the best one, at the end."""
    mean_coverage: float
    """The same, averaged over the longest time of an episode."""
    merged_robots: int
    wrong_merges: int
    curve: tuple[float | None, ...] = ()
    """The same share over the longest time of an episode, `SAMPLES` values; None before it was first evaluated."""


NUMBERS = tuple(key for key in Episode.__slots__ if key != "curve")


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Episodes by policy, in the order of the seeds."""

    seeds: tuple[int, ...]
    episodes: dict[str, tuple[Episode, ...]]

    time_max_s: float = 0.0
    """Longest simulated time of an episode."""

    @property
    def table(self) -> str:
        """`rows` as aligned text."""
        return aligned_text(self.rows())

    def rows(self) -> list[list[str]]:
        """Titles, and cells of each policy: means with 95 % intervals, also of its paired difference to the trained
        one."""
        rows = [["policy", "coverage", "over time", "trained ahead by", "merged", "wrong"]]
        for name, episodes in self.episodes.items():
            end, over = ([getattr(e, key) for e in episodes] for key in ("coverage", "mean_coverage"))
            ahead = "" if name == "trained" else _with_spread(*self.ahead(name), sign="+")
            merged, wrong = np.mean([e.merged_robots for e in episodes]), sum(e.wrong_merges for e in episodes)
            rows.append([name, _interval(end), _interval(over), ahead, f"{merged:.2f}", str(wrong)])
        return rows

    def write(self, folder: Path, pictures: tuple[str, float | None] | None) -> list[Path]:
        """Write evaluation.json, evaluation.csv (a row per episode), evaluation.tex, and coverage over time as
        a picture; returns their paths.

        pictures: format and dpi; None for no picture.
        """
        lines = [
            {"policy": name, "seed": seed, **{key: getattr(episode, key) for key in NUMBERS}}
            for name, episodes in self.episodes.items()
            for seed, episode in zip(self.seeds, episodes, strict=True)
        ]
        paths = [folder / "evaluation.json"]
        write_json(paths[0], self.as_json())
        paths.append(write_text(folder / "evaluation.csv", csv_text(lines)))
        paths.append(write_text(folder / "evaluation.tex", latex_table(self.rows())))
        if pictures is not None and self.time_max_s:
            curves = {name: [e.curve for e in episodes] for name, episodes in self.episodes.items()}
            path, title = folder / f"coverage.{pictures[0]}", "held-out buildings"
            paths.append(draw_coverage(curves, self.time_max_s, path, title, pictures[1]))
        remove_stale(folder, ("coverage",), paths)
        return paths

    def as_json(self) -> dict:
        """Every episode, and each policy's means and lead of the trained policy over it with 95 % half-widths."""
        table = {}
        for name, episodes in self.episodes.items():
            means = {key: float(np.mean([getattr(e, key) for e in episodes])) for key in NUMBERS}
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
    mean, _, high = mean_interval(values)
    return high - mean


def _interval(values: Sequence[float]) -> str:
    return _with_spread(float(np.mean(values)), _half_width(values))


def _with_spread(mean: float, half_width: float, sign: str = "") -> str:
    """One episode has no spread."""
    return f"{mean:{sign}.3f}" + ("" if math.isnan(half_width) else f" +- {half_width:.3f}")


def evaluate(
    model_path: Path,
    seeds: Sequence[int],
    show_progress: bool = True,
    films: Path | None = None,
    allow_code: bool = False,
    where: tuple[int, str | None] = (1, None),
) -> Evaluation:
    """One episode per seed and policy, each seed in its own held-out building; optionally with films of the trained
    team.

    model_path: a model file or a run folder. allow_code: whether its settings may name Python files to execute. where:
    number of processes, or the address of a Ray cluster.

    Raises DataError if the model or the settings of its run cannot be read, or films cannot be written, ConfigError for
    settings that name code which is not allowed.
    """
    model_path = model_in(model_path)
    task = task_of(read_settings(model_path.parent))
    if not allow_code:
        refuse_code(task.config, model_path.parent / "config.json")
    load_actor(model_path, _team(task).observation_space("robot_0"))
    if films is not None:
        RecordEpisodes(_team(task, "rgb_array"), films)  # can films be written?
    parts = [(model_path.resolve(), task, seed, films) for seed in seeds]
    found: dict[int, dict[str, Episode]] = {}
    with progress_bar(total=len(parts), unit=" buildings", disable=not show_progress) as bar:
        for k, episodes in spread_out(_in_building, parts, min(where[0], len(parts)), where[1]):
            found[k] = episodes
            bar.update(1)
    time_max_s = task.config.max_cycles * task.config.dynamics.time_step_s
    table = {name: tuple(found[k][name] for k in range(len(parts))) for name in POLICIES}
    return Evaluation(tuple(seeds), table, time_max_s)


def _in_building(part: tuple[Path, Task, int, Path | None]) -> dict[str, Episode]:
    """The episode of each policy in one held-out building."""
    model_path, task, seed, films = part
    torch.set_num_threads(1)
    trained = _team(task)
    choose = sampling(load_actor(model_path, trained.observation_space("robot_0")), task.config, seed)
    filmed = trained if films is None else RecordEpisodes(_team(task, "rgb_array"), films)
    return {
        "trained": _played(task, seed, filmed, choose),
        "random": _played(task, seed, _team(task), _random(seed)),
        "nearest": _played(task, seed, _team(task), _nearest),
        "nearest-frontier": scripted(task, "nearest-frontier", seed),
    }


def _random(seed: int) -> Choose:
    random = np.random.default_rng(seed)
    return lambda seen, _: {agent: int(random.choice(np.flatnonzero(o["action_mask"]))) for agent, o in seen.items()}


def _nearest(seen: dict, _: int) -> dict:
    """The goal with the shortest path; without one a sign, a teammate, or stay."""
    return {agent: _nearest_goal(o["action_mask"], o["frontiers"]) for agent, o in seen.items()}


def _nearest_goal(mask: np.ndarray, goals: np.ndarray) -> int:
    ways = np.where(mask[: len(goals)] > 0, goals[:, 3], np.inf)
    return int(np.argmin(ways)) if np.isfinite(ways).any() else int(np.argmax(mask))


def _team(task: Task, render_mode: str | None = None) -> twc_env.ExplorationEnv:
    return twc_env.parallel_env(config=override(task.config, _EVALUATED), render_mode=render_mode)


def scripted(task: Task, team: str, seed: int, split: str = "test") -> Episode:
    """A scripted team of `agents` with velocity commands; its advantage is that it decides at every time step."""
    config = override(task.config, {"action.kind": "velocity", "observation.gains": False, **_EVALUATED})
    env, policy = twc_env.parallel_env(config=config), make_policy(team, config)
    is_fresh = True

    def act(_seen: dict, _: int) -> dict:
        nonlocal is_fresh
        if is_fresh:
            begin(policy, team, env, seed)
            is_fresh = False
        return policy.act({agent: env.belief(agent) for agent in env.agents})

    return _played(task, seed, env, act, split)


def _played(
    task: Task, seed: int, env: RecordEpisodes | twc_env.ExplorationEnv, choose: Choose, split: str = "test"
) -> Episode:
    observations, _ = env.reset(seed, task.held_out(seed, split))
    reached, total, elapsed, budget = 0.0, 0.0, 0, task.config.max_cycles
    steps, covered = [0], [0.0]
    while env.agents:
        observations, _, _, _, infos = env.step(choose(observations, elapsed))
        info = infos["robot_0"]
        took = info.get("time_steps", 1)
        elapsed += took
        total += took * reached  # what a step gains is known at its end
        reached += info["reward_terms"]["coverage"]
        steps.append(elapsed)
        covered.append(reached)
    total += (budget - elapsed) * reached  # an episode that has ended early keeps its last value
    first = int(np.searchsorted(steps, min(task.config.reward.period_steps, elapsed)))
    curve = tuple(sampled(np.array(steps[first:]), np.array(covered[first:]), budget))
    return Episode(reached, total / budget, info["merged_robots"], info["wrong_merges"], curve)
