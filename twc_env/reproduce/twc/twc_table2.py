"""Table II of TWC-SLAM: map errors in its two scenes, by place recogniser and back end.

The walks of Table I are mapped by every recogniser with every back end of `offline_mapping`; `fused` also by the engine
itself, keyframe by keyframe as in an episode (back end `live`), on the same routes also with the paper's own robots
(`live, mixed team`: handheld, wheeled, legged, each with a Mid-360); and the paper's four methods also as published
(back end `literal`): point-to-point ICP from the recogniser's guess, with every match accepted. The recognisers have
the paper's settings: text at alpha 1.0, WiFi at beta = gamma = 1.0, twc at 0.8, lidar and fused at their defaults.
`odometry` closes no loops: its rows show the front end alone, each robot in its own frame.

`epe_m` is the paper's metric: the error of the end of each path relative to its start, averaged over robots. It is
insensitive to maps folded in between. `ate_m` (all keyframes, each group of robots aligned once) and `wall_thickness_m`
are not; the latter is measured in the largest group's point cloud in cells of 0.1 m, where ghost walls remain (in an
occupancy grid a folded map erases its own walls, and the rest look thin). `closure_precision` refers to the closures
accepted by the back end; `merged` is the share of walks whose robots all end in one map. Nothing was fitted to scene
#02. `--signs departments` uses signs as implied by the paper's Table I (`twc_scenes`).

Rows of text with back ends like `literal 0.98` use all correct closures of `literal`, and as many of the false ones as
give that precision: the first in a random order, so rows with fewer use a subset of them.
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from twc_env import metrics
from twc_env.config import EnvConfig, override, shared_config
from twc_env.maps import load_map
from twc_env.records.random_streams import random_stream
from twc_env.reproduce.drawing import Kind
from twc_env.reproduce.routes import Walk
from twc_env.reproduce.runner import Runner, add_seeds, add_some
from twc_env.reproduce.twc.offline_mapping import (
    BACKENDS,
    Matched,
    OfflineMap,
    build,
    candidates,
    in_time,
    match,
    point_cloud,
    wall_thickness_m,
)
from twc_env.reproduce.twc.published import PRINT as PRINT_TABLE1
from twc_env.reproduce.twc.published import over_known
from twc_env.reproduce.twc.twc_scenes import SCENES, SIGNS, mixed_config, scene_config, walk_scene
from twc_env.running.options import picture_options
from twc_env.slam.team import TeamMapper

CHOOSES = ("seeds", "scenes")

METHODS: dict[str, dict[str, object]] = {
    "lidar": {},
    "text": {"text_similarity_min": 1.0},
    "wifi": {"mac_similarity_min": 1.0, "rssi_similarity_min": 1.0},
    "twc": {},
    "fused": {},
    "odometry": {},
}
"""Settings of place recognition; the name is that of the recogniser."""
LIVE, LITERAL = "live", "literal"
LIVE_MIXED = "live, mixed team"
SHARES_RIGHT = (1.0, 0.99, 0.98, 0.95, 0.9, 0.78)
"""Shares of correct closures of text; the last is the published precision of Table I on #01."""
LIDAR = EnvConfig().lidar
PRINT = {
    "#01": {"lidar": 1.69, "text": 0.35, "wifi": 3.16, "twc": 0.21},
    "#02": {"lidar": 1.41, "text": 1.67, "wifi": 1.56, "twc": 0.16},
}
"""Published end point errors [m]; `lidar` is DCL-SLAM."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the table."""
    add_seeds(parser, "0-19", "seeds of the walks")
    add_some(parser, "--scenes", SCENES, "scenes")
    parser.add_argument("--signs", choices=SIGNS, default=SIGNS[0], help="signs on the walls")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """One row per scene, method and back end, as means over the walks."""
    mapped = runner.grid(options.scenes, options.seeds, lambda scene, seed: map_scene(scene, options.signs, seed))
    return [_summary(scene, runs) for scene, walks in mapped.items() for runs in zip(*walks, strict=True)]


def map_scene(scene: str, signs: str, seed: int) -> list[dict]:
    """All methods with all back ends on one walk: figures of each."""
    walks = walk_scene(scene_config(scene), scene, signs, seed)
    figures = []
    for method, backend, matched, built in maps_of(scene, walks):
        figures.append({"method": method, "backend": backend, **_score(scene, walks, matched, built)})
        if (method, backend) == ("text", LITERAL):
            for share, some in with_few_false(matched, seed):
                few = build(walks, some, "plain")
                figures.append({"method": method, "backend": f"{LITERAL} {share:g}", **_score(scene, walks, some, few)})
    live = map_live(scene_config(scene), walks)
    figures.append({"method": "fused", "backend": LIVE, **_score(scene, walks, [], live)})
    return [*figures, map_mixed(scene, signs, seed)]


