"""Places along surveyed phone traces of a real floor: positions of WiFi scans, and names that are legible there."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array
from rapidfuzz.distance import Levenshtein
from rapidfuzz.process import cdist

from twc_env.config import SignsConfig
from twc_env.datasets.buildings.geojson import read_geojson
from twc_env.datasets.surveys.indoor20 import FRESH_S, read_indoor20
from twc_env.records.random_streams import random_stream
from twc_env.slam.places.text_similarity import normalise
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.sensors.signs import SignCamera

PLACE_STEP_M = 4.0
TRACE_SHARE = 0.8
CAMERA = SignsConfig(reader="simple", range_max_m=8.0, character_height_m=0.15)
"""Names of shops are legible from farther away than door plates."""
READ_PERIOD_S, READ_AROUND_S = 0.5, 2.0
"""Period of reading names, and time before and after a scan in which they are read."""


@dataclass(frozen=True, slots=True, eq=False)
class Floor:
    """Measurements along the traces of a floor."""

    plan: Floorplan
    position_m: Array
    """(scans, 2)."""
    time_s: Array
    trace: Array
    """(scans,) number of the trace."""
    rssi_dbm: Array
    """(scans, transmitters), NaN where not heard."""


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """The places of one random draw, and the measurements at each."""

    position_m: Array
    trace: Array
    rssi_dbm: Array
    readings: tuple[tuple[str, ...], ...]
    """The reading of each sign that is nearest in time to the scan."""
    agreed: tuple[tuple[tuple[str, int], ...], ...]
    """The reading of each sign that agrees best with all its readings, and its count."""


def read_floor(folder: Path) -> Floor:
    """Plan and traces of one floor."""
    survey = read_indoor20(folder, FRESH_S)
    plan = read_geojson(folder / "geojson_map.json.gz")
    order = np.lexsort((survey.time_s, survey.walk))
    heard = survey.rssi_dbm[order].astype(float)
    return Floor(plan, survey.position_m[order], survey.time_s[order], survey.walk[order], heard)


def draw_places(floor: Floor, seed: int) -> Places:
    """Places of a random share of the traces, with their readings."""
    random = random_stream(seed, "traces")
    traces = np.unique(floor.trace)
    kept = random.choice(traces, round(TRACE_SHARE * len(traces)), replace=False)
    chosen, readings, agreed = [], [], []
    for trace in np.sort(kept):
        scans = np.flatnonzero(floor.trace == trace)
        camera = SignCamera(CAMERA, floor.plan, int(trace), seed)
        last = None
        for scan in scans:
            if last is not None and np.hypot(*(floor.position_m[scan] - floor.position_m[last])) < PLACE_STEP_M:
                continue
            seen = _read_around(floor, scans, int(scan), camera)
            if seen:
                last = scan
                chosen.append(scan)
                readings.append(tuple(min(views)[1] for views in seen.values()))
                agreed.append(tuple(_agreed([text for _, text in views]) for views in seen.values()))
    return Places(
        floor.position_m[chosen],
        floor.trace[chosen],
        floor.rssi_dbm[chosen],
        tuple(readings),
        tuple(agreed),
    )


def _read_around(floor: Floor, scans: Array, scan: int, camera: SignCamera) -> dict[int, list[tuple[float, str]]]:
    """Sign -> (time to the scan, text) of every reading around the time of a scan."""
    times, places = floor.time_s[scans], floor.position_m[scans]
    seen: dict[int, list[tuple[float, str]]] = {}
    for offset in np.arange(-READ_AROUND_S, READ_AROUND_S + 1e-9, READ_PERIOD_S):
        t = floor.time_s[scan] + offset
        if not times[0] <= t <= times[-1]:
            continue
        here, ahead, behind = (
            np.array([np.interp(s, times, places[:, k]) for k in (0, 1)]) for s in (t, t + 0.5, t - 0.5)
        )
        heading = np.arctan2(*(ahead - behind)[::-1])
        for reading, sign in zip(*camera.read(np.array([*here, heading])), strict=True):
            seen.setdefault(sign, []).append((abs(float(offset)), normalise(reading.text)))
    return seen


def _agreed(texts: list[str]) -> tuple[str, int]:
    """The reading with the smallest total edit distance to all readings (the longest of several), and its count."""
    distances = cdist(texts, texts, scorer=Levenshtein.distance).sum(axis=1)
    best = max((texts[k] for k in np.flatnonzero(distances == distances.min())), key=lambda text: (len(text), text))
    return best, texts.count(best)
