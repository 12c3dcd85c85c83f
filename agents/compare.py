"""Paired comparison of teams: several agents in the same buildings with the same seeds."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import twc_env
from twc_env.config import EnvConfig, override, to_dict
from twc_env.metrics.means import mean_interval
from twc_env.pictures.curves import draw_coverage, sampled
from twc_env.processes.worker_processes import in_processes
from twc_env.records.json_values import write_json
from twc_env.records.text_tables import aligned_text, csv_text, latex_table
from twc_env.records.whole_file import write_text
from twc_env.running.finished_parts import FinishedParts
from twc_env.running.output_folder import remove_stale

from .explore import commanded, commanded_stuck_share, origin_of
from .policy import begin, is_finished, is_model, make_policy
from .roster import display_name

GOAL = 0.9
"""Share of the floor to be in a correctly merged map."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """One episode of one agent."""

    goal_s: float
    """Simulated time until `GOAL` was reached; the episode's duration if it never was."""
    is_reached: bool
    coverage: float
    """`coverage_correct` of the report: floor mapped correctly at the end by the largest group, merged rightly or
    not."""
    coverage_end: float
    """Floor in a correctly merged map, the best one, when the rewards were last evaluated."""
    coverage_mean: float
    """The same, averaged over the maximum duration of an episode."""
    path_m: float
    """Summed over all robots."""
    team_ate_m: float
    merged_robots: int
    wrong_merges: int
    stuck_share: float = 0.0
    """Share of the time in which a robot that was told to move stayed within 0.3 m for 10 s; maximum over robots."""
    curve: tuple[float | None, ...] = ()
    """`coverage_end` over time: `SAMPLES` values over the longest time; None before it was first evaluated."""


@dataclass(frozen=True, slots=True)
class Standing:
    """One agent over all buildings and seeds, compared with the first agent."""

    agent: str
    outcomes: tuple[Outcome, ...]
    sooner_s: tuple[float, float, float]
    """Time by which it reaches `GOAL` sooner than the first agent: mean and 95 % confidence interval. One
    episode has no interval (NaN); all are NaN where neither ever reaches it."""
    more: tuple[float, float, float]
    """Gain in coverage over time (`coverage_mean`), likewise."""


def places(maps: Sequence[str], seeds: Sequence[int] | None = None) -> list[tuple[str, int]]:
    """Building and seed of each episode: every seed in every building; without seeds one each, its place in the
    list."""
    if seeds is None:
        return [(name, seed) for seed, name in enumerate(maps)]
    return [(name, seed) for name in maps for seed in seeds]


def compare(
    config: EnvConfig,
    maps: Sequence[str],
    agents: Sequence[str],
    folder: Path,
    processes: int = 1,
    tell: Callable[[str], None] = lambda text: None,
    seeds: Sequence[int] | None = None,
) -> list[Standing]:
    """Run every agent, once if it is named twice, in all `places`; finished episodes are read from the folder."""
    agents = tuple(dict.fromkeys(agents))
    for agent in agents:
        make_policy(agent, config)  # an unknown name fails before the first episode
    parts = [(name, agent, seed) for name, seed in places(maps, seeds) for agent in agents]
    found: dict[tuple[str, str, int], Outcome] = {}
    packages = ("twc_env.agents", "twc_env.training") if any(map(is_model, agents)) else ("twc_env.agents",)
    finished = FinishedParts(folder, "compare", to_dict(config), packages)
    if finished.remark:
        tell(finished.remark)
    run = partial(_once, config, finished)
    for k, outcome in in_processes(run, parts, processes):
        found[parts[k]] = outcome
        tell(_line(len(found), len(parts), parts[k], outcome))
    outcomes = {agent: tuple(found[name, agent, seed] for name, seed in places(maps, seeds)) for agent in agents}
    return [_standing(agent, outcomes[agent], outcomes[agents[0]]) for agent in agents]


