"""Table I of TWC-SLAM: precision and recall of place recognition on twins of its two scenes.

Robots walk scripted routes through all rooms; each pass by a sign is a sighting. All methods judge the same pairs of
sightings of different robots, and the same pairs are right: one physical sign, sensors at most 3 m apart (SPEC T11;
pairs of one sign from further apart count neither way). `recall_absolute` is of all right pairs; `recall_conditional`
is of those the text threshold alone lets through, which is how the print's combined recall can exceed that of text.
`precision_best_match` counts one match per sighting and other robot, `precision_places` is of WiFi alone at places
along the way as the paper sampled it, `precision_verified` of what scan matching then confirms.
All constants were fixed on scene #01 and drawn buildings. Some episodes of scene #02 were looked at while `fused` was
being designed, so its figures there are not those of a scene never seen.
"""

from __future__ import annotations

import argparse
import itertools
import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from twc_env.config import EnvConfig, override
from twc_env.geometry import compose
from twc_env.maps import load_map
from twc_env.messages import Keyframe, LoopCandidate
from twc_env.random_streams import random_stream
from twc_env.reproduce.place_pairs import Counts, Pairs, all_pairs, average_precision, best_match
from twc_env.reproduce.place_pairs import recall_at_full_precision as full_recall
from twc_env.reproduce.routes import RoutePlanner, Sighting, Walk, room_tour, walk
from twc_env.reproduce.runner import Runner, parse_seeds
from twc_env.slam.loop_verification import LoopVerifier
from twc_env.slam.place_recognition import FusedRecogniser, ScanRecogniser, similarities

Array = NDArray

SUMMARY = "TWC-SLAM Table I: precision and recall of text, WiFi, both, laser and all cues fused"

