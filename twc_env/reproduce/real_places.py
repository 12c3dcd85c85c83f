"""Place recognition on two real floors: surveyed phone traces as robots, real WiFi, real place names as signs.

A place is where a WiFi scan ended (rows at most 4 s old) and at least one place name could be read along the surveyed
trace; names are misread as papers.md T3 says. All methods judge all pairs of places of two traces; right are those at
most 5 m apart. What a method has to learn (WiFi tolerance, weights) it learns on the other floor; what it may learn on
the spot (how common a name is, how far fingerprints of one trace differ with distance) it learns without any position
of other traces. Each seed draws the misreadings and four fifths of the traces; `sd` is the spread over the seeds.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rapidfuzz.distance import Levenshtein
from rapidfuzz.process import cdist

from twc_env.config import SignsConfig
from twc_env.datasets.geojson import read_geojson
from twc_env.datasets.indoor20 import FRESH_S, read_indoor20
from twc_env.random_streams import random_stream
from twc_env.reproduce.place_pairs import average_precision, precision_recall_curve, recall_at_full_precision
from twc_env.reproduce.runner import Runner, data_folder, seeds_argument
from twc_env.slam.radio_statistics import FLOOR_DBM, RadioStatistics
from twc_env.slam.text_likelihood import log_text_likelihood
from twc_env.slam.text_similarity import normalise
from twc_env.world.floorplan import Floorplan
from twc_env.world.signs import SignCamera

Array = NDArray

SUMMARY = "same place within 5 m on two real floors: text, WiFi, both, and all cues fused"
CHOOSES = ("seeds",)

FLOORS = {"B1": "site1_B1", "F6": "site2_F6"}
METHODS = ("text", "wifi", "twc", "fused")
SAME_PLACE_M = 5.0
PLACE_STEP_M = 4.0
TRACE_SHARE = 0.8
CAMERA = SignsConfig(reader="simple", range_max_m=8.0, character_height_m=0.15)
"""Names over shops can be read from further away than door plates."""
READ_PERIOD_S, READ_AROUND_S = 0.5, 2.0
"""How often names are read, and for how long before and after a scan."""
ELSEWHERE_M = 10.0
TOLERANCES_DB = (3.0, 4.0, 5.0, 7.0, 10.0, 14.0)
TEXT_LIMIT = 8.0


@dataclass(frozen=True, slots=True, eq=False)
class Floor:
    """All that can be sensed along the traces of a floor."""

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
    """The places of one draw, and what was sensed at each."""

    position_m: Array
    trace: Array
    rssi_dbm: Array
    readings: tuple[tuple[str, ...], ...]
    """Of each sign the reading nearest in time to the scan."""
    agreed: tuple[tuple[tuple[str, int], ...], ...]
    """Of each sign the reading that most readings agree with, and how many these are."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the table."""
    parser.add_argument("--seeds", type=seeds_argument, default=list(range(10)), help="draws (default: 0-9)")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """One row per floor and method: {floor, trained_on, method, average_precision, recall_at_full_precision, sd}."""
    folder = data_folder() / "indoor20"
    floors = {name: read_floor(folder / part) for name, part in FLOORS.items()}
    draws = runner.each(options.seeds, lambda seed: judge_draw(floors, seed), lambda seed: f"draw {seed}")
    table = []
    for floor, trained_on in (("F6", "B1"), ("B1", "F6")):
        for method in METHODS:
            figures = [draw[floor][method] for draw in draws]
            values = {key: np.array([f[key] for f in figures], float) for key in figures[0]}
            row: dict = {"floor": floor, "trained_on": trained_on, "method": method}
            row |= {key: round(float(value.mean()), 4) for key, value in values.items()}
            row["sd"] = round(float(values["average_precision"].std()), 4)
            row |= {f"sd_{k}": round(float(v.std()), 4) for k, v in values.items() if k != "average_precision"}
            table.append(row | {"seeds": len(draws)})
    return table


def remarks(table: list[dict]) -> list[str]:
    """How far `fused` is above the best other method on each floor, in units of the spread over draws."""
    lines = []
    for floor in dict.fromkeys(row["floor"] for row in table):
        rows_of = {row["method"]: row for row in table if row["floor"] == floor}
        fused = rows_of.pop("fused")
        best = max(rows_of.values(), key=lambda row: row["average_precision"])
        margin, spread = fused["average_precision"] - best["average_precision"], max(fused["sd"], best["sd"])
        verdict = "more" if margin > spread else "not more"
        lines.append(
            f"{floor}: fused is {margin:+.3f} in average precision against {best['method']}, the best other; "
            f"{verdict} than the larger spread of the two, {spread:.3f}"
        )
    return lines


def read_floor(folder: Path) -> Floor:
    """Plan and traces of one floor."""
    survey = read_indoor20(folder, FRESH_S)
    plan = read_geojson(folder / "geojson_map.json.gz")
    order = np.lexsort((survey.time_s, survey.walk))
    heard = survey.rssi_dbm[order].astype(float)
    return Floor(plan, survey.position_m[order], survey.time_s[order], survey.walk[order], heard)