def explore(config: EnvConfig, agent: str, seed: int) -> Outcome:
    """Run one episode until the agent is finished or the time is over."""
    config = override(config, {"reward.sharing": "team"})  # the coverage of the team is read from its reward terms
    env, policy = twc_env.parallel_env(config=config), make_policy(agent, config)
    env.reset(seed=seed)
    begin(policy, agent, env, seed)
    covered, commands = [0.0], []
    while env.agents:
        beliefs = {name: env.belief(name) for name in env.agents}
        if is_finished(policy, beliefs):
            break
        actions = policy.act(beliefs)
        infos = env.step(actions)[-1]
        commands.append(commanded(actions, env.possible_agents))
        covered.append(covered[-1] + infos["robot_0"]["reward_terms"]["coverage"])
    result = env.result()
    figures = result.figures
    env.close()
    curve = np.array(covered[1:] + covered[-1:] * (config.max_cycles - len(covered) + 1))
    reached = np.flatnonzero(curve >= GOAL)
    first = min(config.reward.period_steps, len(covered) - 1)
    steps = int(reached[0]) + 1 if len(reached) else config.max_cycles
    return Outcome(
        steps * config.dynamics.time_step_s, bool(len(reached)), float(figures["coverage_correct"]),
        covered[-1], float(curve.mean()), float(figures["path_length_m"]), float(figures["team_ate_m"]),
        int(figures["merged_robots"]), int(figures["wrong_merges"]),
        commanded_stuck_share(result, commands),
        tuple(sampled(np.arange(first, len(covered)), np.array(covered[first:]), config.max_cycles)),
    )  # fmt: skip


NUMBERS = tuple(key for key in Outcome.__slots__ if key != "curve")


def rows_of(standings: Sequence[Standing]) -> list[list[str]]:
    """Titles, and one row of cells per agent: means over episodes (time also as interquartile mean, time stuck as
    maximum), and the gain over the first agent. A time to what was never reached is a dash."""
    goal = f"{100 * GOAL:.0f} %"
    rows = [[
        "agent", "reached", f"to {goal} s", "IQM s", "mean cov.", "final cov.", "path m", "ATE m", "wrong", "stuck",
        "sooner s (95 %)", "more mean cov. (95 %)",
    ]]  # fmt: skip
    for s, of in zip(standings, means_of(standings), strict=True):
        gains = ["", ""] if s is standings[0] else [_interval(s.sooner_s, ".1f"), _interval(s.more, ".3f")]
        rows.append([
            display_name(s.agent), f"{of['reached_share']:.0%}",
            *("-" if time_s is None else f"{time_s:.1f}" for time_s in (of["goal_s"], of["goal_s_iqm"])),
            f"{of['mean_coverage']:.3f}", f"{of['final_coverage']:.3f}", f"{of['path_m']:.0f}",
            f"{of['team_ate_m']:.3f}", str(of["wrong_merges"]), f"{of['stuck_share_max']:.1%}", *gains,
        ])  # fmt: skip
    return rows


def means_of(standings: Sequence[Standing]) -> list[dict[str, Any]]:
    """One row of numbers per agent, as of `rows_of`; what is unknown, and the first agent's gain, is None."""
    from scipy.stats import trim_mean  # slow to import

    rows = []
    for s in standings:
        of = {key: np.array([getattr(o, key) for o in s.outcomes], float) for key in NUMBERS}
        is_reached, times_s = of["is_reached"].any(), of["goal_s"]
        row: dict[str, Any] = {
            "agent": display_name(s.agent), "episodes": len(s.outcomes), "reached_share": of["is_reached"].mean(),
            "goal_s": times_s.mean() if is_reached else None,
            "goal_s_iqm": trim_mean(times_s, 0.25) if is_reached else None,
            "mean_coverage": of["coverage_mean"].mean(), "final_coverage": of["coverage_end"].mean(),
            "path_m": of["path_m"].mean(), "team_ate_m": of["team_ate_m"].mean(),
            "wrong_merges": int(of["wrong_merges"].sum()), "stuck_share_max": of["stuck_share"].max(),
        }  # fmt: skip
        for name, triple in (("sooner_s", s.sooner_s), ("more_coverage", s.more)):
            gain = (None,) * 3 if s is standings[0] else triple
            row |= {f"{name}_{part}": value for part, value in zip(("mean", "low", "high"), gain, strict=True)}
        rows.append(row)
    return rows


