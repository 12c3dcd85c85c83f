"""One set of radio measurements and its simulated twin, and what the studies of all sets share."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twc_env.config import RadioConfig, from_dict
from twc_env.datasets.fingerprints import RadioSurvey
from twc_env.metrics.radio import cosine_similarity, distance_at_similarity

Array = NDArray
Figures = dict[str, float]

SIMILARITIES = (0.7, 0.8, 0.9)
FAINTEST_SHARE = 0.03


@dataclass(frozen=True, slots=True)
class Study:
    """One set: what it measured, and what the model gives in its place."""

    name: str
    role: str
    """calibrated or reported."""
    preset: str
    changes: dict
    """Settings of the place that differ from the preset."""
    real: Callable[[Path, bool], Figures]
    simulated: Callable[[Path, RadioConfig, int, bool], Figures]
    reasons: dict[str, str] = dataclasses.field(default_factory=dict)
    """Why figures whose name begins with the key are missed."""

    @property
    def config(self) -> RadioConfig:
        """The radio settings of the simulation."""
        return from_dict({"preset": self.preset, **self.changes}, RadioConfig, "radio")


def similarity_figures(survey: RadioSurvey, rssi_dbm: Array, is_pair: Array, offset_db: float = 100.0) -> Figures:
    """Transmitters per scan, and how far apart pairs of like scans are."""
    similarity = cosine_similarity(rssi_dbm, offset_db)
    figures = {"transmitters per scan": float(np.isfinite(rssi_dbm).sum(axis=1).mean())}
    for at in SIMILARITIES:
        mean, std = distance_at_similarity(survey.position_m, similarity, is_pair, at)
        figures[f"distance at cosine {at}: mean [m]"] = mean
        figures[f"distance at cosine {at}: sd [m]"] = std
    return figures


def faintest_dbm(rssi_dbm: Array) -> float:
    """How faint a receiver's faintest readings are: what a set tells of its device."""
    return float(np.nanquantile(rssi_dbm, FAINTEST_SHARE))


def device_floors(survey: RadioSurvey) -> dict:
    """Settings of the detection floors of a survey's own receiver, by band."""
    is_high = survey.transmitters[2]
    low_dbm, high_dbm = (faintest_dbm(survey.rssi_dbm[:, is_high == band]) for band in (False, True))
    return {"detection_floor_dbm": low_dbm, "high_band": {"detection_offset_db": high_dbm - low_dbm}}


def with_settings(config: RadioConfig, changes: dict) -> RadioConfig:
    """The settings with (nested) changes."""
    values = dataclasses.asdict(config)
    nested = {key: {**values[key], **value} if isinstance(value, dict) else value for key, value in changes.items()}
    return from_dict({**values, **nested}, RadioConfig, "radio")


def thinned(survey: RadioSurvey, quick: bool) -> RadioSurvey:
    """Every tenth scan, for a quick look."""
    if not quick:
        return survey
    return survey.at_scans(np.arange(0, len(survey.position_m), 10))


def extent(position_m: Array, margin_m: float) -> Array:
    """(4,) bounds around places (k, 2)."""
    return np.concatenate([position_m.min(axis=0) - margin_m, position_m.max(axis=0) + margin_m])