def judge_draw(floors: dict[str, Floor], seed: int) -> dict[str, dict[str, dict[str, float]]]:
    """Each floor judged by what was learned on the other: floor -> method -> figures."""
    cues = {name: Cues(draw_places(floor, seed)) for name, floor in floors.items()}
    learned = {name: learn(c) for name, c in cues.items()}
    result = {}
    for name, c in cues.items():
        (other,) = set(cues) - {name}
        result[name] = {
            m: _figures(score, c.is_same, learned[other][m]) for m, score in scores(c, learned[other]).items()
        }
    return result


# --- places ---


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
    """Sign -> (time to the scan, text) of every reading while the walker came and went."""
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
    """The reading nearest to all readings, the longest of several, and how often it was read."""
    distances = cdist(texts, texts, scorer=Levenshtein.distance).sum(axis=1)
    best = max((texts[k] for k in np.flatnonzero(distances == distances.min())), key=lambda text: (len(text), text))
    return best, texts.count(best)


# --- cues, all pairs at once ---


class Cues:
    """Everything the methods use, for all pairs of places of different traces."""

    def __init__(self, places: Places):
        first, second = np.triu_indices(len(places.trace), 1)
        apart = places.trace[first] != places.trace[second]
        self._places = places
        self._pairs = first[apart], second[apart]
        distance = np.linalg.norm(places.position_m[:, None] - places.position_m[None], axis=2)
        self.is_same = distance[self._pairs] <= SAME_PLACE_M
        shared, rms, difference, counts = _compare_radio(places.rssi_dbm)
        self.text = self._best_pair(*_unique(places.readings), _similarity)
        self.macs = (shared / np.maximum(np.maximum.outer(counts, counts), 1))[self._pairs]
        self.rms_db = rms[self._pairs]
        radio = _log_ratios(difference, distance, places.trace)
        evidence = self._best_pair(*_unique(places.agreed), _log_text_ratio, whole=True)
        self.features = np.column_stack(
            [evidence[self._pairs], radio[self._pairs], np.log(self.macs + 0.02), _loud(places.rssi_dbm)[self._pairs]]
            + [_along(cue, places.trace)[self._pairs] for cue in (evidence, radio)]
        )
        """(pairs, 6): text, radio, shared transmitters, loudest transmitters, and the first two along both traces."""

    def _best_pair(self, values: list, owners: list[Array], compare, whole: bool = False) -> Array:
        """The largest comparison between any value of one place and any of the other."""
        table = compare(values)  # (values, values)
        reach = np.stack([table[owned].max(axis=0) for owned in owners])  # (places, values)
        best = np.stack([reach[:, owned].max(axis=1) for owned in owners], axis=1)
        return best if whole else best[self._pairs]


def _loud(rssi_dbm: Array) -> Array:
    """(places, places) cosine of the received powers to the fourth root: the loudest transmitters decide."""
    power = np.where(np.isfinite(rssi_dbm), 10 ** (np.nan_to_num(rssi_dbm, nan=-100.0) / 40), 0.0)
    power /= np.maximum(np.linalg.norm(power, axis=1, keepdims=True), 1e-12)
    return power @ power.T


def _unique(owned: tuple[tuple, ...]) -> tuple[list, list[Array]]:
    """All different values, and for each place which of them are its own."""
    values = sorted({value for own in owned for value in own})
    number = {value: k for k, value in enumerate(values)}
    return values, [np.array([number[value] for value in own]) for own in owned]


def _similarity(texts: list[str]) -> Array:
    return cdist(texts, texts, scorer=Levenshtein.normalized_similarity)


def _log_text_ratio(values: list[tuple[str, int]]) -> Array:
    """How much likelier a reading is of the other's sign than of any sign read on this floor."""
    texts, counts = [text for text, _ in values], np.array([count for _, count in values])
    likelihood = np.stack([log_text_likelihood(text, texts, count, counts) for text, count in values])
    chance = np.logaddexp.reduce(likelihood, axis=1, keepdims=True) - np.log(len(values))
    ratio = likelihood - chance
    return np.clip(0.5 * (ratio + ratio.T), -TEXT_LIMIT, TEXT_LIMIT)


def _compare_radio(rssi_dbm: Array) -> tuple[Array, Array, Array, Array]:
    """(n, n) shared transmitters, rms over them, rms over all that either heard (offset removed); (n,) heard."""
    heard = np.isfinite(rssi_dbm)
    mask = heard.astype(float)
    level = np.where(heard, np.maximum(rssi_dbm - FLOOR_DBM, 0.0), 0.0)
    shared, counts = mask @ mask.T, heard.sum(axis=1)
    squares = (level**2) @ mask.T
    rms = np.sqrt(np.maximum(squares + squares.T - 2 * level @ level.T, 0.0) / np.maximum(shared, 1))
    rms[shared == 0] = np.inf
    union = np.maximum(np.add.outer(counts, counts) - shared, 1)
    power, total = (level**2).sum(axis=1), level.sum(axis=1)
    mean = np.subtract.outer(total, total) / union
    spread = (np.add.outer(power, power) - 2 * level @ level.T) / union - mean**2
    return shared, rms, np.sqrt(np.maximum(spread, 0.0)), counts


