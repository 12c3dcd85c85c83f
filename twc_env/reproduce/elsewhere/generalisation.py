"""The claims of README and docs/results.md on sets that no setting was chosen on.

- exploration: generated buildings of the split `fresh` (`trivial`: merge nothing; odometry with known starts)
- exploration: HouseExpo plans by size, but for the five of docs/results.md (`trivial`: as above)
- Intel: four laser logs with Intel's odometry errors, once and twice as large (`resampled_odometry`) (`trivial`:
  odometry)
- pose graphs: two graphs that docs/results.md does not show, half of the closures false (`trivial`: odometry)
- place recognition: walks through generated buildings of the split `fresh` (`trivial`: equal texts)
- radio SLAM: walks through a generated office instead of the twin of SUTD (`trivial`: odometry)
- number of walls: generated flats, and HouseExpo plans with one router (`trivial`: always saying the most frequent
  number)
- joined walks: walks of both malls together; every fourth walk of a floor (`trivial`: all walks at one point)

One row {claim, set, shown, elsewhere, trivial} per claim and set: `shown` is the figure of docs/results.md, `elsewhere`
the same figure on the set; `cases` counts buildings, plans, logs or walks, and `at_most` is the upper end of the 95 %
interval of a share. `better` says whether less or more is better; a row with `holds` false is worse than its trivial
answer. The first `--fresh` buildings are used; docs/results.md says which have been looked at. The learned team and
speed are not part of it: `twc-env evaluate --suite v1` and `twc-env bench --map NAME` measure them elsewhere.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Callable

import numpy as np

from twc_env.config import EnvConfig, RadioSlamConfig, override, robot_configs
from twc_env.datasets.buildings.house_expo import read_house_expo
from twc_env.datasets.surveys.step_heading import WalkerTrace, read_walks
from twc_env.maps import load_map
from twc_env.metrics import absolute_trajectory_error_m
from twc_env.metrics.shares import share_interval
from twc_env.records.random_streams import random_stream
from twc_env.reproduce.logs.real_radio import FLOORS, positions_apart_m
from twc_env.reproduce.logs.resampled_odometry import drive_again, drive_intel
from twc_env.reproduce.pose_graphs.robustness import Case, clean_graph, run_case
from twc_env.reproduce.radio.radio_methods import outcomes
from twc_env.reproduce.radio.radio_twins import PLACES
from twc_env.reproduce.routes import RoutePlanner, walk
from twc_env.reproduce.runner import Runner, add_some, data_folder
from twc_env.reproduce.twc.ambiguity import team_figures
from twc_env.reproduce.twc.sign_pass_scores import score_some
from twc_env.reproduce.walls import sfw_houseexpo, sfw_table1
from twc_env.running.options import count
from twc_env.slam.radio.trace_joining import Trace, join

CHOOSES = ("fresh", "claims")
AGENT = "nearest-frontier"
SHOWN_PLANS = ("5330538c", "0a1b29db", "9fd10955", "aa01d9bc", "f1055744")
"""The HouseExpo plans of docs/results.md."""
SIZES_M2 = ((0.0, 150.0), (150.0, 700.0), (700.0, 1e9))
PLANS_MAX, STEPS = 4, 4000
"""Plans of each size, and the most steps in each."""
LOGS = ("aces", "orebro", "freiburg-101", "intel")
GRAPHS = ("ring", "manhattanOlson3500_vertigo")
SIGN_BUILDINGS, SIGN_WALK_M = tuple(f"fresh/{number:04d}" for number in range(94, 100)), 150.0
"""The buildings in which places are recognised, and the length of each of three robots' walks."""
PACKAGES = ("twc_env.agents",)
OFFICE, OFFICE_SHARE = "gen:office:5000:6000000", 0.5
"""The building of radio walks, and their share of the published length."""
FLATS = range(100, 106)
"""Numbers of the generated flats; 0 to 15 were used to choose settings."""
HOUSE_PLANS = 3
EVERY = 4
"""Of the walks of a sparse floor, this one of so many is kept."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of this table."""
    parser.add_argument("--fresh", type=count, default=30, help="number of generated buildings of the split fresh")
    parser.add_argument("--jobs", type=count, default=2, help="number of worker processes")
    add_some(parser, "--claims", CLAIMS, "claims")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """One row per claim and set."""
    parts = {claim: PARTS[claim](options.fresh) for claim in options.claims}
    labelled = [(claim, part) for claim, own in parts.items() for part in own]
    found = runner.each(labelled, _measured, lambda pair: f"{pair[0]}: {pair[1]}", options.jobs)
    table: list[dict] = []
    for claim, own in parts.items():
        results = [result for (name, _), result in zip(labelled, found, strict=True) if name == claim]
        table += CLAIMS[claim][1](own, results)
    return table