SCENES: dict[str, tuple[str, tuple[tuple[int, ...], ...]]] = {
    "#01": ("twin-01", ((0, 1, 2, 3), (3, 2, 1, 0))),
    "#02": ("twin-02", ((0, 2, 1, 4), (4, 6, 7, 5), (2, 3, 5, 4))),
}
"""Map, and the rooms that each robot visits in order."""
TEXT, WIFI = (0.5, 0.8, 1.0), (0.5, 0.8, 1.0)
COMBINED = ((0.5, 0.8), (0.8, 0.8), (0.5, 1.0))
PRINT = {
    "#01": {"text": ((35, 89), (52, 78), (78, 31)), "wifi": ((45, 86), (62, 72), (68, 70)),
            "twc": ((65, 92), (95, 90), (96, 65))},
    "#02": {"text": ((41, 75), (61, 76), (88, 45)), "wifi": ((51, 81), (70, 76), (87, 40)),
            "twc": ((54, 89), (82, 93), (84, 68))},
}  # fmt: skip
"""Precision and recall as printed [%]."""
SAME_PLACE_M = 3.0
PLACE_STEP_M = 6.0
"""Where WiFi alone is sampled along the way (SPEC T10)."""
STOP_SPREAD_M = 0.25
"""How far a robot's stops differ from one seed to the next."""
VERIFIED_METHODS = ("text", "twc", "fused")
"""Methods whose candidates come with a guess of the pose between the robots."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the table."""
    parser.add_argument("--seeds", type=parse_seeds, default=list(range(20)), help="walks (default: 0-19)")
    parser.add_argument("--scenes", nargs="+", choices=tuple(SCENES), default=list(SCENES), help="default: both")
    parser.add_argument(
        "--std-mode", choices=("population", "sample", "paper"), default="population",
        help="spread that clips scans, Eq. 7; paper: as printed, which rejects nothing (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--rssi-mode", choices=("saturating", "paper"), default="saturating",
        help="likeness of strengths, Eq. 10; paper: accept distances of at least gamma (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument("--tolerance-db", type=float, default=5.0, help="tau of SPEC T8 (default: %(default)s)")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """One row per scene, method and thresholds, as means over the seeds."""
    parts = list(itertools.product(options.scenes, options.seeds))
    results = runner.each(
        parts, lambda part: judge_scene(part[0], part[1], options), lambda part: f"{part[0]} seed {part[1]}"
    )
    table = []
    for scene in options.scenes:
        runs = [result for (name, _), result in zip(parts, results, strict=True) if name == scene]
        table += [_summary(scene, [run[k] for run in runs]) for k in range(len(runs[0]))]
    return table


def judge_scene(scene: str, seed: int, options: argparse.Namespace) -> list[dict]:
    """One figure per method and thresholds for one walk of all robots."""
    map_name, orders = SCENES[scene]
    config = override(
        EnvConfig(map=map_name, robots=len(orders)),
        {
            "slam.keyframe.std_mode": options.std_mode,
            "slam.place_recognition.rssi_mode": options.rssi_mode,
            "slam.place_recognition.rssi_tolerance_db": options.tolerance_db,
        },
    )
    walks = walk_scene(config, orders, seed)
    return judge(config, walks)


def walk_scene(config: EnvConfig, orders: tuple[tuple[int, ...], ...], seed: int) -> list[Walk]:
    """All robots' walks: through their rooms and back to the start, the corridor being the plan's last room."""
    plan = load_map(config.map)
    planner = RoutePlanner(plan)
    random = random_stream(seed, "routes")
    corridor = plan.rooms[-1].polygon_m
    middle_y = corridor[:, 1].mean()
    ends = corridor[:, 0].min() + 1.0, corridor[:, 0].max() - 1.0, corridor[:, 0].mean()
    walks = []
    for robot, order in enumerate(orders):
        start = np.array([ends[robot % 3], middle_y])
        stops = [stop for n, k in enumerate(order) for stop in room_tour(plan.rooms[k], (n + robot) % 2 == 1)]
        jittered = [stop + random.normal(0.0, STOP_SPREAD_M, 2) for stop in stops]
        walks.append(walk(config, plan, planner.route([start, *jittered, start]), robot, seed))
    return walks


# --- the pairs and what each method says of them ---


def judge(config: EnvConfig, walks: list[Walk]) -> list[dict]:
    """All methods on all pairs of sightings of these walks."""
    sightings = [(robot, sighting) for robot, w in enumerate(walks) for sighting in w.sightings]
    pairs = _sighting_pairs(sightings)
    views = [sighting.keyframe for _, sighting in sightings]
    rule = config.slam.place_recognition
    cues = [similarities(views[i], views[j], rule) for i, j in zip(pairs.first, pairs.second, strict=True)]
    text, macs, rssi = np.array([(c.text, c.macs, c.rssi) for c in cues]).reshape(-1, 3).T
    scores = {"text": text, "wifi": np.minimum(macs, rssi), "twc": np.minimum(text, np.minimum(macs, rssi))}
    scans = ScanRecogniser(rule, config.lidar.range_max_m)
    scores["lidar"] = np.array(
        [scans.score(views[i], views[j]) for i, j in zip(pairs.first, pairs.second, strict=True)]
    )
    fused = fused_with_memory(config, walks)
    scores["fused"] = np.array(
        [fused.score(views[i], views[j]) for i, j in zip(pairs.first, pairs.second, strict=True)]
    )
    verified = _Verified(config, walks, views, fused)
    figures = []
    for method, alpha, beta, gamma in _settings():
        accepted = _accept(method, alpha, beta, gamma, scores, macs, rssi, config)
        conditional = pairs.is_same & (text >= alpha - 1e-9) if method == "twc" else pairs.is_same
        counts, best = all_pairs(accepted, pairs), best_match(accepted, scores[method], pairs)
        figure = {
            "method": method, "alpha": alpha, "beta": beta, "gamma": gamma,
            "precision": counts.precision, "recall_absolute": counts.recall,
            "recall_conditional": counts.right / max(int(conditional.sum()), 1),
            "average_precision": average_precision(scores[method], pairs.is_same),
            "recall_at_full_precision": full_recall(scores[method], pairs.is_same),
            "precision_best_match": best.precision, "recall_best_match": best.recall,
        }  # fmt: skip
        places = _wifi_at_places(config, walks, beta, gamma) if method == "wifi" else None
        figure |= _of(places, "places")
        is_confirmed = verified.accept(accepted, pairs, method) if method in VERIFIED_METHODS else None
        figure |= _of(all_pairs(is_confirmed, pairs) if is_confirmed is not None else None, "verified")
        figures.append(figure)
    return figures


def fused_with_memory(config: EnvConfig, walks: list[Walk]) -> FusedRecogniser:
    """The fused recogniser after it has seen all keyframes in the order of time."""
    recogniser = FusedRecogniser(config.slam.place_recognition, config.lidar.range_max_m)
    for keyframe in sorted((k for w in walks for k in w.keyframes), key=lambda k: (k.time_s, k.robot)):
        recogniser.memory.observe(keyframe)
    return recogniser


def _settings() -> list[tuple[str, float, float, float]]:
    nothing = math.nan
    return [
        *(("text", alpha, nothing, nothing) for alpha in TEXT),
        *(("wifi", nothing, both, both) for both in WIFI),
        *(("twc", alpha, both, both) for alpha, both in COMBINED),
        ("lidar", nothing, nothing, nothing),
        ("fused", nothing, nothing, nothing),
    ]


def _accept(method, alpha, beta, gamma, scores, macs, rssi, config: EnvConfig) -> Array:
    """(pairs,) bool: what a method takes for one place at these thresholds."""
    rule = config.slam.place_recognition
    if method in ("lidar", "fused"):
        return scores[method] >= (rule.scan_similarity_min if method == "lidar" else rule.log_odds_min)
    accepted = np.ones(len(macs), bool)
    if not math.isnan(alpha):
        accepted &= scores["text"] >= alpha - 1e-9
    if not math.isnan(beta):
        accepted &= (macs >= beta - 1e-9) & (rssi >= gamma - 1e-9)
    return accepted


def _sighting_pairs(sightings: list[tuple[int, Sighting]]) -> Pairs:
    """Pairs of different robots without those of one sign from further apart than a place reaches."""
    entries = []
    for (i, (a, first)), (j, (b, second)) in itertools.combinations(enumerate(sightings), 2):
        if a == b:
            continue
        is_sign = first.sign == second.sign
        is_near = math.dist(first.position_m, second.position_m) <= SAME_PLACE_M
        if is_near or not is_sign:
            entries.append((i, j, a, b, is_sign and is_near))
    table = np.array(entries, int).reshape(-1, 5)
    return Pairs(table[:, 0], table[:, 1], table[:, 2:4], table[:, 4].astype(bool))


def _wifi_at_places(config: EnvConfig, walks: list[Walk], beta: float, gamma: float) -> Counts:
    """WiFi alone between places every few metres of each walk; right when at most 3 m apart."""
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
    """Which pairs scan matching confirms, from the pose that the shared sign implies; each pair is matched once."""

    def __init__(self, config: EnvConfig, walks: list[Walk], views: list[Keyframe], fused: FusedRecogniser):
        slam = config.slam
        self._verifier = LoopVerifier(slam.verification, slam.odometry_filter, config.lidar.range_max_m)
        self._paths = [w.keyframes for w in walks]
        self._views, self._fused = views, fused
        self._known: dict[tuple[int, int, bool], bool] = {}

    def accept(self, accepted: Array, pairs: Pairs, method: str) -> Array:
        """(pairs,) bool: those of the accepted pairs that are confirmed."""
        confirmed = np.zeros(len(pairs), bool)
        for k in np.flatnonzero(accepted):
            confirmed[k] = self._is_confirmed(int(pairs.first[k]), int(pairs.second[k]), method == "fused")
        return confirmed

    def _is_confirmed(self, i: int, j: int, by_memory: bool) -> bool:
        key = (i, j, by_memory)
        if key not in self._known:
            self._known[key] = self._match(self._views[i], self._views[j], by_memory)
        return self._known[key]

    def _match(self, target: Keyframe, source: Keyframe, by_memory: bool) -> bool:
        a, b = target.signs[0], source.signs[0]
        if by_memory:
            guess = self._fused.memory.guess(target, a, source, b)
        else:
            at_sign = np.array([*b.position_m, b.facing_rad])
            back = compose([0.0, 0.0, -at_sign[2]], [-at_sign[0], -at_sign[1], 0.0])
            guess = compose(np.array([*a.position_m, a.facing_rad]), back)
        if guess is None or not np.isfinite(guess).all():
            return False
        ends = (target.robot, target.index), (source.robot, source.index)
        candidate = LoopCandidate(*ends, guess, "twc", sign_m=a.position_m)
        closure = self._verifier.verify(candidate, self._paths[target.robot], self._paths[source.robot])
        return closure.status == "accepted"


def _of(counts: Counts | None, what: str) -> dict:
    """Precision and recall under a name, nothing where it was not measured."""
    values = (counts.precision, counts.recall) if counts is not None else (math.nan, math.nan)
    return dict(zip((f"precision_{what}", f"recall_{what}"), values, strict=True))


# --- the rows ---


def _summary(scene: str, figures: list[dict]) -> dict:
    """Means over the seeds [%] beside the print."""
    first = figures[0]
    shares = [key for key in first if key not in ("method", "alpha", "beta", "gamma")]
    values = {key: np.array([figure[key] for figure in figures], float) for key in shares}
    row = {"scene": scene} | {key: first[key] for key in ("method", "alpha", "beta", "gamma")}
    row |= {key: _percent(values[key], np.mean) for key in shares}
    row["paper_precision"], row["paper_recall"] = _printed(scene, first)
    row |= {"seeds": len(figures), "sd": _percent(values["precision"], np.std)}
    row["sd_recall"] = _percent(values["recall_absolute"], np.std)
    return row


def _percent(values: Array, statistic) -> float:
    known = values[np.isfinite(values)]
    return round(100 * float(statistic(known)), 2) if len(known) else math.nan


def _printed(scene: str, figure: dict) -> tuple[float, float]:
    cells = PRINT[scene].get(figure["method"])
    if cells is None:
        return math.nan, math.nan
    alpha, gamma = figure["alpha"], figure["gamma"]
    if figure["method"] == "twc":
        return cells[COMBINED.index((alpha, gamma))]
    return cells[TEXT.index(alpha) if figure["method"] == "text" else WIFI.index(gamma)]


def remarks(table: list[dict]) -> list[str]:
    """How far the table is from the print, and why it cannot be nearer."""
    lines = []
    gaps: dict[str, list[tuple[float, float]]] = {}
    for row in table:
        if row["paper_precision"] is not None and row["precision"] is not None:
            recall = row["recall_conditional" if row["method"] == "twc" else "recall_absolute"]
            gap = abs(row["precision"] - row["paper_precision"]), abs(recall - row["paper_recall"])
            gaps.setdefault(row["method"], []).append(gap)
    for method, values in gaps.items():
        precision, recall = np.mean(values, axis=0)
        lines.append(
            f"{method} against the print: mean absolute error {(precision + recall) / 2:.1f} points "
            f"(precision {precision:.1f}, {'conditional ' if method == 'twc' else ''}recall {recall:.1f})"
        )
    if "twc" in gaps:
        lines += [
            "Why twc is off: names on these walls differ wherever one radio signature reaches, so text and WiFi "
            "together accept next to nothing wrong.",
            "The print accepts up to 46 % wrong, which takes like labels (A301, A302) within one signature. At 100 % "
            "precision that alone is an error of 10.3 points over both scenes.",
            "Why text is off: four alike rooms with one repeated sign each give three wrong pairs of exact texts for "
            "every right one, so precision at alpha 1.0 cannot reach the printed 78 and 88 %.",
        ]
    return lines
