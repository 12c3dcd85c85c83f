"""One set of radio measurements and its simulation, and shared functions of all sets."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import RadioConfig, from_dict
from twc_env.datasets.surveys.fingerprints import RadioSurvey
from twc_env.metrics.radio import cosine_similarity, distance_at_similarity
from twc_env.records.random_streams import random_stream

Figures = dict[str, float]

Spread = dict[str, tuple[float, float, float]]
"""Per figure the central 95 % over real places, and the share of them within NEAR of the figure of the set."""

NEAR = 0.15
"""Relative tolerance of a figure."""

SIMILARITIES = (0.7, 0.8, 0.9)
_INTERVAL = 0.95


class Study(ABC):
    """One set: its measured figures, and those of the model.

    Figures are computed from the folder of real data; `quick` selects a small part of the data.
    """

    def __init__(self, name: str, role: str, preset: str, changes: dict, runs: int = 1):
        self.name = name
        self.role = role
        """"calibrated" or "reported"."""
        self.runs = runs
        """Simulated buildings per seed: more for small sets, since shadowing and powers of one building are random."""
        self._preset, self._changes = preset, changes  # settings that differ from the preset

    @property
    def config(self) -> RadioConfig:
        """The radio settings of the simulation."""
        return from_dict({"preset": self._preset, **self._changes}, RadioConfig, "radio")

    @abstractmethod
    def real(self, folder: Path, quick: bool) -> Figures:
        """The measured figures."""

    @abstractmethod
    def simulated(self, folder: Path, config: RadioConfig, seed: int, quick: bool) -> Figures:
        """The figures of the model."""

    def spread(self, folder: Path, quick: bool) -> Spread:
        """Spread of the real figures over access points, walks or routers."""
        return {}


def similarity_figures(survey: RadioSurvey, rssi_dbm: Array, is_pair: Array, offset_db: float = 100.0) -> Figures:
    """Transmitters per scan, and distances of pairs of similar scans."""
    similarity = cosine_similarity(rssi_dbm, offset_db)
    figures = {"transmitters per scan": float(np.isfinite(rssi_dbm).sum(axis=1).mean())}
    for at in SIMILARITIES:
        mean, std = distance_at_similarity(survey.position_m, similarity, is_pair, at)
        figures[f"distance at cosine {at}: mean [m]"] = mean
        figures[f"distance at cosine {at}: sd [m]"] = std
    return figures


def spread_over(units: int, figures_of: Callable[[Array], Figures], draws: int = 100) -> Spread:
    """Bootstrap of each figure, over draws (units,) with replacement."""
    random = random_stream(0, "spread")
    found = [figures_of(random.integers(0, units, units)) for _ in range(draws)]
    spread = {}
    for name, own in figures_of(np.arange(units)).items():
        values = np.array([figures[name] for figures in found], float)
        if np.isfinite(values).any():
            low, high = np.nanquantile(values, [0.5 - _INTERVAL / 2, 0.5 + _INTERVAL / 2]).tolist()
            spread[name] = (low, high, share_near(values, own))
    return spread


def share_near(values: Array, real: float) -> float:
    """Share of values (k,) within NEAR of the real one; 0 if that is not finite."""
    return float(np.mean(np.abs(values - real) <= NEAR * abs(real))) if np.isfinite(real) else 0.0


def with_settings(config: RadioConfig, changes: dict) -> RadioConfig:
    """The settings with (nested) changes."""
    values = dataclasses.asdict(config)
    nested = {key: {**values[key], **value} if isinstance(value, dict) else value for key, value in changes.items()}
    return from_dict({**values, **nested}, RadioConfig, "radio")


def subsampled(survey: RadioSurvey, quick: bool) -> RadioSurvey:
    """The survey, with every tenth scan only if `quick`."""
    if not quick:
        return survey
    return survey.at_scans(np.arange(0, len(survey.position_m), 10))


def extent(position_m: Array, margin_m: float) -> Array:
    """(4,) bounds around places (k, 2)."""
    return np.concatenate([position_m.min(axis=0) - margin_m, position_m.max(axis=0) + margin_m])
