"""Router positions estimated from signal alone in the twin plans (called easy, but not shown, by inverse k-visibility).

Walks, readings and radio are those of `sfw-table1`; only signal strengths and positions are given. The last columns are
on where to put routers, which the paper leaves open: the share of the floor in line of sight of a router, with the
routers of the experiment and with as many that `place_routers` puts for that purpose.
"""

from __future__ import annotations

import argparse

import numpy as np

from twc_env.config import radio_preset
from twc_env.maps import load_map
from twc_env.reproduce.runner import Runner, add_seeds
from twc_env.reproduce.walls.sfw_table1 import POINTS
from twc_env.reproduce.walls.sfw_walks import read_walk, resampled, wall_following_route
from twc_env.slam.walls.k_visibility_signal import locate_router
from twc_env.slam.walls.path_bins import bin_along_path
from twc_env.world.building.router_placement import place_routers, share_in_sight

CHOOSES = ("seeds",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `reproduce sfw-routers`."""
    add_seeds(parser, "0-9", "noise seeds")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """One row per experiment, and one for all."""
    errors: dict[int | str, np.ndarray] = {
        e: np.concatenate(own) for e, own in runner.grid(POINTS, options.seeds, errors_m).items()
    }
    errors["all"] = np.concatenate(list(errors.values()))
    in_sight: dict[int | str, tuple[float, ...]] = {experiment: _in_sight(experiment) for experiment in POINTS}
    in_sight["all"] = tuple(np.mean(list(in_sight.values()), axis=0).tolist())
    return [
        {
            "experiment": experiment,
            "routers_located": len(own),
            "median_error_m": float(np.median(own)),
            "error_90_percent_m": float(np.quantile(own, 0.9)),
            "seeds": len(options.seeds),
            "floor_in_sight": in_sight[experiment][0],
            "floor_in_sight_if_placed": in_sight[experiment][1],
        }
        for experiment, own in errors.items()
    ]


def _in_sight(experiment: int) -> tuple[float, ...]:
    plan = load_map(f"sfw-e{experiment}")
    own_m = np.array([a.position_m for a in plan.access_points])
    return tuple(share_in_sight(plan, routers_m) for routers_m in (own_m, place_routers(plan, len(own_m))))


def errors_m(experiment: int, seed: int) -> list[float]:
    """Distance between the true and estimated position of each router."""
    plan = load_map(f"sfw-e{experiment}")
    walk = read_walk(plan, radio_preset("sfw"), resampled(wall_following_route(plan), POINTS[experiment]), seed)
    bins = bin_along_path(walk.position_m, walk.rssi_dbm)
    return [float(np.linalg.norm(locate_router(bins, r)[0] - place)) for r, place in enumerate(walk.router_m)]
