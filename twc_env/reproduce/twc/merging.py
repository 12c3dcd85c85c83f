"""Map merging without a common start frame, in unseen buildings: success rate, wrong merges, cost.

Each of the 100 buildings of the test split gets one episode. Its rooms are assigned to the robots in strips from left
to right; each robot tours its own strip and the first rooms of the next, so paths overlap partially. The walkers know
the building; the engine only receives sensor frames.

`wrong_merges` counts pairs of robots that shared a map at any time although their own paths place it more than 1 m or
10 degrees apart, `undone` the merges that the engine undid. Bytes are those transmitted until two robots first shared a
map, by message type. `wall_thickness_m` is measured in the largest map, `wall_thickness_true_m` in one drawn from the
same scans at the true poses; ghost walls would make them differ. With `--set link.scan_on_request=true` scans are sent
only on request; with `--set link.topology=peer` there is one mapper per robot instead of a central one.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import EnvConfig, override
from twc_env.errors import ConfigError
from twc_env.exploration.assessment.evaluation import map_at
from twc_env.exploration.environment import ExplorationEnv
from twc_env.maps import load_map
from twc_env.metrics import path_length_m, wall_thickness_m
from twc_env.records.messages import GridMap
from twc_env.reproduce.routes import RoutePlanner, room_tour, steer
from twc_env.reproduce.runner import Runner
from twc_env.running.options import add_set, assignments, count, natural
from twc_env.slam.exchange import KINDS
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.building.splits import split_names

CHOOSES = ("buildings",)
ROOMS_MAX = 4
"""Maximum number of rooms of its own strip that a robot tours."""
STEPS_PER_M = 20.0
BYTES = ("bytes_to_first_merge", *(f"bytes_{kind}" for kind in KINDS))
THICKNESS = ("wall_thickness_m", "wall_thickness_true_m")
STUCK_STEPS, ESCAPE_STEPS = 30, 12
"""A walker without progress for the first number of steps backs off for the second, alternating left and right."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of this table."""
    parser.add_argument("--buildings", type=count, default=100, help="number of test-split buildings")
    parser.add_argument("--robots", type=count, default=3, help="number of robots")
    parser.add_argument("--seed", type=natural, default=0, help="noise seed")
    add_set(parser)


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """A row per building, and one for all `buildings` at the end."""
    names = first_buildings(options.buildings)
    settings = assignments(options.set)
    override(EnvConfig(), settings)  # an unknown setting fails before the first episode
    found = runner.each(names, lambda name: merge_in(name, options.robots, options.seed, settings))
    total = {
        "building": f"all {len(found)}",
        "buildings": len(found),
        **{key: sum(row[key] for row in found) for key in ("rooms", "steps", "fully_merged", "wrong_merges")},
        **{key: _known(np.median, (row[key] for row in found)) for key in ("first_merge_s", "all_merged_s")},
        "undone": sum(row["undone"] for row in found),
        **{key: _known(np.median, (row[key] for row in found)) for key in BYTES},
        **{key: _known(np.mean, (row[key] for row in found)) for key in THICKNESS},
        "team_ate_m": float(np.mean([row["team_ate_m"] for row in found])),
        "team_ate_max_m": max(row["team_ate_max_m"] for row in found),
    }
    return [*found, total]


def first_buildings(count: int) -> tuple[str, ...]:
    """The first buildings of the test split. Raises ConfigError for more than it holds."""
    names = split_names("test")
    if count > len(names):
        raise ConfigError(f"the test split holds {len(names)} buildings; got {count}")
    return names[:count]


def merge_in(name: str, robots: int, seed: int, changes: dict[str, object] | None = None) -> dict:
    """One episode in one building, with some settings changed."""
    plan = load_map(name)
    ways = overlapping_ways(plan, robots)
    longest = max(path_length_m(way) for way in ways)
    settings = {**(changes or {}), "map": name, "robots": robots, "max_cycles": int(longest * STEPS_PER_M) + 50}
    env = ExplorationEnv(config=override(EnvConfig(), settings))
    walkers = begin_episode(env, ways, seed)
    first = everyone = None
    sent: dict[str, int] = {}
    while env.agents and not all(walker.is_done for walker in walkers):
        step_walkers(env, walkers)
        sharing = [len(view.robots) for view in env.engine.views()]
        if max(sharing) > 1 and first is None:
            first, sent = env.frames[0].time_s, dict(env.engine.bytes_sent)
        if min(sharing) == robots and everyone is None:
            everyone = env.frames[0].time_s
    result = env.result()
    figures = result.figures
    return {
        "building": name,
        "rooms": len(plan.rooms),
        "steps": figures["steps"],
        "fully_merged": int(figures["merged_robots"] == robots),
        "wrong_merges": figures["wrong_merges"],
        "first_merge_s": first,
        "all_merged_s": everyone,
        "undone": sum(mapper.merges_undone for mapper in env.engine.mappers),
        "bytes_to_first_merge": sum(sent.values()) if sent else None,
        **{f"bytes_{kind}": sent.get(kind) for kind in KINDS},
        "wall_thickness_m": _thickness(result.grids[0], result.pose_building_map[0], plan),
        "wall_thickness_true_m": _thickness(map_at(env.engine, result.true_poses, env.config), np.zeros(3), plan),
        "team_ate_m": figures["team_ate_m"],
        "team_ate_max_m": figures["team_ate_m"],
    }