def remarks(table: list[dict]) -> list[str]:
    """The rows that are worse than their trivial answer."""
    worse = [row for row in table if not row["holds"]]
    lines = [f"below the trivial answer: {row['claim']}, {row['set']}" for row in worse]
    return lines or ["no row is worse than its trivial answer"]


def _measured(pair: tuple[str, str]) -> dict:
    claim, part = pair
    return CLAIMS[claim][0](part)


def _row(claim: str, where: str, shown: float | None, elsewhere: float, trivial: float, better: str, cases: int,
         at_most: float | None = None) -> dict:  # fmt: skip
    holds = elsewhere <= trivial if better == "less" else elsewhere >= trivial
    return {
        "claim": claim, "set": where, "shown": shown, "elsewhere": round(float(elsewhere), 4),
        "trivial": round(float(trivial), 4), "better": better, "cases": cases,
        "at_most": None if at_most is None else round(at_most, 4), "holds": bool(holds),
    }  # fmt: skip


# --- exploration


def _team(part: str) -> dict:
    """A team in a generated building, or in a plan of HouseExpo."""
    config = override(EnvConfig(), {"robots": 3, "max_cycles": STEPS})
    if "/" in part:
        return team_figures(override(config, {"map": part}), None, AGENT, int(part[-4:]))
    plan = read_house_expo(next((data_folder() / "houseexpo").glob(f"{part}*.json")))
    return team_figures(config, plan, AGENT, 0) | {"area_m2": plan.floor_area_m2}


def _house_plans(_: int) -> list[str]:
    """The plans that a team fits into, at most PLANS_MAX of each size, as their names order them."""
    chosen: dict[tuple, list[str]] = {size: [] for size in SIZES_M2}
    for path in sorted((data_folder() / "houseexpo").glob("*.json")):
        if path.stem[:8] in (*SHOWN_PLANS, *UNSOUND):
            continue
        area_m2 = read_house_expo(path).floor_area_m2
        size = next(s for s in SIZES_M2 if s[0] <= area_m2 < s[1])
        if len(chosen[size]) < PLANS_MAX:
            chosen[size].append(path.stem[:8])
    return [name for own in chosen.values() for name in own]


UNSOUND = ("003ecdd4", "ac8116b3")
"""A contour that touches itself, and one of 12,249 corners: cases for readers."""


def _exploration_rows(where: str, claim: str, runs: list[dict]) -> list[dict]:
    merged, wrong = (sum(test(run) for run in runs) for test in (_is_merged, lambda run: run["wrong_pairs"] > 0))
    cases = len(runs)
    return [
        _row(f"{claim}: teams in one map", where, 1.0, merged / cases, 0.0, "more", cases,
             share_interval(merged, cases)[1]),
        # merging nothing is never wrong; the interval says what the count excludes
        _row(f"{claim}: teams merged wrongly", where, 0.0, wrong / cases, 0.0, "less", cases,
             share_interval(wrong, cases)[1]),
        _row(f"{claim}: team ATE [m]", where, 0.011 if claim == "exploration" else 0.028,
             float(np.mean([run["ate_m"] for run in runs])), float(np.mean([run["odometry_ate_m"] for run in runs])),
             "less", cases),
    ]  # fmt: skip


def _is_merged(run: dict) -> bool:
    return run["merged"] == run["robots"]


def _fresh_rows(parts: list[str], runs: list[dict]) -> list[dict]:
    return _exploration_rows(f"fresh/0000 to {parts[-1]}", "exploration", runs)


def _house_rows(_: list[str], runs: list[dict]) -> list[dict]:
    table: list[dict] = []
    for low, high in SIZES_M2:
        own = [run for run in runs if low <= run["area_m2"] < high]
        if own:
            name = f"HouseExpo over {low:g} m2" if high > 1e6 else f"HouseExpo {low:g} to {high:g} m2"
            table += _exploration_rows(name, "HouseExpo flats", own)
    return table


