"""How much of the gap between the best scripted team and the informed one a trained team closes."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import UNFIT
from twc_env.metrics import team_scores
from twc_env.suite.entries import INFORMED, NO_RIVALS, RANDOM, Entry
from twc_env.suite.standings import budget_areas


def rows_of_models(
    models: Sequence[str], entries: Sequence[Entry], values: Sequence[dict[str, Any]]
) -> list[dict[str, Any]]:
    """One row per task and model that played it.

    `score`: interquartile mean between random (0) and informed (1); `gap_closed`: (model - best) / (informed - best) of
    the mean area under the curve, where the best scripted team is the one with the greatest mean, and None unless the
    informed one is ahead of it with an interval above 0; `lead`: model - best of that area. All with 95 % intervals
    from a bootstrap over buildings, the same for all teams (percentiles, 2,000 resamples). `mean_coverage`: the mean
    area of the row's own model, as `model`, and of the teams beside it.
    """
    rows = []
    for task in dict.fromkeys(entry.task for entry in entries):
        own = [(entry, value) for entry, value in zip(entries, values, strict=True) if entry.task == task]
        areas = budget_areas(own)
        merges: dict[str, int] = {}
        for entry, value in own:
            merges[entry.team] = merges.get(entry.team, 0) + int(value["wrong_merges"])
        scripted = [team for team in areas if team not in (*models, *NO_RIVALS)]
        best = max(scripted, key=lambda team: float(areas[team].mean()))
        for model in (model for model in models if model in areas):
            ends = float(areas[RANDOM].mean()), float(areas[INFORMED].mean())
            scores = team_scores.normalised(areas[model], *ends)
            low, high = team_scores.iqm_interval([scores])
            mine, other, informed = areas[model], areas[best], areas[INFORMED]
            is_gap = _with_interval(_lead, informed, other)[1] > 0.0
            gaps = _with_interval(_gap_closed, mine, other, informed) if is_gap else (math.nan,) * 3
            lead, lead_low, lead_high = _with_interval(_lead, mine, other)
            beside = {team: float(area.mean()) for team, area in areas.items() if team not in models}
            rows.append(
                {
                    "task": task, "model": model, "seed": _seed_of(model), "buildings": len(mine),
                    "score": float(team_scores.interquartile_mean(scores)), "low": low, "high": high,
                    **dict(zip(("gap_closed", "gap_low", "gap_high"), gaps, strict=True)),
                    "best_scripted": best, "lead": lead, "lead_low": lead_low, "lead_high": lead_high,
                    "wrong_merges": merges[model], "wrong_merges_of_best": merges[best],
                    "mean_coverage": {"model": float(mine.mean()), **beside},
                }
            )  # fmt: skip
    return rows


def _gap_closed(mine: Array, best: Array, informed: Array) -> Array:
    gap = informed.mean(-1) - best.mean(-1)
    closed: Array = (mine.mean(-1) - best.mean(-1)) / np.where(np.abs(gap) < 1e-9, np.nan, gap)
    return closed


def _lead(mine: Array, best: Array) -> Array:
    lead: Array = mine.mean(-1) - best.mean(-1)
    return lead


def _with_interval(statistic: Any, *samples: Array) -> tuple[float, float, float]:
    """A statistic of paired samples, and its interval; nan with fewer than two buildings."""
    count = len(samples[0])
    value = float(statistic(*samples))
    if count < 2:
        return value, float("nan"), float("nan")
    drawn = np.random.default_rng(0).integers(count, size=(team_scores.RESAMPLES, count))
    low, high = np.nanpercentile(statistic(*(sample[drawn] for sample in samples)), (2.5, 97.5))
    return value, float(low), float(high)


def _seed_of(model: str) -> int | None:
    """The seed of a training run."""
    folder = Path(model) if Path(model).is_dir() else Path(model).parent
    try:
        seed = json.loads((folder / "config.json").read_text())["settings"]["seed"]
    except (OSError, LookupError, *UNFIT):
        return None
    return int(seed)
