"""What a training run shows while it runs: a bar, metrics.csv and TensorBoard."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from twc_env.records.whole_file import whole_file
from twc_env.running.terminal import tell

from .progress import progress_bar

SHOWN = {
    "mean_coverage": "score",
    "return": "return",
    "coverage": "terms/coverage",
    "merged_robots": "merged_robots",
    "wrong_merges": "wrong_merges",
    "ate_m": "team_ate_m",
    "length": "steps",
}
"""Columns of metrics.csv, and of an episode what they are the mean of: `coverage` is the floor in a correctly merged
map at its end, `mean_coverage` the same over time, which is maximised; `length` is in time steps."""
COLUMNS = ("decisions", "episodes", *SHOWN, "decisions_per_s")
EPISODES_SHOWN = 100
"""Number of the most recent episodes over which means are computed."""


class LearningCurve:
    """After each update: a row of metrics.csv, TensorBoard, and the bar."""

    def __init__(self, folder: Path, total: int, decisions: int, values: Mapping[str, Any], show: bool):
        """decisions, values: where a resumed run goes on, else 0 and nothing."""
        self._folder, self._path, self._total = folder, folder / "metrics.csv", total
        self._recent: list[dict[str, float]] = list(values.get("recent", []))
        self._episodes = int(values.get("episodes", 0))
        self._decisions = decisions
        self._show = show

    def __enter__(self) -> LearningCurve:
        from torch.utils.tensorboard import SummaryWriter

        if self._decisions >= self._total:
            tell(f"nothing to train: {self._folder} has {self._decisions} decisions, --steps asks for {self._total}")
        rows = rows_until(self._decisions, self._path) if self._decisions else []
        with whole_file(self._path) as beside, beside.open("w", newline="") as file:
            csv.writer(file).writerows([COLUMNS, *rows])
        self._board = SummaryWriter(str(self._folder / "tensorboard"), purge_step=self._decisions + 1)
        self._bar = progress_bar(
            total=self._total, initial=min(self._decisions, self._total), unit=" decisions", disable=not self._show
        )
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()
        self._board.close()

    def note(self, decisions: int, new: int, episodes: Sequence[dict], figures: Mapping[str, float]) -> None:
        """`new` more decisions make `decisions` in all; episodes: those that ended."""
        self._recent = [*self._recent, *({k: float(v) for k, v in each.items()} for each in episodes)][-EPISODES_SHOWN:]
        self._episodes += len(episodes)
        means = {name: self._mean(key) for name, key in SHOWN.items()}
        row = [decisions, self._episodes, *(f"{value:.4f}" for value in means.values())]
        row.append(f"{figures['speed/decisions_per_s']:.1f}")
        with self._path.open("a", newline="") as file:  # in one write; what a kill leaves of it is dropped on resuming
            csv.writer(file).writerow(row)
        terms = sorted({key for each in self._recent for key in each if key.startswith("terms/")})
        shown = {f"episodes/{name}": value for name, value in means.items()}
        for name, value in {**shown, **{key: self._mean(key) for key in terms}, **figures}.items():
            if np.isfinite(value):
                self._board.add_scalar(name, value, decisions)
        self._board.flush()
        self._bar.update(min(new, max(self._total - decisions + new, 0)))
        self._bar.set_postfix_str(
            f"coverage {means['coverage']:.2f}, over time {means['mean_coverage']:.3f}, return {means['return']:.2f}, "
            f"merged {means['merged_robots']:.1f}, wrong merges {means['wrong_merges']:.2f}",
            refresh=False,
        )

    def values(self) -> dict[str, Any]:
        """What a resumed run needs."""
        return {"recent": self._recent, "episodes": self._episodes}

    def _mean(self, key: str) -> float:
        return float(np.mean([each[key] for each in self._recent])) if self._recent else float("nan")


def rows_until(decisions: int, path: Path) -> list[list[str]]:
    """Whole rows of metrics.csv; without later ones, whose model a killed run may lack."""
    if not path.exists():
        return []
    lines = path.read_bytes().decode(errors="replace").split("\n")
    rows = [row for row in csv.reader(lines[:-1]) if len(row) == len(COLUMNS) and all(map(str.isdecimal, row[:2]))]
    return [row for row in rows if int(row[0]) <= decisions]