# --- recorded logs and graphs


def _log(part: str) -> dict:
    if part == INTEL_ITSELF:
        return drive_intel()
    name, size, seed = part.split()
    return drive_again(name, float(size), int(seed))


def _log_rows(parts: list[str], runs: list[dict]) -> list[dict]:
    (shown,) = (run["ate_m"] for part, run in zip(parts, runs, strict=True) if part == INTEL_ITSELF)
    return [
        _row("Intel: distance to the GMapping log [m]", f"{part.split()[0]} at {part.split()[1]} times Intel's errors",
             round(shown, 4), run["ate_m"], run["odometry_ate_m"], "less", 1)
        for part, run in zip(parts, runs, strict=True)
        if part != INTEL_ITSELF
    ]  # fmt: skip


INTEL_ITSELF = "intel 0 0"


def _graph(part: str) -> dict:
    name, kind, seed = part.split()
    folder = data_folder() / "posegraph"
    start, _, best = clean_graph(folder, name)
    run = run_case(Case(name, kind, 0.5, "ours", int(seed)), folder)
    return run | {"odometry_m": absolute_trajectory_error_m(start, best)}


def _graph_rows(_: list[str], runs: list[dict]) -> list[dict]:
    worst, odometry = max(run["ate_m"] for run in runs), min(run["odometry_m"] for run in runs)
    where = f"{' and '.join(GRAPHS)}, random and grouped"
    return [_row("pose graphs, half of the closures false: worst ATE [m]", where, 0.054, worst, odometry, "less",
                 len(runs))]  # fmt: skip


# --- places


def _places(part: str) -> dict:
    """Recognised passes of signs on three walks between random places, by `fused` and by equal texts."""
    config, plan, seed = EnvConfig(map=part, robots=3), load_map(part), int(part[-4:])
    planner = RoutePlanner(plan)
    walks = [
        walk(own, plan, planner.wander(SIGN_WALK_M, random_stream(seed, "routes", robot)), robot, seed)
        for robot, own in enumerate(robot_configs(config))
    ]
    found = {row["method"].split()[0]: row for row in score_some(config, walks, "", ("text", "fused"))}
    return {
        f"{method}_{key}": found[method][key]
        for method in ("text", "fused")
        for key in ("precision", "recall_at_full_precision")
    }


def _place_rows(parts: list[str], runs: list[dict]) -> list[dict]:
    table = []
    for name, key, shown in (
        ("place recognition: recall at precision 1.00", "recall_at_full_precision", 0.98),
        ("place recognition: precision as it decides", "precision", 1.0),
    ):
        fused, text = (float(np.mean([run[f"{method}_{key}"] for run in runs])) for method in ("fused", "text"))
        table.append(_row(name, f"{parts[0]} to {parts[-1]}", shown, fused, text, "more", len(runs)))
    return table


# --- radio


def _radio(part: str) -> dict:
    place = dataclasses.replace(PLACES["indoor"].shortened(OFFICE_SHARE), twin=OFFICE, storeys=(0,))
    return {name: found.errors() for name, found in outcomes(place, int(part), ("odometry", "wifi")).items()}


def _radio_rows(_: list[str], runs: list[dict]) -> list[dict]:
    ours, odometry = (float(np.mean([run[name]["mean_m"] for run in runs])) for name in ("wifi", "odometry"))
    return [_row("radio SLAM with WiFi indoors: mean error [m]", f"walks through {OFFICE}", 0.30, ours, odometry,
                 "less", len(runs))]  # fmt: skip


def _walls(part: str) -> dict:
    kind, name = part.split()
    if kind == "flat":
        found = sfw_table1.measure_flat(int(name), 1, None)
        return found["ours"]
    path = next((data_folder() / "houseexpo").glob(f"{name}*.json"))
    measured = sfw_houseexpo.measure(path, None)
    return {} if measured is None else next(row for row in measured["rows"] if row["method"] == "ours")


def _wall_parts(_: int) -> list[str]:
    plans = sorted((data_folder() / "houseexpo").glob("*.json"), key=lambda path: path.stat().st_size)
    return [*(f"flat {number}" for number in FLATS), *(f"plan {path.stem[:8]}" for path in plans[:HOUSE_PLANS])]


