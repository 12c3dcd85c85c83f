"""Sessions after one another in one building: does the later one find itself in the map of the earlier one?

In each building, furniture stands in the rooms. In the first session two robots tour the rooms, and the map is saved.
For the second session a third of the furniture has been moved and half of the doors are shut; two robots start anywhere
in what is still open, know no pose in the old map, and begin with its file as `slam.prior`. The walkers know the
building; the engine only receives sensor frames.

`merged` is 1 if both robots found the old map by the end, `wrong` counts those that were ever in its frame by more than
1 m or 10 degrees wrong. `ate_m` is the root mean square position error of the second session in the frame of the first
one, which was aligned with the building by the first session's truth: no second alignment. `grid_change_found` is the
share of cells that changed (furniture or a door came or went) and that the second session's scans saw, which the saved
map shows as they are now. `shared_m` is the length of the second session's path within 1.5 m of the first one's: a
session that shares nothing, because doors are shut, cannot find the old map; the row of all counts these as `apart`.

`--sessions 10` rows: that many sessions in one building, each with the map of the one before: size of the file,
keyframes in it, median time of an engine's step. With TWC_DATA also the Intel Lab log, cut in three; see
`intel_sessions`.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array
from scipy.ndimage import distance_transform_edt, label
from scipy.spatial import cKDTree

from twc_env.config import EnvConfig, override
from twc_env.datasets.lasting_maps import read_lasting_map, write_lasting_map
from twc_env.errors import ConfigError
from twc_env.exploration.assessment.evaluation import map_at
from twc_env.exploration.environment import ExplorationEnv
from twc_env.maps import load_map
from twc_env.metrics import align_team, path_length_m
from twc_env.records.geometry import between, compose, inverse, transform_points, wrap_angle
from twc_env.records.lasting_map import LastingMap
from twc_env.records.messages import GridMap
from twc_env.records.random_streams import random_stream
from twc_env.reproduce.lasting.changed_buildings import Fittings, changed, fitted, with_fittings
from twc_env.reproduce.lasting.intel_sessions import intel_sessions, lacks_log
from twc_env.reproduce.routes import CLEARANCE_M, RoutePlanner, room_tour
from twc_env.reproduce.runner import Runner
from twc_env.reproduce.twc.merging import STEPS_PER_M, begin_episode, step_walkers
from twc_env.running.options import add_set, assignments, count, natural
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.building.splits import split_names

CHOOSES = ("buildings", "sessions")
ROBOTS = 2
ROOMS_MAX, ROOMS_SHARED = 5, 2
"""Rooms of its own strip that a robot tours, and of the next robot's."""
MOVED_SHARE, SHUT_SHARE = 1 / 3, 1 / 2
WRONG_M, WRONG_RAD = 1.0, math.radians(10)
NEAR_M = 1.5
"""A place of the second session this near the first one's path is shared."""
STOP_AWAY_M = 0.7
"""A stop is left out if no open floor is this near."""
LEAN = {f"observation.{block}": False for block in ("lidar", "map", "wifi", "signs", "team")}
"""The walkers need no observations but poses."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of this table."""
    parser.add_argument("--buildings", type=natural, default=50, help="number of buildings")
    parser.add_argument("--split", choices=("validation", "test"), default="test", help="whose buildings")
    parser.add_argument("--sessions", type=natural, default=10, help="sessions in one building after one another")
    parser.add_argument("--seed", type=natural, default=0, help="of noise, starts, furniture and changes")
    parser.add_argument("--jobs", type=count, default=2, help="parallel processes")
    add_set(parser)


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """A row per building, one for all; then one per session in one building."""
    names = split_names(options.split)
    if options.buildings > len(names):
        raise ConfigError(f"the {options.split} split holds {len(names)} buildings; got {options.buildings}")
    settings = assignments(options.set)
    override(EnvConfig(), settings)  # an unknown setting fails before the first episode
    work = partial(two_sessions, seed=options.seed, settings=settings)
    found = runner.each(names[: options.buildings], work, processes=options.jobs)
    out = list(found)
    if found:
        out.append(_of_all(found))
    chain = runner.each(
        [options.sessions] if options.sessions else [], partial(_chain, names[0], options.seed, settings)
    )
    lacks = lacks_log()
    if lacks:
        runner.notes.append(f"left out: the Intel Lab log in three sessions: {lacks}")
    logs = runner.each([] if lacks else [3], intel_sessions, lambda k: f"intel in {k} sessions")
    return out + [row for own in (*chain, *logs) for row in own]


def _of_all(found: Sequence[dict]) -> dict:
    in_map = [row for row in found if row["merged"]]
    mean = {key: float(np.mean([row[key] for row in in_map] or [math.nan])) for key in ("ate_m", "grid_change_found")}
    return {
        "building": f"all {len(found)}",
        "merged": sum(row["merged"] for row in found) / len(found),
        "wrong": sum(row["wrong"] for row in found),
        "apart": sum(row["shared_m"] == 0.0 for row in found),
        **mean,
        "ate_max_m": max((row["ate_m"] for row in in_map), default=math.nan),
        "found_s": float(np.median([row["found_s"] for row in in_map] or [math.nan])),
        "file_kb": float(np.mean([row["file_kb"] for row in found])),
    }