def table_of(standings: Sequence[Standing], width: int | None = None) -> str:
    """`rows_of` as text, folded to the width of a terminal."""
    return aligned_text(rows_of(standings), width)


def write_tables(
    standings: Sequence[Standing],
    maps: Sequence[str],
    config: EnvConfig,
    folder: Path,
    pictures: tuple[str, float | None] | None,
    seeds: Sequence[int] | None = None,
) -> list[Path]:
    """Write compare.json, episodes.csv, compare.csv (`means_of`), compare.tex (`rows_of`), and coverage over time as
    a picture; returns their paths.

    pictures: format and dpi; None for no picture.
    """
    episodes = [
        {"agent": s.agent, "map": name, "seed": seed, **{key: getattr(o, key) for key in NUMBERS}}
        for s in standings
        for (name, seed), o in zip(places(maps, seeds), s.outcomes, strict=True)
    ]
    paths = [folder / "compare.json"]
    write_json(paths[0], as_json(standings))
    paths += [
        write_text(folder / "episodes.csv", csv_text(episodes)),
        write_text(folder / "compare.csv", csv_text(means_of(standings))),
        write_text(folder / "compare.tex", latex_table(rows_of(standings))),
    ]
    if pictures is not None and all(o.curve for s in standings for o in s.outcomes):
        curves = {display_name(s.agent): [o.curve for o in s.outcomes] for s in standings}
        time_max_s = config.max_cycles * config.dynamics.time_step_s
        each = "" if seeds is None else f", {len(seeds)} seed{'s' * (len(seeds) > 1)}"
        title = f"{len(maps)} building{'s' * (len(maps) > 1)}{each}, {config.robots} robot{'s' * (config.robots > 1)}"
        paths.append(draw_coverage(curves, time_max_s, folder / f"coverage.{pictures[0]}", title, pictures[1]))
    remove_stale(folder, ("coverage",), paths)
    return paths


def as_json(standings: Sequence[Standing]) -> dict:
    """The results with every episode, for JSON."""
    return {
        s.agent: {"sooner_s": s.sooner_s, "more": s.more, "episodes": [asdict(outcome) for outcome in s.outcomes]}
        for s in standings
    }


def _standing(agent: str, mine: Sequence[Outcome], first: Sequence[Outcome]) -> Standing:
    sooner = np.array([b.goal_s - a.goal_s for a, b in zip(mine, first, strict=True)])
    if not any(o.is_reached for o in (*mine, *first)):
        sooner[:] = np.nan
    more = np.array([a.coverage_mean - b.coverage_mean for a, b in zip(mine, first, strict=True)])
    return Standing(agent, tuple(mine), mean_interval(sooner), mean_interval(more))


def _interval(triple: tuple[float, float, float], form: str) -> str:
    mean, low, high = triple
    if math.isnan(mean):
        return "-"
    return f"{mean:{form}}" if math.isnan(low) else f"{mean:{form}} ({low:{form}} to {high:{form}})"


def _line(count: int, total: int, part: tuple[str, str, int], outcome: Outcome) -> str:
    name, agent, seed = part
    reached = f"{outcome.goal_s:.0f} s" if outcome.is_reached else "not reached"
    where = f"[{count}/{total}] {name}, seed {seed}"
    return f"{where}, {display_name(agent)}: {GOAL:.0%} {reached}, at the end {outcome.coverage_end:.3f}"


def _once(config: EnvConfig, finished: FinishedParts, part: tuple[str, str, int]) -> Outcome:
    name, agent, seed = part
    config = override(config, {"map": name})
    origin = origin_of(config, agent)
    own = "".join(f" {digest}" for key, digest in origin.items() if key not in ("code_digest", "map_digest"))
    key = f"{name} {origin['map_digest']} {agent}{own} {seed}"
    found = finished.once(key, lambda: asdict(explore(config, agent, seed)))
    return Outcome(**{**found, "curve": tuple(found.get("curve", ()))})
