"""Evaluation of the methods of TWC-SLAM's Table I on all pairs of passes of some walks.

Pairs and ground truth are the same for all methods: see `twc_table1`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig
from twc_env.records.messages import Keyframe, LoopCandidate
from twc_env.reproduce.places.place_pairs import (
    Counts,
    Pairs,
    all_pairs,
    average_precision,
    best_match,
    precision_recall_curve,
)
from twc_env.reproduce.places.place_pairs import recall_at_full_precision as full_recall
from twc_env.reproduce.routes import SignPass, Walk
from twc_env.slam.matching.loop_verification import LoopVerifier
from twc_env.slam.places.fused_recogniser import FusedRecogniser
from twc_env.slam.places.place_cues import similarities
from twc_env.slam.places.signless_recognisers import ScanRecogniser
from twc_env.slam.places.text_wifi_recogniser import meet_at_sign

TEXT, WIFI = (0.5, 0.8, 1.0), (0.5, 0.8, 1.0)
COMBINED = ((0.5, 0.8), (0.8, 0.8), (0.5, 1.0))
SAME_PLACE_M = 3.0
PLACE_STEP_M = 6.0
"""Spacing of places for WiFi alone (papers.md T10)."""
METHODS = ("text", "wifi", "twc", "lidar", "fused")
GUESS_OF = {"text": "sign", "twc": "sign", "fused": "memory", "wifi": "none", "lidar": "none"}
"""Source of the initial guess of each method: the sign as seen, its remembered position, or none."""
LOOSEST = {"text": 0.5 - 1e-9, "wifi": 0.5 - 1e-9, "twc": 0.5 - 1e-9, "lidar": 0.5, "fused": 0.0}
"""Minimum score of pairs for scan matching (for `twc` that of the texts); others are not confirmed."""
RECALL_LEVELS = np.linspace(0.025, 1.0, 40)
"""Curves hold the best precision of any threshold with at least this recall."""


def score_all(config: EnvConfig, walks: list[Walk]) -> dict:
    """Evaluate all methods on all pairs of passes of these walks: figures per threshold, curves per method."""
    sign_passes = [(robot, sign_pass) for robot, w in enumerate(walks) for sign_pass in w.sign_passes]
    pairs = _pass_pairs(sign_passes)
    views = [sign_pass.keyframe for _, sign_pass in sign_passes]
    cues, scores = _threshold_scores(config, pairs, views)
    scans = ScanRecogniser(config.slam.place_recognition, config.lidar.range_max_m)
    scores["lidar"] = np.array(
        [scans.score(views[i], views[j]) for i, j in zip(pairs.first, pairs.second, strict=True)]
    )
    fused = fused_with_memory(config, walks)
    scores["fused"] = _fused_scores(fused, pairs, views)
    verified = _Verified(config, walks, views, fused)
    confirmed = {
        method: verified.accept(pairs, GUESS_OF[method], scores["text" if method == "twc" else method] >= loosest)
        for method, loosest in LOOSEST.items()
    }
    sure = {method: np.where(confirmed[method], scores[method], -math.inf) for method in METHODS}
    figures = []
    for method, alpha, beta, gamma in settings():
        accepted = _accept(method, alpha, beta, gamma, scores, cues, config)
        figure = {"method": method, "alpha": alpha, "beta": beta, "gamma": gamma}
        figure |= _figure(method, accepted, alpha, scores, pairs)
        figure |= _of(_wifi_at_places(config, walks, beta, gamma) if method == "wifi" else None, "places")
        figure |= _of(all_pairs(accepted & confirmed[method], pairs), "verified")
        figure["average_precision_verified"] = average_precision(sure[method], pairs.is_same)
        figure["recall_at_full_precision_verified"] = full_recall(sure[method], pairs.is_same)
        figures.append(figure)
    curves = {
        method: {name: _curve(score[method], pairs.is_same) for name, score in (("before", scores), ("after", sure))}
        for method in METHODS
    }
    return {"figures": figures, "curves": curves}


def _threshold_scores(config: EnvConfig, pairs: Pairs, views: list[Keyframe]) -> tuple[Array, dict[str, Array]]:
    """(3, pairs) similarity of text, transmitters and strengths; and the scores of the methods with thresholds on
    them."""
    rule = config.slam.place_recognition
    each = [similarities(views[i], views[j], rule) for i, j in zip(pairs.first, pairs.second, strict=True)]
    cues = np.array([(c.text, c.macs, c.rssi) for c in each]).reshape(-1, 3).T
    text, macs, rssi = cues
    return cues, {"text": text, "wifi": np.minimum(macs, rssi), "twc": np.minimum(text, np.minimum(macs, rssi))}


def _figure(method: str, accepted: Array, alpha: float, scores: dict[str, Array], pairs: Pairs) -> dict:
    """Precision and recall of the pairs that a method accepts."""
    conditional = pairs.is_same & (scores["text"] >= alpha - 1e-9) if method == "twc" else pairs.is_same
    counts, best = all_pairs(accepted, pairs), best_match(accepted, scores[method], pairs)
    return {
        "precision": counts.precision,
        "recall_absolute": counts.recall,
        "recall_conditional": counts.right / max(int(conditional.sum()), 1),
        "average_precision": average_precision(scores[method], pairs.is_same),
        "recall_at_full_precision": full_recall(scores[method], pairs.is_same),
        "precision_best_match": best.precision,
        "recall_best_match": best.recall,
    }


def _curve(score: Array, is_same: Array) -> list[float]:
    """The best precision of any threshold at each of RECALL_LEVELS; 0 if none reaches it."""
    precision, recall = precision_recall_curve(score[np.isfinite(score)], is_same[np.isfinite(score)])
    recall = recall * is_same[np.isfinite(score)].sum() / max(int(is_same.sum()), 1)
    return [float(precision[recall >= level - 1e-9].max(initial=0.0)) for level in RECALL_LEVELS]


def score_some(
    config: EnvConfig, walks: list[Walk], name: str, methods: Sequence[str] = ("wifi", "twc"), is_strict: bool = False
) -> list[dict]:
    """Figures of some methods before scan matching; `name` is appended to the name of each.

    `is_strict`: the share of transmitters must be above beta, as in the paper's text, not at least beta.
    """
    sign_passes = [(robot, sign_pass) for robot, w in enumerate(walks) for sign_pass in w.sign_passes]
    pairs, views = _pass_pairs(sign_passes), [sign_pass.keyframe for _, sign_pass in sign_passes]
    cues, scores = _threshold_scores(config, pairs, views)
    if "fused" in methods:
        scores["fused"] = _fused_scores(fused_with_memory(config, walks), pairs, views)
    sliver = 1e-6 if is_strict else 0.0
    return [
        {"method": f"{method} {name}", "alpha": alpha, "beta": beta, "gamma": gamma}
        | _figure(method, _accept(method, alpha, beta + sliver, gamma, scores, cues, config), alpha, scores, pairs)
        | _of(None, "places")
        | _of(None, "verified")
        | dict.fromkeys(("average_precision_verified", "recall_at_full_precision_verified"), math.nan)
        for method, alpha, beta, gamma in settings()
        if method in methods
    ]


def _fused_scores(fused: FusedRecogniser, pairs: Pairs, views: list[Keyframe]) -> Array:
    return np.array([fused.score(views[i], views[j]) for i, j in zip(pairs.first, pairs.second, strict=True)])


def fused_with_memory(config: EnvConfig, walks: list[Walk]) -> FusedRecogniser:
    """The fused recogniser after observing all keyframes in order of time."""
    recogniser = FusedRecogniser(config.slam.place_recognition, config.lidar.range_max_m)
    for keyframe in sorted((k for w in walks for k in w.keyframes), key=lambda k: (k.time_s, k.robot)):
        recogniser.memory.observe(keyframe)
    return recogniser


def settings() -> list[tuple[str, float, float, float]]:
    """(method, alpha, beta, gamma) of every row; NaN if a method has no such threshold."""
    nothing = math.nan
    return [
        *(("text", alpha, nothing, nothing) for alpha in TEXT),
        *(("wifi", nothing, both, both) for both in WIFI),
        *(("twc", alpha, both, both) for alpha, both in COMBINED),
        ("lidar", nothing, nothing, nothing),
        ("fused", nothing, nothing, nothing),
    ]


def _accept(method, alpha, beta, gamma, scores, cues, config: EnvConfig) -> Array:
    """(pairs,) bool: pairs that a method accepts at these thresholds."""
    rule = config.slam.place_recognition
    if method in ("lidar", "fused"):
        return scores[method] >= (rule.scan_similarity_min if method == "lidar" else rule.log_odds_min)
    _, macs, rssi = cues
    accepted = np.ones(len(macs), bool)
    if not math.isnan(alpha):
        accepted &= scores["text"] >= alpha - 1e-9
    if not math.isnan(beta):
        accepted &= (macs >= beta - 1e-9) & (rssi >= gamma - 1e-9)
    return accepted


def _pass_pairs(sign_passes: list[tuple[int, SignPass]]) -> Pairs:
    """Pairs of passes of different robots, except those of the same sign from more than SAME_PLACE_M apart."""
    entries = []
    for (i, (a, first)), (j, (b, second)) in itertools.combinations(enumerate(sign_passes), 2):
        if a == b:
            continue
        is_sign = first.sign == second.sign
        is_near = math.dist(first.position_m, second.position_m) <= SAME_PLACE_M
        if is_near or not is_sign:
            entries.append((i, j, a, b, is_sign and is_near))
    table = np.array(entries, int).reshape(-1, 5)
    return Pairs(table[:, 0], table[:, 1], table[:, 2:4], table[:, 4].astype(bool))


def _wifi_at_places(config: EnvConfig, walks: list[Walk], beta: float, gamma: float) -> Counts:
    """Counts of WiFi alone between places every PLACE_STEP_M of each walk; correct within SAME_PLACE_M."""
    places = [(robot, view, pose) for robot, w in enumerate(walks) for view, pose in _every(w)]
    accepted, same = [], []
    for (a, first, here), (b, second, there) in itertools.combinations(places, 2):
        if a != b:
            cues = similarities(first, second, config.slam.place_recognition)
            accepted.append(cues.macs >= beta - 1e-9 and cues.rssi >= gamma - 1e-9)
            same.append(math.dist(here[:2], there[:2]) <= SAME_PLACE_M)
    hits, is_same = np.array(accepted), np.array(same)
    return Counts(int(hits.sum()), int((hits & is_same).sum()), int(is_same.sum()))


def _every(w: Walk) -> list[tuple[Keyframe, Array]]:
    chosen, last = [], -math.inf
    for view, pose in zip(w.keyframes, w.poses, strict=True):
        if view.travel_m - last >= PLACE_STEP_M:
            chosen.append((replace(view, signs=()), pose))
            last = view.travel_m
    return chosen


class _Verified:
    """Scan matching of pairs, with the initial guess from the shared sign or with none."""

    def __init__(self, config: EnvConfig, walks: list[Walk], views: list[Keyframe], fused: FusedRecogniser):
        slam = config.slam
        self._verifier = LoopVerifier(slam.verification, slam.odometry_filter, config.lidar)
        self._paths = [w.keyframes for w in walks]
        self._views, self._fused = views, fused
        self._known: dict[str, dict[int, bool]] = {}

    def accept(self, pairs: Pairs, guess: str, asked: Array) -> Array:
        """(pairs,) bool: the requested pairs that are confirmed with a kind of guess; results are cached per kind."""
        known = self._known.setdefault(guess, {})
        for k in np.flatnonzero(asked).tolist():
            if k not in known:
                known[k] = self._match(self._views[pairs.first[k]], self._views[pairs.second[k]], guess)
        return np.array([bool(asked[k]) and known[k] for k in range(len(pairs))], bool)

    def _match(self, target: Keyframe, source: Keyframe, kind: str) -> bool:
        a, b = target.signs[0], source.signs[0]
        if kind == "none":
            guess, recogniser, sign_m = np.zeros(3), "wifi", None
        else:
            remembered = self._fused.memory.guess((target, a), (source, b)) if kind == "memory" else meet_at_sign(a, b)
            if remembered is None or not np.isfinite(remembered).all():
                return False
            guess, recogniser, sign_m = remembered, "twc", a.position_m
        ends = (target.robot, target.index), (source.robot, source.index)
        candidate = LoopCandidate(*ends, guess, recogniser, sign_m=sign_m)
        closure = self._verifier.verify(candidate, self._paths[target.robot], self._paths[source.robot])
        return closure.status == "accepted"


def _of(counts: Counts | None, what: str) -> dict:
    """Precision and recall under a name; NaN without counts."""
    values = (counts.precision, counts.recall) if counts is not None else (math.nan, math.nan)
    return dict(zip((f"precision_{what}", f"recall_{what}"), values, strict=True))