@dataclass(frozen=True, slots=True, eq=False)
class Session:
    """What one session leaves, and its truth."""

    lasting: LastingMap
    pose_building_map: Array
    """(3,) alignment of the map with the building by the truth of this session."""
    errors: Array
    """(steps, 3) of all robots in the prior map's frame, as x, y [m], heading [rad]; (0, 3) if it was not found."""
    found: int
    """Robots that are in the prior map at the end."""
    wrong: int
    """Robots that were ever in it with a wrong frame."""
    found_s: float
    seen: GridMap
    """The scans of this session alone, drawn at the true poses."""
    step_ms: float
    """Median time of a step of the engine."""
    true_m: Array
    """(steps, robots, 2) where the robots were."""


def two_sessions(name: str, seed: int = 0, settings: dict | None = None) -> dict:
    """One building: a session, changes, and a session with the map of the first one."""
    plan = load_map(name)
    before = fitted(plan, seed)
    after = changed(plan, before, seed, MOVED_SHARE, SHUT_SHARE)
    plans = [with_fittings(plan, fittings) for fittings in (before, after)]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "map.npz"
        first = session(plans[0], seed, 0, settings)
        size = write_lasting_map(file, first.lasting)
        second = session(plans[1], seed, 1, settings, file, first.pose_building_map)
        write_lasting_map(file, second.lasting)
        saved = read_lasting_map(file)
    return {
        "building": name,
        "merged": int(second.found == ROBOTS),
        "wrong": second.wrong,
        "ate_m": _rms(second.errors[:, :2]),
        "grid_change_found": change_found(plans, second.seen, saved.grid, first.pose_building_map),
        "found_s": second.found_s,
        "shared_m": _shared_m(first.true_m, second.true_m),
        "boxes": len(before.boxes_m),
        "boxes_moved": int((before.boxes_m != after.boxes_m).any(axis=1).sum()),
        "doors": len(after.doors_m),
        "doors_shut": int(after.is_shut.sum()),
        "file_kb": size / 1000,
        "keyframes": len(first.lasting.poses),
        "step_ms": second.step_ms,
    }


def _shared_m(first_m: Array, second_m: Array) -> float:
    """Length [m] of the second paths (steps, robots, 2) near the first."""
    away_m, _ = cKDTree(first_m.reshape(-1, 2)).query(second_m)
    return float(np.linalg.norm(np.diff(second_m, axis=0), axis=2)[away_m[1:] < NEAR_M].sum())


def _rms(errors_m: Array) -> float | None:
    return float(np.sqrt((errors_m**2).sum(axis=1).mean())) if len(errors_m) else None


def session(
    plan: Floorplan, seed: int, number: int, settings: dict | None = None, prior: Path | None = None,
    pose_building_prior: Array | None = None,
) -> Session:  # fmt: skip
    """One session of two robots; number: of the session, by which its starts and noise differ.

    pose_building_prior (3,): alignment of the prior map with the building.
    """
    ways = tours(plan, random_stream(seed, f"tours {plan.name} {number}"))
    steps = int(max(path_length_m(way) for way in ways) * STEPS_PER_M) + 50
    config = override(EnvConfig(), {**LEAN, **(settings or {}), "robots": ROBOTS, "max_cycles": steps})
    config = override(config, {"slam.prior": str(prior) if prior else ""})
    env = ExplorationEnv(config=config, floorplan=plan)
    walkers = begin_episode(env, ways, 1000 * seed + number)
    wrong, found_s, times_s = set[int](), math.inf, list[float]()
    clock = _Clocked(env, times_s)
    while env.agents and not all(walker.is_done for walker in walkers):
        step_walkers(env, walkers)
        if prior is not None and pose_building_prior is not None and env.episode.steps % 10 == 0:
            inside = [robot for robot in range(ROBOTS) if env.engine.found_prior(robot)]
            if len(inside) == ROBOTS:
                found_s = min(found_s, env.episode.steps * config.dynamics.time_step_s)
            for robot in inside:
                pose = compose(pose_building_prior, env.engine.pose_map_robot(robot))
                wrong |= {robot} if _is_wrong(pose, env.episode.world.poses[robot]) else set()
    clock.stop()
    env.engine.finish()
    result, engine = env.result(), env.engine
    inside = [robot for robot in range(ROBOTS) if prior is not None and engine.found_prior(robot)]
    errors = np.zeros((0, 3))
    if pose_building_prior is not None and inside:
        poses = compose(pose_building_prior, result.estimated_poses[:, inside])
        errors = (poses - result.true_poses[:, inside]).reshape(-1, 3)
        errors[:, 2] = wrap_angle(errors[:, 2])
    best = [r for r in range(ROBOTS) if engine.mapper_of(r).group_index(r) == _saved_group(engine)]
    aligned = align_team(
        np.concatenate([result.estimated_poses[:, r] for r in best or [0]]),
        np.concatenate([result.true_poses[:, r] for r in best or [0]]),
    )
    seen = map_at(engine, result.true_poses, env.config)
    return Session(
        engine.lasting_map(), aligned, errors, len(inside), len(wrong), found_s, seen,
        1e3 * float(np.median(times_s)), result.true_poses[:, :, :2],
    )  # fmt: skip


