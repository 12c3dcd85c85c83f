"""Table I of TWC-SLAM: precision and recall of place recognition on twins of its two scenes.

Robots walk scripted routes through all rooms; each pass by a sign counts once. All methods are evaluated on the same
pairs of passes of different robots. A pair is correct if it is the same physical sign and the sensors are at most 3
m apart (papers.md T11; pairs of the same sign from further apart count neither way). `recall_absolute` is over all
correct pairs; `recall_conditional` over those that pass the text threshold alone, which explains how the published
recall of the combination can exceed that of text. `precision_best_match` counts one match per pass and other robot;
`precision_places` is WiFi alone at places along the way, as sampled in the paper. `_verified` columns are after scan
matching of the pairs that pass a loose setting of the method: text, twc and fused provide the pose implied by the
shared sign, WiFi and laser none.

With `--json` the precision-recall curves of all methods, before and after verification, are written beside it, and the
paper's figures 4 to 6 as by `twc-table2`. Methods named like `twc departments` walk past signs as implied by the paper
(`twc_scenes`). `--alternatives` adds rows of twc and WiFi for the other interpretations of Eq. 10 and for Eq. 7 as
printed (methods named like `twc cosine`), and for Eq. 9 with a share above beta, as in the paper's text (`strict`:
nothing passes beta = 1). All constants were fixed on scene #01 and generated buildings. Some episodes of scene #02 were
inspected during the design of `fused`, so for `fused` that scene is not unseen.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from twc_env.config import EnvConfig, override
from twc_env.reproduce.routes import Walk
from twc_env.reproduce.runner import Runner, add_seeds, add_some
from twc_env.reproduce.twc.published import PRINT, over_known
from twc_env.reproduce.twc.sign_pass_scores import COMBINED, METHODS, RECALL_LEVELS, TEXT, WIFI, score_all, score_some
from twc_env.reproduce.twc.twc_scenes import AS_DRAWN, DEPARTMENTS, SCENES, scene_config, walk_scene
from twc_env.reproduce.twc.twin_signs import twin_signs
from twc_env.running.options import picture_options
from twc_env.slam.places.rssi_similarity import BY_DISTANCE, COSINES

RSSI_MODES = (*BY_DISTANCE, *COSINES, "paper")
CHOOSES = ("seeds", "scenes")

EQ7_AS_PRINTED, AS_PRINTED, STRICT = "eq7", "as printed", "strict"
"""Eq. 7 as printed (without division), alone and with Eq. 10 as a distance; share of transmitters above beta."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the table."""
    add_seeds(parser, "0-19", "seeds of the walks")
    add_some(parser, "--scenes", SCENES, "scenes")
    parser.add_argument(
        "--alternatives", action="store_true", help="add rows for the other interpretations of Eq. 7 and 10"
    )


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """One row per scene, method and thresholds, as means over the seeds; two signs of one text below (Fig. 3)."""
    found = _evaluated(options, runner)
    runner.notes += [f"Fig. 3, {scene}: {line}" for scene, walks in found.items() for line in walks[0]["twin_signs"]]
    return [
        _summary(scene, figures)
        for scene, walks in found.items()
        for figures in zip(*(evaluated["figures"] for evaluated in walks), strict=True)
    ]


def _evaluated(options: argparse.Namespace, runner: Runner) -> dict[str, list[dict]]:
    return runner.grid(
        options.scenes, options.seeds, lambda scene, seed: evaluate_scene(scene, seed, options.alternatives)
    )


def evaluate_scene(scene: str, seed: int, has_alternatives: bool = False) -> dict:
    """Figures per method and thresholds for one walk of all robots, and each method's precision-recall curves."""
    config = scene_config(scene)
    walks = walk_scene(config, scene, AS_DRAWN, seed)
    evaluated = score_all(config, walks) | {"twin_signs": twin_signs(config, walks)}
    like_print = walk_scene(config, scene, DEPARTMENTS, seed)
    evaluated["figures"] += score_some(config, like_print, DEPARTMENTS, ("text", "wifi", "twc", "fused"))
    if has_alternatives:
        evaluated["figures"] += _alternatives(scene, config, walks, seed)
    return evaluated


def _alternatives(scene: str, config: EnvConfig, walks: list[Walk], seed: int) -> list[dict]:
    """Figures of WiFi and twc for every other interpretation of Eq. 10, and for Eq. 7 as printed."""
    literal = override(config, {"slam.keyframe.std_mode": "paper"})
    literal_walks = walk_scene(literal, scene, AS_DRAWN, seed)
    figures = []
    for mode in RSSI_MODES:
        if mode != config.slam.place_recognition.rssi_mode:
            changed = override(config, {"slam.place_recognition.rssi_mode": mode})
            figures += score_some(changed, walks, mode)
    both = override(literal, {"slam.place_recognition.rssi_mode": "paper"})
    return [
        *figures,
        *score_some(literal, literal_walks, EQ7_AS_PRINTED),
        *score_some(both, literal_walks, AS_PRINTED),
        *score_some(config, walks, STRICT, is_strict=True),
    ]


# --- the rows ---


