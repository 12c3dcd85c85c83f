"""Place recognition on two real floors: surveyed phone traces as robots, real WiFi, real place names as signs.

A place is where a WiFi scan ended (readings at most 4 s old) and at least one place name was legible along the surveyed
trace; names are misread as in papers.md T3. All methods are evaluated on all pairs of places of two traces; pairs at
most 5 m apart are correct. Parameters that need training (WiFi tolerance, weights) are trained on the other floor;
parameters that adapt on site (how common a name is, how fingerprints of one trace differ with distance) use no
positions of other traces. Each seed draws the misreadings and four fifths of the traces; `sd` is the standard deviation
over seeds.
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray as Array
from scipy.special import expit

from twc_env.reproduce.places.place_cues import Cues
from twc_env.reproduce.places.place_pairs import average_precision
from twc_env.reproduce.places.surveyed_places import Floor, draw_places, read_floor
from twc_env.reproduce.runner import Runner, add_seeds, data_folder

CHOOSES = ("seeds",)

FLOORS = {"B1": "site1_B1", "F6": "site2_F6"}
METHODS = ("text", "wifi", "twc", "fused")
NEWTON_STEPS = 12
TOLERANCES_DB = (3.0, 4.0, 5.0, 7.0, 10.0, 14.0)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the table."""
    add_seeds(parser, "0-9", "random draws")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """One row per floor and method: {floor, trained_on, method, average_precision, sd, seeds}."""
    folder = data_folder() / "indoor20"
    floors = {name: read_floor(folder / part) for name, part in FLOORS.items()}
    draws = runner.each(options.seeds, lambda seed: evaluate_draw(floors, seed), lambda seed: f"draw {seed}")
    table = []
    for floor, trained_on in (("F6", "B1"), ("B1", "F6")):
        for method in METHODS:
            found = [draw[floor][method] for draw in draws]
            table.append(
                {
                    "floor": floor,
                    "trained_on": trained_on,
                    "method": method,
                    "average_precision": round(float(np.mean(found)), 4),
                    "sd": round(float(np.std(found)), 4),
                    "seeds": len(draws),
                }
            )
    return table


def remarks(table: list[dict]) -> list[str]:
    """Margin of `fused` over the best other method on each floor, compared with the spread over draws."""
    lines = []
    for floor in dict.fromkeys(row["floor"] for row in table):
        rows_of = {row["method"]: row for row in table if row["floor"] == floor}
        fused = rows_of.pop("fused")
        best = max(rows_of.values(), key=lambda row: row["average_precision"])
        margin, spread = fused["average_precision"] - best["average_precision"], max(fused["sd"], best["sd"])
        comparison = "more" if margin > spread else "not more"
        lines.append(
            f"{floor}: fused is {margin:+.3f} in average precision against {best['method']}, the best other; "
            f"{comparison} than the larger spread of the two, {spread:.3f}"
        )
    return lines


def evaluate_draw(floors: dict[str, Floor], seed: int) -> dict[str, dict[str, float]]:
    """Each floor with parameters learned on the other: floor -> method -> average precision."""
    cues = {name: Cues(draw_places(floor, seed)) for name, floor in floors.items()}
    learned = {name: learn(c) for name, c in cues.items()}
    result = {}
    for name, c in cues.items():
        (other,) = set(cues) - {name}
        result[name] = {m: average_precision(score, c.is_same) for m, score in scores(c, learned[other]).items()}
    return result


def scores(cues: Cues, learned: dict[str, dict]) -> dict[str, Array]:
    """Method -> (pairs,) score; for rules with several thresholds the smallest similarity."""
    fused = _standard(cues.features, learned["fused"]) @ learned["fused"]["weights"]
    return {
        "text": cues.text,
        "wifi": _wifi(cues, learned["wifi"]["tolerance_db"]),
        "twc": np.minimum(cues.text, _wifi(cues, learned["twc"]["tolerance_db"])),
        "fused": fused,
    }


def learn(cues: Cues) -> dict[str, dict]:
    """Parameters of each method, learned on one floor."""
    wifi = {t: average_precision(_wifi(cues, t), cues.is_same) for t in TOLERANCES_DB}
    both = {t: average_precision(np.minimum(cues.text, _wifi(cues, t)), cues.is_same) for t in TOLERANCES_DB}
    learned: dict[str, dict] = {
        "text": {},
        "wifi": {"tolerance_db": max(wifi, key=wifi.__getitem__)},
        "twc": {"tolerance_db": max(both, key=both.__getitem__)},
        "fused": {"mean": cues.features.mean(axis=0), "std": cues.features.std(axis=0)},
    }
    learned["fused"]["weights"] = logistic(_standard(cues.features, learned["fused"]), cues.is_same)
    return learned


def _wifi(cues: Cues, tolerance_db: float) -> Array:
    return np.minimum(cues.macs, np.minimum(1.0, tolerance_db / np.maximum(cues.rms_db, 1e-9)))


def _standard(features: Array, learned: dict) -> Array:
    """Features standardised with the training floor, and a constant."""
    return np.column_stack([(features - learned["mean"]) / learned["std"], np.ones(len(features))])


def logistic(features: Array, is_same: Array) -> Array:
    """(features,) weights of a logistic regression with weak ridge regularisation, by Newton's method."""
    weights = np.zeros(features.shape[1])
    for _ in range(NEWTON_STEPS):
        share = expit(features @ weights)
        gradient = features.T @ (is_same - share) - weights
        curvature = (features * (share * (1 - share))[:, None]).T @ features + np.eye(len(weights))
        weights = weights + np.linalg.solve(curvature, gradient)
    return weights