def _saved_group(engine) -> int:
    team = engine.team
    if team.prior is not None:
        return team.group_of_segment(team.prior)
    return int(np.argmax([sum(len(team.keyframes[r]) for r in group.robots) for group in team.groups]))


class _Clocked:
    """Measures the steps of an environment's engine."""

    def __init__(self, env: ExplorationEnv, times_s: list[float]):
        engine = self._engine = env.engine
        track, absorb = engine.track, engine.absorb

        def timed_track(frames):
            self._begun = time.perf_counter()
            return track(frames)

        def timed_absorb(*given):
            absorb(*given)
            times_s.append(time.perf_counter() - self._begun)

        self._begun = 0.0
        engine.track, engine.absorb = timed_track, timed_absorb  # type: ignore[method-assign]

    def stop(self) -> None:
        """Measure no more."""
        del self._engine.track, self._engine.absorb


def _is_wrong(pose: Array, true: Array) -> bool:
    apart = between(true, pose)
    return bool(np.hypot(apart[0], apart[1]) > WRONG_M or abs(apart[2]) > WRONG_RAD)


def tours(plan: Floorplan, random: np.random.Generator) -> list[Array]:
    """A path (points, 2) of each robot through open rooms: its strip of the building, and rooms of the next."""
    cells = plan.cells()
    clear = distance_transform_edt(cells.free) * cells.resolution_m >= CLEARANCE_M
    parts, _ = label(clear, np.ones((3, 3)))
    main = parts == np.argmax(np.bincount(parts[parts > 0]))
    centres_m, planner = cells.centre_of(np.argwhere(main)), RoutePlanner(plan)
    stops_of = []
    for room in plan.rooms:
        at = [centres_m[np.argmin(((centres_m - stop) ** 2).sum(axis=1))] for stop in room_tour(room)]
        near = [a for a, stop in zip(at, room_tour(room), strict=True) if np.hypot(*(a - stop)) <= STOP_AWAY_M]
        if near:
            stops_of.append((tuple(np.round(room.polygon_m.mean(axis=0), 3)), near))
    stops_of.sort(key=lambda one: one[0])
    strips = np.array_split(np.arange(len(stops_of)), ROBOTS)
    ways = []
    for k, strip in enumerate(strips):
        chosen = [*random.permutation(strip)[:ROOMS_MAX], *random.permutation(strips[(k + 1) % ROBOTS])[:ROOMS_SHARED]]
        stops = [stop for i in chosen for stop in stops_of[i][1]]
        ways.append(planner.route(stops))
    if np.hypot(*(ways[0][0] - ways[1][0])) < 1.0:
        ways[1] = ways[1][20:]
    return ways


def change_found(plans: Sequence[Floorplan], seen: GridMap, saved: GridMap, pose_building_map: Array) -> float | None:
    """Share of the changed and seen cells that the saved map shows as they are now; None if none was seen.

    seen: in the frame of the building; pose_building_map (3,): of the saved map's frame.
    """
    before, after = (plan.cells() for plan in plans)
    here = np.indices(after.free.shape).transpose(1, 2, 0)
    levels = seen.level_at(after.centre_of(here))
    is_gone = after.free & ~before.free & (levels < 0)
    is_new = after.wall & before.free & (levels > 0)
    saved_at = transform_points(inverse(pose_building_map), after.centre_of(np.argwhere(is_gone | is_new)))
    if not len(saved_at):
        return None
    around = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)]) * saved.resolution_m
    found = np.stack([saved.level_at(saved_at + shift) for shift in around])
    is_wall = is_new[is_gone | is_new]
    right = np.where(is_wall, (found > 0).any(axis=0), found[4] < 0)
    return float(right.mean())


def _chain(name: str, seed: int, settings: dict, sessions: int) -> list[dict]:
    """Sessions in one building, each with the map of the one before; furniture and doors change each time."""
    plan, out = load_map(name), []
    fittings: Fittings = fitted(plan, seed)
    with tempfile.TemporaryDirectory() as folder:
        file, aligned = Path(folder) / "map.npz", None
        for number in range(sessions):
            if number:
                fittings = changed(plan, fittings, seed + number, MOVED_SHARE, SHUT_SHARE)
            prior = file if number else None
            one = session(with_fittings(plan, fittings), seed, number, settings, prior, aligned)
            aligned = one.pose_building_map if aligned is None else aligned
            size = write_lasting_map(file, one.lasting)
            out.append({
                "building": f"{name} session {number + 1}",
                "merged": int(one.found == ROBOTS) if number else None,
                "wrong": one.wrong,
                "ate_m": _rms(one.errors[:, :2]),
                "found_s": one.found_s if number else None,
                "file_kb": size / 1000,
                "keyframes": len(one.lasting.poses),
                "step_ms": one.step_ms,
            })  # fmt: skip
    return out