def map_mixed(scene: str, signs: str, seed: int) -> dict:
    """The paper's own team on the same routes, mapped by the engine."""
    config = mixed_config(scene)
    walks = walk_scene(config, scene, signs, seed)
    live = map_live(shared_config(config), walks)
    return {"method": "fused", "backend": LIVE_MIXED, **_score(scene, walks, [], live)}


def maps_of(scene: str, walks: Sequence[Walk]) -> list[tuple[str, str, list[Matched], OfflineMap]]:
    """(method, back end, matched candidates, map) for all methods and back ends."""
    maps = []
    for method, settings in METHODS.items():
        recognition = {"recogniser": method, **settings} if method != "odometry" else {}
        config = override(
            scene_config(scene), {f"slam.place_recognition.{key}": value for key, value in recognition.items()}
        )
        found = candidates(config, walks) if method != "odometry" else []
        matched = match(config, walks, found)
        for backend in BACKENDS:
            maps.append((method, backend, matched, build(walks, matched, backend)))
        if method in PRINT[scene]:
            as_printed = override(config, {"slam.verification.method": "point-to-point"})
            matched = match(as_printed, walks, found)
            maps.append((method, LITERAL, matched, build(walks, matched, "plain")))
    return maps


def with_few_false(matched: list[Matched], seed: int) -> list[tuple[float, list[Matched]]]:
    """(share, closures): all correct closures, and as many false ones as give each of SHARES_RIGHT."""
    false = [k for k, m in enumerate(matched) if not m.is_right]
    order = random_stream(seed, "false closures").permutation(false).tolist()
    chosen = []
    for share in SHARES_RIGHT:
        left = set(order[: round((len(matched) - len(false)) * (1.0 / share - 1.0))])
        chosen.append((share, [m for k, m in enumerate(matched) if m.is_right or k in left]))
    return chosen


def map_live(config: EnvConfig, walks: Sequence[Walk]) -> OfflineMap:
    """The map of the engine's mapper, which receives the keyframes one by one."""
    config = override(config, {"slam.place_recognition.recogniser": "fused", "slam.pose_graph.robust": "ours"})
    team = TeamMapper(config, len(walks))
    for keyframe in in_time([w.keyframes for w in walks]):
        team.update(keyframe.step, [keyframe])
    team.finish()
    poses = tuple(team.poses_of(robot).copy() for robot in range(len(walks)))
    groups = sorted((group.robots for group in team.groups), key=lambda robots: (-len(robots), robots))
    return OfflineMap(poses, tuple(groups), np.zeros(0, bool))


def _score(scene: str, walks: Sequence[Walk], matched: Sequence[Matched], built: OfflineMap) -> dict:
    true = [np.array(walk.poses) for walk in walks]
    squares = []
    for group in built.groups:
        estimated = np.concatenate([built.poses[robot] for robot in group])
        error_m = metrics.absolute_trajectory_error_m(estimated, np.concatenate([true[robot] for robot in group]))
        squares += [error_m**2] * len(estimated)
    walls_m = load_map(SCENES[scene][0]).walls_m
    right = np.array([m.is_right for m in matched], bool)[built.accepted[: len(matched)]]
    return {
        "epe_m": float(np.mean([metrics.end_point_error_m(*pair) for pair in zip(built.poses, true, strict=True)])),
        "ate_m": math.sqrt(float(np.mean(squares))),
        "wall_thickness_m": wall_thickness_m(point_cloud(walks, built, LIDAR.range_max_m), walls_m),
        "travel_m": sum(walk.travel_m for walk in walks),
        "closures": len(right),
        "closure_precision": float(right.mean()) if len(right) else math.nan,
        "merged": len(built.groups) == 1,
    }


# --- the rows ---


def _summary(scene: str, runs: Sequence[dict]) -> dict:
    method, backend = runs[0]["method"], runs[0]["backend"]
    values = {key: np.array([run[key] for run in runs], float) for key in runs[0] if key not in ("method", "backend")}
    means = {key: over_known(value, np.mean, 4) for key, value in values.items()}
    return {
        "scene": scene,
        "method": method,
        "backend": backend,
        **{key: means[key] for key in ("epe_m", "ate_m", "wall_thickness_m", "travel_m")},
        "paper_epe_m": PRINT[scene].get(method, math.nan),
        "seeds": len(runs),
        "sd": over_known(values["epe_m"], np.std, 4),
        "epe_worst_m": over_known(values["epe_m"], np.max, 4),
        "ate_worst_m": over_known(values["ate_m"], np.max, 4),
        **{key: means[key] for key in ("closures", "closure_precision", "merged")},
    }