def _summary(scene: str, figures: Sequence[dict]) -> dict:
    """Means over the seeds [%], and the published values."""
    first = figures[0]
    shares = [key for key in first if key not in ("method", "alpha", "beta", "gamma")]
    values = {key: 100 * np.array([figure[key] for figure in figures], float) for key in shares}
    row = {"scene": scene} | {key: first[key] for key in ("method", "alpha", "beta", "gamma")}
    row |= {key: over_known(values[key], np.mean, 2) for key in shares}
    row["paper_precision"], row["paper_recall"] = _printed(scene, first)
    row |= {"seeds": len(figures), "sd": over_known(values["precision"], np.std, 2)}
    row["sd_recall"] = over_known(values["recall_absolute"], np.std, 2)
    return row


def _printed(scene: str, figure: dict) -> tuple[float, float]:
    method = figure["method"].split(" ")[0]
    cells = PRINT[scene].get(method)
    if cells is None:
        return math.nan, math.nan
    alpha, gamma = figure["alpha"], figure["gamma"]
    if method == "twc":
        return cells[COMBINED.index((alpha, gamma))]
    return cells[TEXT.index(alpha) if method == "text" else WIFI.index(gamma)]


READINGS = {
    "all pairs": ("precision", "recall_absolute"),
    "all pairs, recall of what text lets through": ("precision", "recall_conditional"),
    "best match": ("precision_best_match", "recall_best_match"),
    "after scan matching": ("precision_verified", "recall_verified"),
    "WiFi at places along the way": ("precision_places", "recall_places"),
}
"""Ways of counting, as columns of precision and recall; the paper does not state which it uses (papers.md T10-T11)."""


def remarks(table: list[dict]) -> list[str]:
    """Deviation from the published table with each way of counting, and reasons."""
    lines = []
    likened = ("text", "wifi", "twc")
    for method in (*likened, *(f"{name} {DEPARTMENTS}" for name in likened)):
        for reading in READINGS:
            gap = _gap(table, method, reading)
            if gap is not None and ("twc" in method or "text" not in reading):
                scenes = [(row, _gap(table, method, reading, row)) for row in PRINT]
                lines.append(
                    f"{method} against the paper, {reading}: mean absolute error {np.mean(gap):.1f} points "
                    f"(precision {gap[0]:.1f}, recall {gap[1]:.1f}; "
                    f"{', '.join(f'{scene} {np.mean(own):.1f}' for scene, own in scenes if own is not None)})"
                )
    contradictory = (
        "pairs that text and WiFi both accept are a subset of those of either, so the published columns leave twc "
        f"{contradiction():.1f} points less recall than published: they differ by {contradiction() / 2:.1f} points"
    )
    return [*lines, *_best_reading(table), contradictory]


def contradiction() -> float:
    """Mean excess [points] of the published recalls of twc over the bound given by those of text and WiFi."""
    beyond = []
    for cells in PRINT.values():
        for (alpha, both), (_, recall) in zip(COMBINED, cells["twc"], strict=True):
            bound = min(cells["text"][TEXT.index(alpha)][1], cells["wifi"][WIFI.index(both)][1])
            beyond.append(max(recall - bound, 0))
    return float(np.mean(beyond))


def _gap(table: list[dict], method: str, reading: str, scene: str | None = None) -> tuple[float, float] | None:
    """Mean deviation from the published precision and recall with a way of counting; None if a cell is missing."""
    columns = READINGS[reading]
    mine = [row for row in table if row["method"] == method and scene in (None, row["scene"])]
    if not mine or any(row[column] is None for row in mine for column in columns):
        return None
    precision, recall = (
        float(np.mean([abs(row[column] - row[printed]) for row in mine]))
        for column, printed in zip(columns, ("paper_precision", "paper_recall"), strict=True)
    )
    return precision, recall


def _best_reading(table: list[dict]) -> list[str]:
    """With --alternatives: the interpretation closest to the paper on #01, and its deviation on #02."""
    found = {row["method"] for row in table if row["method"].split(" ")[0] == "twc"}
    methods = sorted(found - {f"twc {DEPARTMENTS}"})
    gaps = {
        (method, reading): float(np.mean(gap))
        for method in methods
        for reading in READINGS
        if (gap := _gap(table, method, reading, "#01")) is not None
    }
    if len(methods) < 2 or not gaps:
        return []
    method, reading = min(gaps, key=lambda key: (gaps[key], key))
    other = _gap(table, method, reading, "#02")
    told = f"; the same on #02: {np.mean(other):.1f}" if other is not None else ""
    nearest = f"{method!r}, {reading}, is closest to the paper on #01: {gaps[method, reading]:.1f} points"
    return [f"Of {len(gaps)} readings {nearest}{told}"]


def draw(options: argparse.Namespace, runner: Runner, folder: Path) -> list[Path]:
    """Write the precision-recall curves of all methods before and after verification, as JSON and picture.

    Also the paper's figures 4 to 6 for the first walk of each scene, with the settings of Table II.
    """
    from twc_env.reproduce.twc.twc_pictures import draw_curves
    from twc_env.reproduce.twc.twc_table2 import draw_figures

    curves = {
        scene: {
            method: {
                when: np.mean([evaluated["curves"][method][when] for evaluated in walks], axis=0).tolist()
                for when in ("before", "after")
            }
            for method in METHODS
        }
        for scene, walks in _evaluated(options, runner).items()
    }
    path = folder / "twc-table1-curves.json"
    path.write_text(json.dumps({"recall": RECALL_LEVELS.tolist(), "precision": curves}, indent=2) + "\n")
    figures = draw_figures(options.scenes, AS_DRAWN, options.seeds[0], runner, folder, picture_options(options))
    return [path, draw_curves(RECALL_LEVELS, curves, folder, picture_options(options)), *figures]