def _wall_rows(parts: list[str], runs: list[dict]) -> list[dict]:
    table = []
    for kind, where in (("flat", f"flats {FLATS[0]} to {FLATS[-1]}"), ("plan", "HouseExpo plans, one router")):
        own = [run for part, run in zip(parts, runs, strict=True) if part.startswith(kind) and run]
        for name, key, trivial, shown in (
            ("number of walls: accuracy", "k_accuracy", "k_trivial", 0.971),
            ("walls from WiFi: free IoU", "iou_free", "iou_trivial", 0.975),
        ):
            ours, least = (float(np.mean([run[k] for run in own])) for k in (key, trivial))
            table.append(_row(name, where, shown, ours, least, "more", len(own)))
    return table


# --- walks joined by WiFi


def _joined(part: str) -> dict:
    floors, every = part.split()
    walks: list[WalkerTrace] = []
    floor_of: list[int] = []
    for number, floor in enumerate(floors.split("+")):
        found = read_walks(data_folder() / "indoor20" / floor)[:: int(every)]
        walks += found
        floor_of += [number] * len(found)
    joined = join([Trace(walk.reckoned, walk.fingerprints) for walk in walks], RadioSlamConfig())
    errors, spread, mixed = [], [], 0
    for group in range(joined.group.max() + 1):
        members = np.flatnonzero(joined.group == group)
        mixed += len({floor_of[k] for k in members}) > 1
        if len(members) > 1:
            true = [walks[k].surveyed_m for k in members]
            errors.append(positions_apart_m([joined.positions_m[k] for k in members], true))
            centres = [np.mean(np.concatenate(true), axis=0) + walks[k].reckoned[:, :2] - walks[k].reckoned[:, :2].mean(
                axis=0) for k in members]  # fmt: skip
            spread.append(positions_apart_m(centres, true))
    return {
        "walks": len(walks), "groups": int(joined.group.max()) + 1, "mixed": mixed,
        "error_m": float(np.concatenate(errors).mean()), "trivial_m": float(np.concatenate(spread).mean()),
    }  # fmt: skip


def _joined_rows(parts: list[str], runs: list[dict]) -> list[dict]:
    table = []
    for part, run in zip(parts, runs, strict=True):
        floors, every = part.split()
        name = floors if every == "1" else f"every {every}th walk of {floors}"
        where = f"{name}, {run['groups']} groups"
        if "+" in floors:
            table.append(_row("joined walks: groups of walks of two malls", where, None, run["mixed"], 0, "less",
                              run["walks"]))  # fmt: skip
        table.append(_row("joined walks: mean error in their groups [m]", where, None if "+" in floors else 10.0,
                          run["error_m"], run["trivial_m"], "less", run["walks"]))  # fmt: skip
    return table


CLAIMS: dict[str, tuple[Callable[[str], dict], Callable[[list[str], list[dict]], list[dict]]]] = {
    "exploration": (_team, _fresh_rows),
    "houseexpo": (_team, _house_rows),
    "logs": (_log, _log_rows),
    "graphs": (_graph, _graph_rows),
    "places": (_places, _place_rows),
    "radio": (_radio, _radio_rows),
    "walls": (_walls, _wall_rows),
    "joined": (_joined, _joined_rows),
}
"""What measures one part of a claim, and what makes rows of all parts."""
PARTS: dict[str, Callable[[int], list[str]]] = {
    "exploration": lambda fresh: [f"fresh/{number:04d}" for number in range(fresh)],
    "houseexpo": _house_plans,
    "logs": lambda _: [INTEL_ITSELF, *(f"{name} {size} 0" for name in LOGS for size in (1, 2))],
    "graphs": lambda _: [f"{name} {kind} 0" for name in GRAPHS for kind in ("random", "grouped")],
    "places": lambda _: list(SIGN_BUILDINGS),
    "radio": lambda _: ["0", "1"],
    "walls": _wall_parts,
    "joined": lambda _: [f"{'+'.join(FLOORS)} {2 * EVERY}", *(f"{floor} {EVERY}" for floor in FLOORS)],
}
"""The names of a claim's parts."""
