"""From the episodes of a benchmark to the rows of its leaderboard, its curves and its profiles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.metrics import team_scores
from twc_env.suite.entries import INFORMED, NO_RIVALS, RANDOM, REFERENCES, Entry
from twc_env.suite.twins import TwinRow, twin_rows

ALL = "all"
"""In the place of a task: all of them together."""
SHARES = (0.5, 0.9, 0.99)
"""Shares of the floor whose times are reported."""
POINTS_MAX = 200
"""Most points of a curve that is drawn."""
THRESHOLDS = np.round(np.arange(0.0, 1.2001, 0.02), 2)
"""Scores of a performance profile."""
AVERAGED = "coverage_mean", "coverage_end", "ate_m", "bytes_sent", "path_m", "collisions", "stuck_share", "ended_share"
"""Figures of `ALL` that are means over tasks."""


@dataclass(frozen=True, slots=True)
class Row:
    """One team in one task, or in all; means and medians are over buildings."""

    task: str
    team: str
    buildings: int
    score: float
    """Interquartile mean of the score, with its 95 % interval ..."""
    low: float
    """(nan with fewer than two buildings per task)"""
    high: float
    improvement: float
    """Probability of scoring higher than the best other team in the same building ..."""
    improvement_over: str
    """... which is this one; references are no others."""
    coverage_mean: float
    """Area under the curve of the floor in a correctly merged map: its mean over the budget of time."""
    coverage_end: float
    """That floor at the end."""
    wrong_merges: int
    """Pairs of robots, summed over episodes."""
    merged_s: float
    """Median time until all robots shared one correct map; inf if half of the teams never did, as all times."""
    ate_m: float
    """Mean."""
    bytes_sent: float
    """Mean, of the whole team, as the next two."""
    path_m: float
    collisions: float
    stuck_share: float
    """Mean share of the time in which a robot that was told to move stayed in place (`commanded_stuck_share`)."""
    to_50_s: float
    """Median time until this share of the floor was in a correctly merged map."""
    to_90_s: float
    to_99_s: float
    ended_share: float
    """Share of the episodes that ended because the floor was mapped (`episode.ends_at_coverage`)."""


@dataclass(frozen=True, slots=True)
class Standings:
    """Everything a leaderboard shows."""

    is_normalised: bool
    """Whether scores are those between the random and the informed team; otherwise the area under the curve itself."""
    tasks: tuple[str, ...]
    teams: tuple[str, ...]
    rows: tuple[Row, ...]
    """Task by task, the highest score first; with several tasks, `ALL` before them."""
    curves: dict[str, dict[str, dict[str, list[float]]]]
    """Task -> team -> `time_s`, `mean`, `low`, `high` of the floor in a correctly merged map over time."""
    profiles: dict[str, dict[str, list[float]]]
    """Team -> `share`, `low`, `high` of the episodes that score above each of `THRESHOLDS`, averaged over tasks."""
    twins: tuple[TwinRow, ...]
    """Teams whose blind twins have played, too."""

    def rows_of(self, task: str) -> list[Row]:
        """The rows of one task, or of `ALL`."""
        return [row for row in self.rows if row.task == task]

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "score": "normalised" if self.is_normalised else "area under the curve (no informed team)",
            "rows": [asdict(row) for row in self.rows],
            "curves": self.curves,
            "profiles": {"thresholds": THRESHOLDS.tolist(), **self.profiles},
            "twins": [asdict(row) for row in self.twins],
        }


class _Episodes:
    """The episodes of one team in one task, ordered by building."""

    def __init__(self, values: Sequence[dict[str, Any]], budget_s: float):
        self.values = values
        self.period_s = float(values[0]["period_s"])
        self.count = max(math.floor(budget_s / self.period_s + 1e-9), 1)
        self.curves = [np.array(each["coverage"], float) for each in values]
        self.areas = np.array([team_scores.area_under_curve(curve, self.count) for curve in self.curves])

    def mean(self, key: str) -> float:
        return float(np.mean([each[key] for each in self.values]))

    def median_time_to(self, share: float) -> float:
        return float(np.median([team_scores.time_to(curve, share, self.period_s) for curve in self.curves]))

    def row(self, task: str, team: str, scores: Array, improvement: float, over: str) -> Row:
        return Row(
            task=task, team=team, buildings=len(self.values),
            score=float(team_scores.interquartile_mean(scores)),
            **dict(zip(("low", "high"), team_scores.iqm_interval([scores]), strict=True)),
            improvement=improvement, improvement_over=over,
            coverage_mean=float(self.areas.mean()),
            coverage_end=float(np.mean([curve[-1] if len(curve) else 0.0 for curve in self.curves])),
            wrong_merges=sum(each["wrong_merges"] for each in self.values),
            merged_s=float(np.median([math.inf if each["merged_s"] is None else each["merged_s"]
                                      for each in self.values])),
            ate_m=self.mean("ate_m"), bytes_sent=self.mean("bytes_sent"), path_m=self.mean("path_m"),
            collisions=self.mean("collisions"), stuck_share=self.mean("stuck_share"),
            **{f"to_{share * 100:.0f}_s": self.median_time_to(share) for share in SHARES},
            ended_share=self.mean("is_covered"),
        )  # fmt: skip

    def curve(self) -> dict[str, list[float]]:
        """Mean over buildings with its interval, at `POINTS_MAX` moments at most."""
        every = math.ceil(self.count / POINTS_MAX)
        at = np.arange(every - 1, self.count, every)
        curves = np.array([team_scores.padded(curve, self.count)[at] for curve in self.curves])
        low, high = team_scores.mean_interval(curves)
        found = {"time_s": (at + 1) * self.period_s, "mean": curves.mean(axis=0), "low": low, "high": high}
        return {name: np.round(values, 6).tolist() for name, values in found.items()}


def budget_areas(played: Sequence[tuple[Entry, dict[str, Any]]]) -> dict[str, Array]:
    """Of the episodes of one task: team -> (buildings,) area under its curve, in the order of the entries."""
    grouped: dict[str, list[dict[str, Any]]] = {}
    for entry, value in played:
        grouped.setdefault(entry.team, []).append(value)
    config = played[0][0].config
    budget_s = config.max_cycles * config.dynamics.time_step_s
    return {team: _Episodes(values, budget_s).areas for team, values in grouped.items()}


def standings_of(entries: Sequence[Entry], values: Sequence[dict[str, Any]]) -> Standings:
    """The standings from all episodes of a benchmark, in the order of their entries."""
    tasks, teams = (tuple(dict.fromkeys(getattr(e, name) for e in entries)) for name in ("task", "team"))
    grouped: dict[tuple[str, str], list[dict[str, Any]]] = {}
    budgets = {e.task: e.config.max_cycles * e.config.dynamics.time_step_s for e in entries}
    for entry, value in zip(entries, values, strict=True):
        grouped.setdefault((entry.task, entry.team), []).append(value)
    played = {(task, team): _Episodes(grouped[task, team], budgets[task]) for task in tasks for team in teams}
    scores, is_normalised = _scores(played, tasks, teams)
    rows: list[Row] = []
    if len(tasks) > 1:
        rows += _overall(played, scores, tasks, teams)
    for task in tasks:
        of_task = {team: [scores[task, team]] for team in teams}
        own = [played[task, t].row(task, t, scores[task, t], *_improvement(of_task, t)) for t in teams]
        rows += sorted(own, key=lambda row: -row.score)
    curves = {task: {team: played[task, team].curve() for team in teams} for task in tasks}
    profiles = {team: _profile([scores[task, team] for task in tasks]) for team in teams}
    twins = twin_rows({key: episodes.areas for key, episodes in played.items()}, grouped)
    return Standings(is_normalised, tasks, teams, tuple(rows), curves, profiles, twins)


def _scores(
    played: dict[tuple[str, str], _Episodes], tasks: Sequence[str], teams: Sequence[str]
) -> tuple[dict[tuple[str, str], Array], bool]:
    """(buildings,) score of each task and team, and whether it is normalised in all tasks.

    It is if both references played and the informed team is better than the random one, on average over buildings.
    """
    areas = {key: episodes.areas for key, episodes in played.items()}
    if not set(REFERENCES) <= set(teams):
        return areas, False
    ends = {task: (areas[task, RANDOM].mean(), areas[task, INFORMED].mean()) for task in tasks}
    if any(informed <= random for random, informed in ends.values()):
        return areas, False
    return {(task, team): team_scores.normalised(a, *ends[task]) for (task, team), a in areas.items()}, True


def _profile(strata: Sequence[Array]) -> dict[str, list[float]]:
    low, high = team_scores.profile_interval(strata, THRESHOLDS)
    found = {"share": team_scores.performance_profile(strata, THRESHOLDS), "low": low, "high": high}
    return {name: np.round(values, 6).tolist() for name, values in found.items()}


def _improvement(scores: dict[str, list[Array]], team: str) -> tuple[float, str]:
    """Probability of improvement over the best other team that is no reference, and which one that is."""
    others = [name for name in scores if name not in (team, *NO_RIVALS)]
    if not others:
        return math.nan, ""
    best = max(others, key=lambda name: float(team_scores.interquartile_mean(np.concatenate(scores[name]))))
    return team_scores.probability_of_improvement(scores[team], scores[best]), best


def _overall(
    played: dict[tuple[str, str], _Episodes], scores: dict[tuple[str, str], Array], tasks: Sequence[str],
    teams: Sequence[str],
) -> list[Row]:  # fmt: skip
    """The rows of `ALL`: scores over the episodes of all tasks, figures averaged over tasks, merges summed.

    Times differ too much between tasks to be put together.
    """
    strata = {team: [scores[task, team] for task in tasks] for team in teams}
    rows = []
    for team in teams:
        own = [played[task, team].row(task, team, scores[task, team], math.nan, "") for task in tasks]
        low, high = team_scores.iqm_interval(strata[team])
        improvement, over = _improvement(strata, team)
        rows.append(
            Row(
                task=ALL,
                team=team,
                buildings=sum(row.buildings for row in own),
                score=float(team_scores.interquartile_mean(np.concatenate(strata[team]))),
                low=low,
                high=high,
                improvement=improvement,
                improvement_over=over,
                wrong_merges=sum(row.wrong_merges for row in own),
                merged_s=math.nan,
                to_50_s=math.nan,
                to_90_s=math.nan,
                to_99_s=math.nan,
                **{key: float(np.mean([getattr(row, key) for row in own])) for key in AVERAGED},
            )
        )
    return sorted(rows, key=lambda row: -row.score)