def remarks(table: list[dict]) -> list[str]:
    """The order of the methods and the published one, and the paper's claim recomputed (papers.md T20)."""
    lines = []
    for scene in dict.fromkeys(row["scene"] for row in table):
        printed = sorted(PRINT[scene], key=PRINT[scene].__getitem__)
        lines.append(f"{scene} order of end point errors, paper: {' < '.join(printed)}")
        for backend in (*BACKENDS, LITERAL):
            errors = {r["method"]: r["epe_m"] for r in table if (r["scene"], r["backend"]) == (scene, backend)}
            found = sorted(printed, key=errors.__getitem__)
            lines.append(f"{scene} {backend:>7}: {' < '.join(f'{method} {errors[method]:.2f}' for method in found)}")
    for method, backend in itertools.product(("lidar", "text", "wifi"), ("plain", "robust")):
        ours, per_scene = reductions(_errors(table, method, backend), _errors(table, "twc", backend))
        print_means, print_scenes = reductions(*([scene[m] for scene in PRINT.values()] for m in (method, "twc")))
        lines.append(
            f"twc against {method}, back end {backend}: {100 * ours:.0f} % lower error by the means of both scenes, "
            f"{100 * per_scene:.0f} % as the mean of both scenes "
            f"(paper: {100 * print_means:.0f} and {100 * print_scenes:.0f} %)"
        )
    return lines + _why(table)


def _why(table: Sequence[dict]) -> list[str]:
    """What the order of the methods rests on: the precision of closures."""
    lines = []
    for row in table:
        if row["backend"] == LITERAL and row["closure_precision"] is not None:
            lines.append(
                f"{row['scene']} {row['method']} as printed: {100 * row['closure_precision']:.0f} % of its closures "
                f"are correct; EPE {row['epe_m']:.2f} m, ATE {row['ate_m']:.2f} m"
            )
    for scene in dict.fromkeys(row["scene"] for row in table):
        of_fewer = [r for r in table if r["scene"] == scene and r["backend"].startswith(f"{LITERAL} ")]
        told = ", ".join(f"{r['epe_m']:.2f} m with {100 * r['closure_precision']:.0f} %" for r in of_fewer)
        literal = {r["method"]: r["epe_m"] for r in table if (r["scene"], r["backend"]) == (scene, LITERAL)}
        printed = sorted(PRINT[scene], key=PRINT[scene].__getitem__)
        orders = [sorted(printed, key=(literal | {"text": row["epe_m"]}).__getitem__) for row in of_fewer]
        shares = [f"{100 * share:g}" for share, order in zip(SHARES_RIGHT, orders, strict=True) if order == printed]
        met = f"with {', '.join(shares)} %" if shares else "with none of these"
        precision = PRINT_TABLE1[scene]["text"][-1][0]
        lines.append(
            f"{scene} text as printed, by the precision of its closures: EPE {told}; the paper has "
            f"{PRINT[scene]['text']:.2f} m, and a precision of {precision} % in its Table I; "
            f"the methods rank as in the paper {met}"
        )
    return lines


def _errors(table: Sequence[dict], method: str, backend: str) -> list[float]:
    return [row["epe_m"] for row in table if (row["method"], row["backend"]) == (method, backend)]


def reductions(baseline: Sequence[float], improved: Sequence[float]) -> tuple[float, float]:
    """1 - mean / mean of errors over the scenes, which the paper calls "precision", and the mean of 1 - ratio."""
    of_means = 1.0 - float(np.mean(improved)) / float(np.mean(baseline))
    return of_means, float(np.mean(1.0 - np.asarray(improved) / np.asarray(baseline)))


def draw(options: argparse.Namespace, runner: Runner, folder: Path) -> list[Path]:
    """The paper's figures 4 to 6 for the first walk of each scene."""
    return draw_figures(options.scenes, options.signs, options.seeds[0], runner, folder, picture_options(options))


def draw_figures(
    scenes: Sequence[str], signs: str, seed: int, runner: Runner, folder: Path, kind: Kind | None
) -> list[Path]:
    """The paper's figures 4 to 6 for one walk of each scene."""
    from twc_env.reproduce.twc.twc_pictures import draw_scene

    paths = []
    for scene in scenes:
        runner.say(f"drawing {scene} seed {seed}")
        walks = walk_scene(scene_config(scene), scene, signs, seed)
        paths += draw_scene(scene, walks, maps_of(scene, walks), folder, kind)
    return paths
