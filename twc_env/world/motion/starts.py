"""Start poses of an episode: random, those of the plan, or given ones."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import UNFIT, ConfigError, MapError
from twc_env.records.geometry import compose, inverse
from twc_env.records.random_streams import random_stream
from twc_env.world.building.floorplan import Floorplan, angle_fault

START_CLEARANCE_M = 0.4
"""Least distance of a random start to walls ..."""
START_SPACING_M = 1.5
"""... and to other starts, down to `START_SPACING_MIN_M` in small buildings."""
START_SPACING_MIN_M = 0.6
ENTRANCE_SPACING_M = 1.0
"""The same at an entrance, where robots start side by side."""
START_MARGIN_M = 0.02
"""Least gap between the rims of large robots and walls or other robots."""
_TOLERANCE_M = 1e-6
"""Overlap of given starts that is rounding."""
_PLACES_MAX = 2000
"""Candidate positions per try."""
_TRIES = 20
"""Number of spacings tried."""


def start_poses(plan: Floorplan, robots: int, radius_m: float | Array, seed: int, starts: str | Array) -> Array:
    """(robots, 3) start poses in the home frame; radius_m: of all robots, or of each (robots,); starts: see
    `World.reset`.

    Raises MapError if the robots do not fit, ConfigError for invalid starts.
    """
    home, radii_m = plan.home, np.full(robots, radius_m, float)
    if not isinstance(starts, str):
        try:
            poses = np.array(starts, float)
        except UNFIT:
            wanted = f"'random', 'entrance', 'map' or {robots} poses"
            raise ConfigError(f"starts must be {wanted}; got {starts!r}") from None
        _check_poses(plan, robots, poses)
        poses_home = compose(inverse(plan.pose_building_home), poses)
        if fault := _overlap(home, radii_m, poses_home, poses):
            raise ConfigError(fault)
        return poses_home
    if starts in ("random", "entrance"):
        return _random_starts(home, robots, float(radii_m.max()), random_stream(seed, "starts"), starts == "entrance")
    if starts == "map":
        if len(home.starts) < robots:
            raise MapError(
                f"map {home.name!r} has {len(home.starts)} starts for {robots} robots; add some, or draw them at random"
            )
        poses_home = np.array(home.starts[:robots])
        if fault := _overlap(home, radii_m, poses_home, compose(plan.pose_building_home, poses_home)):
            raise MapError(f"map {home.name!r}: {fault}")
        return poses_home
    raise ConfigError(f"starts must be 'random', 'entrance', 'map' or poses; got {starts!r}")


def _check_poses(plan: Floorplan, robots: int, poses: Array) -> None:
    """Raise ConfigError for starts in the building frame that are no poses or not on free floor."""
    wanted = f"starts must be {robots} finite poses (x, y, heading)"
    if poses.shape != (robots, 3):
        raise ConfigError(f"{wanted}; got shape {poses.shape}")
    is_free = plan.cells().is_free(poses[:, :2])
    for i, pose in enumerate(poses):
        if not np.isfinite(pose).all():
            raise ConfigError(f"{wanted}; got starts[{i}] = {pose.tolist()}")
        if not is_free[i]:
            raise ConfigError(f"{_named(i, pose)} is not on the free floor of map {plan.home.name!r}; move it inside")
        if fault := angle_fault(pose[2]):
            raise ConfigError(f"{_named(i, pose)}: its heading {fault}")


def _overlap(home: Floorplan, radii_m: Array, poses_home: Array, poses: Array) -> str | None:
    """What is wrong with the first robot that overlaps a wall or a robot before it; poses (n, 3) name its place."""
    gaps_m = home.wall_index.distance_m(poses_home[:, :2], float(radii_m.max()))
    for i, (here, gap_m) in enumerate(zip(poses_home, gaps_m.tolist(), strict=True)):
        at, radius_m = _named(i, poses[i]), float(radii_m[i])
        if gap_m < radius_m - _TOLERANCE_M:
            return (
                f"{at} is {gap_m:.3f} m from a wall, and {_size_of(i, radii_m)}; move it at least "
                f"{radius_m - gap_m:.3f} m away, or reduce dynamics.robot_radius_m"
            )
        away_m = np.hypot(*(poses_home[:i, :2] - here[:2]).T)
        apart_m = radii_m[:i] + radius_m
        if i and (away_m - apart_m).min() < -_TOLERANCE_M:
            other = int(np.argmin(away_m - apart_m))
            return (
                f"{at} is {away_m[other]:.3f} m from that of robot {other}, and {_size_of(i, radii_m)}; "
                f"keep them {apart_m[other]:g} m apart, or reduce dynamics.robot_radius_m"
            )
    return None


def _size_of(robot: int, radii_m: Array) -> str:
    if (radii_m == radii_m[0]).all():
        return f"robots have a radius of {radii_m[0]:g} m"
    return f"this robot has a radius of {radii_m[robot]:g} m"


def _named(robot: int, pose: Array) -> str:
    return f"starts[{robot}] at ({pose[0]:g}, {pose[1]:g})"


def _random_starts(
    home: Floorplan, robots: int, radius_m: float, random: np.random.Generator, is_entrance: bool
) -> Array:
    """(robots, 3) random poses with clearance to walls and spacing, which is reduced in steps if there is no room."""
    clearance_m = max(START_CLEARANCE_M, radius_m + START_MARGIN_M)
    apart_m = 2 * radius_m + START_MARGIN_M
    clear = _clear_cells(home, clearance_m)
    if len(clear) == 0:
        raise MapError(f"map {home.name!r} has no place {clearance_m:g} m clear of walls to start from")
    widest_m = max(ENTRANCE_SPACING_M if is_entrance else START_SPACING_M, apart_m)
    for spacing_m in np.linspace(widest_m, max(START_SPACING_MIN_M, apart_m), _TRIES):
        if is_entrance:
            places = start_places(home, clearance_m)
            candidates = _around(home, places, places[random.integers(len(places))])
        else:
            candidates = _centres(home, clear[random.permutation(len(clear))[:_PLACES_MAX]])
        chosen = _choose_spaced(candidates, robots, spacing_m)
        if len(chosen) == robots:
            return np.column_stack([chosen, random.uniform(-math.pi, math.pi, robots)])
    raise MapError(f"map {home.name!r} has no room for {robots} robots; use fewer")


def _around(home: Floorplan, places: Array, entrance: Array) -> Array:
    """(k, 2) places in sight of the entrance, nearest first."""
    away_m = np.hypot(*(places - entrance).T)
    near = places[np.argsort(away_m, kind="stable")[:_PLACES_MAX]]
    return near[home.wall_index.crossing(entrance, np.ascontiguousarray(near))[0] == 0]


def start_places(home: Floorplan, clearance_m: float = START_CLEARANCE_M) -> Array:
    """(k, 2) centres of the free cells at least `clearance_m` from walls."""
    return _centres(home, _clear_cells(home, clearance_m))


@lru_cache(maxsize=2)
def _clear_cells(home: Floorplan, clearance_m: float) -> Array:
    """(k,) int32 flat indices of these cells; those of two buildings are kept, as they are 2 MB in 5,000 m2."""
    free = np.flatnonzero(home.cells().free)
    return free[home.wall_index.distance_m(_centres(home, free), clearance_m) >= clearance_m].astype(np.int32)


def _centres(home: Floorplan, flat: Array) -> Array:
    """(k, 2) centres of cells with these flat indices (k,)."""
    return home.cells().centre_of(np.column_stack(np.unravel_index(flat, home.cells().free.shape)))


def _choose_spaced(places: Array, count: int, spacing_m: float) -> Array:
    chosen: list[Array] = []
    for place in places:
        if all(np.hypot(*(place - other)) >= spacing_m for other in chosen):
            chosen.append(place)
            if len(chosen) == count:
                break
    return np.array(chosen).reshape(-1, 2)
