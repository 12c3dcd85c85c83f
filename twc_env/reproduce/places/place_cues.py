"""Similarity of all pairs of places: names, radio, and both along the traces."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray as Array
from rapidfuzz.distance import Levenshtein
from rapidfuzz.process import cdist

from twc_env.reproduce.places.surveyed_places import Places
from twc_env.slam.places.radio_statistics import FLOOR_DBM, RadioStatistics
from twc_env.slam.places.text_likelihood import log_text_likelihood

SAME_PLACE_M = 5.0
ELSEWHERE_M = 10.0
TEXT_LIMIT = 8.0


class Cues:
    """The cues of all methods, for all pairs of places on different traces."""

    def __init__(self, places: Places):
        first, second = np.triu_indices(len(places.trace), 1)
        apart = places.trace[first] != places.trace[second]
        pairs = first[apart], second[apart]
        distance = np.linalg.norm(places.position_m[:, None] - places.position_m[None], axis=2)
        self.is_same = distance[pairs] <= SAME_PLACE_M
        shared, rms, difference, counts = _compare_radio(places.rssi_dbm)
        self.text = _best_pair(places.readings, _similarity)[pairs]
        self.macs = (shared / np.maximum(np.maximum.outer(counts, counts), 1))[pairs]
        self.rms_db = rms[pairs]
        radio = _log_ratios(difference, distance, places.trace)
        evidence = _best_pair(places.agreed, _log_text_ratio)
        self.features = np.column_stack(
            [evidence[pairs], radio[pairs], np.log(self.macs + 0.02), _loud(places.rssi_dbm)[pairs]]
            + [_along(cue, places.trace)[pairs] for cue in (evidence, radio)]
        )
        """(pairs, 6): text, radio, shared transmitters, strongest transmitters, and the first two along both traces."""


def _best_pair(owned: tuple[tuple, ...], compare: Callable[[list], Array]) -> Array:
    """(places, places) the maximum similarity between the values of two places."""
    values = sorted({value for own in owned for value in own})
    number = {value: k for k, value in enumerate(values)}
    owners = [np.array([number[value] for value in own]) for own in owned]
    table = compare(values)  # (values, values)
    reach = np.stack([table[own].max(axis=0) for own in owners])  # (places, values)
    return np.stack([reach[:, own].max(axis=1) for own in owners], axis=1)


def _loud(rssi_dbm: Array) -> Array:
    """(places, places) cosine of the fourth roots of received powers, dominated by the strongest transmitters."""
    power = np.where(np.isfinite(rssi_dbm), 10 ** (np.nan_to_num(rssi_dbm, nan=-100.0) / 40), 0.0)
    power /= np.maximum(np.linalg.norm(power, axis=1, keepdims=True), 1e-12)
    return power @ power.T


def _similarity(texts: list[str]) -> Array:
    return cdist(texts, texts, scorer=Levenshtein.normalized_similarity)


def _log_text_ratio(values: list[tuple[str, int]]) -> Array:
    """Log-likelihood ratio of two readings: same sign against any sign read on this floor."""
    texts, counts = [text for text, _ in values], np.array([count for _, count in values])
    likelihood = np.stack([log_text_likelihood(text, texts, count, counts) for text, count in values])
    chance = np.logaddexp.reduce(likelihood, axis=1, keepdims=True) - np.log(len(values))
    ratio = likelihood - chance
    return np.clip(0.5 * (ratio + ratio.T), -TEXT_LIMIT, TEXT_LIMIT)


def _compare_radio(rssi_dbm: Array) -> tuple[Array, Array, Array, Array]:
    """(n, n) shared transmitters, rms difference over them, rms over all heard by either (offset removed); (n,)
    heard."""
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
    """(n, n) log-likelihood ratios of the radio differences, learned from their growth within each trace."""
    statistics = RadioStatistics()
    own = trace[:, None] == trace[None]
    for i, j in zip(*np.nonzero(np.triu(own, 1)), strict=True):
        if distance_m[i, j] <= SAME_PLACE_M or distance_m[i, j] >= ELSEWHERE_M:
            statistics.learn(float(difference_db[i, j]), bool(distance_m[i, j] <= SAME_PLACE_M))
    slope = statistics.log_ratio(1.0) - statistics.log_ratio(np.e)
    return statistics.log_ratio(1.0) - slope * np.log(np.maximum(difference_db, 0.5))


def _along(cue: Array, trace: Array) -> Array:
    """Mean cue of the neighbours of both places along the traces, in the direction that agrees more."""
    n = len(trace)
    before, after = np.maximum(np.arange(n) - 1, 0), np.minimum(np.arange(n) + 1, n - 1)
    before = np.where(trace[before] == trace, before, np.arange(n))
    after = np.where(trace[after] == trace, after, np.arange(n))
    alike = cue[np.ix_(before, before)] + cue[np.ix_(after, after)]
    against = cue[np.ix_(before, after)] + cue[np.ix_(after, before)]
    return 0.5 * np.maximum(alike, against)