def _log_ratios(difference_db: Array, distance_m: Array, trace: Array) -> Array:
    """(n, n) log-likelihood ratios of the radio differences, after learning within each trace how they grow."""
    statistics = RadioStatistics()
    own = trace[:, None] == trace[None]
    for i, j in zip(*np.nonzero(np.triu(own, 1)), strict=True):
        if distance_m[i, j] <= SAME_PLACE_M or distance_m[i, j] >= ELSEWHERE_M:
            statistics.learn(float(difference_db[i, j]), bool(distance_m[i, j] <= SAME_PLACE_M))
    slope = statistics.log_ratio(1.0) - statistics.log_ratio(np.e)
    return statistics.log_ratio(1.0) - slope * np.log(np.maximum(difference_db, 0.5))


def _along(cue: Array, trace: Array) -> Array:
    """The cue at the neighbours of both places, walked alike or against each other, whichever agrees more."""
    n = len(trace)
    before, after = np.maximum(np.arange(n) - 1, 0), np.minimum(np.arange(n) + 1, n - 1)
    before = np.where(trace[before] == trace, before, np.arange(n))
    after = np.where(trace[after] == trace, after, np.arange(n))
    alike = cue[np.ix_(before, before)] + cue[np.ix_(after, after)]
    against = cue[np.ix_(before, after)] + cue[np.ix_(after, before)]
    return 0.5 * np.maximum(alike, against)


# --- methods ---


def scores(cues: Cues, learned: dict[str, dict]) -> dict[str, Array]:
    """Method -> (pairs,) score; for rules of several thresholds the smallest likeness, all moved together."""
    fused = _standard(cues.features, learned["fused"]) @ learned["fused"]["weights"]
    return {
        "text": cues.text,
        "wifi": _wifi(cues, learned["wifi"]["tolerance_db"]),
        "twc": np.minimum(cues.text, _wifi(cues, learned["twc"]["tolerance_db"])),
        "fused": fused,
    }


def learn(cues: Cues) -> dict[str, dict]:
    """What each method takes along to the other floor."""
    wifi = {t: average_precision(_wifi(cues, t), cues.is_same) for t in TOLERANCES_DB}
    both = {t: average_precision(np.minimum(cues.text, _wifi(cues, t)), cues.is_same) for t in TOLERANCES_DB}
    learned: dict[str, dict] = {
        "text": {},
        "wifi": {"tolerance_db": max(wifi, key=wifi.__getitem__)},
        "twc": {"tolerance_db": max(both, key=both.__getitem__)},
        "fused": {"mean": cues.features.mean(axis=0), "std": cues.features.std(axis=0)},
    }
    learned["fused"]["weights"] = logistic(_standard(cues.features, learned["fused"]), cues.is_same)
    for method, score in scores(cues, learned).items():
        learned[method]["threshold"] = _best_threshold(score, cues.is_same)
    return learned


def _wifi(cues: Cues, tolerance_db: float) -> Array:
    return np.minimum(cues.macs, np.minimum(1.0, tolerance_db / np.maximum(cues.rms_db, 1e-9)))


def _standard(features: Array, learned: dict) -> Array:
    """Features in units of the training floor's spread, and a constant."""
    return np.column_stack([(features - learned["mean"]) / learned["std"], np.ones(len(features))])


def logistic(features: Array, is_same: Array, iterations: int = 12) -> Array:
    """(features,) weights of a logistic regression with a weak pull to zero, by Newton's method."""
    weights = np.zeros(features.shape[1])
    for _ in range(iterations):
        share = 1.0 / (1.0 + np.exp(-np.clip(features @ weights, -30, 30)))
        gradient = features.T @ (is_same - share) - weights
        curvature = (features * (share * (1 - share))[:, None]).T @ features + np.eye(len(weights))
        weights = weights + np.linalg.solve(curvature, gradient)
    return weights


def _best_threshold(score: Array, is_same: Array) -> float:
    """The score at which precision and recall are best together (F1)."""
    precision, recall = precision_recall_curve(score, is_same)
    f1 = 2 * precision * recall / np.maximum(precision + recall, 1e-12)
    return float(np.unique(score)[::-1][int(np.argmax(f1))])


def _figures(score: Array, is_same: Array, learned: dict) -> dict[str, float]:
    accepted = score >= learned["threshold"]
    return {
        "average_precision": average_precision(score, is_same),
        "recall_at_full_precision": recall_at_full_precision(score, is_same),
        "precision": float(is_same[accepted].mean()) if accepted.any() else np.nan,
        "recall": float(accepted[is_same].mean()),
    }