def _thickness(grid: GridMap, pose_building_map: Array, plan: Floorplan) -> float:
    return wall_thickness_m(grid.log_odds, grid.origin_m, grid.resolution_m, pose_building_map, plan.walls_m)


def overlapping_ways(plan: Floorplan, robots: int) -> list[Array]:
    """A path (points, 2) for each robot: the rooms of its strip, then the first rooms of the next.

    Raises ConfigError if there are fewer rooms than robots.
    """
    if len(plan.rooms) < robots:
        raise ConfigError(f"{plan.name} has {len(plan.rooms)} rooms for {robots} robots: choose fewer robots")
    planner = RoutePlanner(plan)
    rooms = sorted(plan.rooms, key=lambda room: tuple(np.round(room.polygon_m.mean(axis=0), 3)))
    strips = [list(strip) for strip in np.array_split(np.arange(len(rooms)), robots)]
    ways = []
    for k, strip in enumerate(strips):
        following = strips[(k + 1) % robots]
        chosen = [rooms[i] for i in _spread(strip, ROOMS_MAX)] + [rooms[i] for i in following[:2]]
        ways.append(planner.route([stop for room in chosen for stop in room_tour(room)]))
    return _apart(ways)


def _spread(strip: Sequence[int], count: int) -> list[int]:
    """At most `count` elements, evenly spread, including the first."""
    return [strip[int(i)] for i in np.unique(np.linspace(0, len(strip) - 1, min(count, len(strip))).astype(int))]


def _apart(ways: list[Array]) -> list[Array]:
    """Shorten the paths at the start so that no two robots start within a metre of each other."""
    starts: list[Array] = []
    cut = []
    for way in ways:
        k = 0
        while k < len(way) - 10 and any(np.hypot(*(way[k] - other)) < 1.0 for other in starts):
            k += 5
        starts.append(way[k])
        cut.append(way[k:])
    return cut


def _known(statistic: Callable, values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(statistic(known)) if known else None


class Walker:
    """Drives one robot along its path by its true pose; backs off when it is blocked."""

    def __init__(self, way_m: Array):
        self._way_m, self._at = way_m, 0
        self._anchor, self._still, self._escape, self._side = way_m[0], 0, 0, 1.0
        self.is_done = False

    def act(self, pose: Array, env: ExplorationEnv) -> Array:
        """(2,) action."""
        if self.is_done:
            return np.zeros(2)
        if self._escape > 0:
            self._escape -= 1
            return np.array([-0.4, self._side])
        if math.dist(pose[:2], self._anchor) > 0.3:
            self._anchor, self._still = pose[:2].copy(), 0
        self._still += 1
        if self._still > STUCK_STEPS:
            self._still, self._escape, self._side = 0, ESCAPE_STEPS, -self._side
        command, self._at = steer(pose, self._way_m, self._at, env.config)
        if command is None:
            self.is_done = True
            return np.zeros(2)
        dynamics = env.config.dynamics
        return np.clip([command[0] / dynamics.speed_max_m_s, command[1] / dynamics.turn_rate_max_rad_s], -1.0, 1.0)


def begin_episode(env: ExplorationEnv, ways: Sequence[Array], seed: int) -> list[Walker]:
    """Begin an episode in which each robot starts at its path, heading along it; returns the walkers."""
    headings = [math.atan2(*(way[min(5, len(way) - 1)] - way[0])[::-1]) for way in ways]
    starts = np.array([[*way[0], heading] for way, heading in zip(ways, headings, strict=True)])
    env.reset(seed=seed, options={"starts": starts})
    return [Walker(way) for way in ways]


def step_walkers(env: ExplorationEnv, walkers: Sequence[Walker]) -> None:
    """One step of all walkers."""
    poses = env.state().reshape(len(walkers), 6)[:, :3]
    env.step({a: w.act(p, env) for a, w, p in zip(env.agents, walkers, poses, strict=True)})
