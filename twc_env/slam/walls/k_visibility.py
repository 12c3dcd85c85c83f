"""Structure from WiFi: a wall map from signal strength along a path (inverse k-visibility, K1-K18), our method.

The signal model estimates the number of walls per reading (`k_visibility_signal`). The path suggests candidate segments
(`wall_candidates`). Sampling all segments jointly against all rays of all routers decides which are walls
(`wall_sampler`), alternating with power, path loss and the loss of every straight wall (`wall_solver`). The exact
positions of changes in the number of walls come from the readings (`change_points`). Untouched cells stay unknown.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.errors import DataError
from twc_env.records.array_validation import real_array, validated_points
from twc_env.records.fingerprint_validation import fault_of_strengths
from twc_env.slam.walls.k_visibility_grid import WallGrid, cell_probabilities
from twc_env.slam.walls.k_visibility_signal import fit_signal, locate_router, typical_signal
from twc_env.slam.walls.path_bins import bin_along_path
from twc_env.slam.walls.wall_candidates import WallCandidates, wall_candidates
from twc_env.slam.walls.wall_solver import WallSolver

STANDOFF_M, _STANDOFF_ROUNDS = 0.3, 3
"""Initial distance of walls from the path, and how often it is corrected at most (by walls between two tracks)."""
_TRIES = (0, 1, None)
"""Annealing can end in a local optimum; of several starts the one with the lowest energy is used: candidates on one
side of the path excluded at first (0, 1) or none (None), from the fitted and from a typical signal model."""
_STANDOFF_SPREAD_MAX_M = 0.05
"""With a larger standard deviation the distance to the walls is not constant, and walls that no ray crosses are left
unknown."""
EXPLAINED_MIN = 0.2
"""Where walls explain less of the variance of readings, they are not told. In three generated flats it is .58 to .65,
in four drives through a real flat together .38, in one of them that stays in two rooms -.03 (there counts are no better
than the most frequent one); with the strengths shuffled it is below 0 everywhere."""
GRID_CELLS_MAX = 25_000_000
_BINS, _BIN_RANGE_M = 1000, (0.1, 0.3)
"""Number of bins of a long path, and the range of their length: closer readings are redundant."""


@dataclass(frozen=True, slots=True, eq=False)
class Structure:
    """Wall map estimated from signal strength along one path."""

    router_m: Array
    """(routers, 2) given or estimated positions."""
    walls: Array
    """(readings, routers) most probable number of walls between each router and each reading."""
    candidates: WallCandidates
    probability: Array
    """(candidates,) probability that each is a wall."""
    grid: WallGrid
    wall_loss_db: float
    explained: float
    """Share of the variance of readings, beyond path loss, that the walls explain; below `EXPLAINED_MIN` only the path
    is known as free, and no wall is counted."""


def map_structure(
    position_m: Array,
    rssi_dbm: Array,
    router_m: Array | None = None,
    resolution_m: float = 0.1,
    seed: int = 0,
    origin_m: Array | None = None,
) -> Structure:
    """Map walls from readings (n, routers) [dBm], NaN where not heard, taken in order at positions (n, 2).

    If router positions (routers, 2) are not given, they are estimated first. The grid is aligned so that a cell corner
    lies at origin_m (2,). Raises DataError for inconsistent shapes, for 100, 0 or -999 dBm and other units, and if the
    grid would have more than GRID_CELLS_MAX cells.
    """
    position_m = validated_points(position_m, "positions")
    rssi_dbm = real_array(rssi_dbm, "readings")
    if fault := fault_of_strengths(rssi_dbm):
        raise DataError(f"readings have {fault}; NaN is not heard")
    if router_m is not None:
        router_m = validated_points(router_m, "places of routers")
    if origin_m is not None:
        origin_m = validated_points([origin_m], "a corner of the grid")[0]
    _check_grid(position_m, router_m, resolution_m)
    travel_m = float(np.linalg.norm(np.diff(position_m, axis=0), axis=1).sum())
    bins = bin_along_path(position_m, rssi_dbm, float(np.clip(travel_m / _BINS, *_BIN_RANGE_M)))
    count = bins.rssi_dbm.shape[1]
    if router_m is None:
        located = [locate_router(bins, r) for r in range(count)]
        router_m, fits = np.array([place for place, _ in located]), [fit for _, fit in located]
    else:
        if len(router_m) != count:
            raise DataError(f"give a place for each of the {count} routers that were heard; got {len(router_m)}")
        fits = [fit_signal(bins, r, router_m[r]) for r in range(count)]
    typical = [typical_signal(bins, r, place) for r, place in enumerate(router_m)]
    standoff, tries = STANDOFF_M, []
    for _ in range(_STANDOFF_ROUNDS):
        candidates = wall_candidates(bins.position_m, standoff)
        for start, barred in [(fits, side) for side in _TRIES] + [(typical, side) for side in _TRIES[:2]]:
            solver = WallSolver(bins, router_m, start, candidates, standoff, seed)
            solver.solve(barred)
            tries.append(solver)
        solver = min(tries, key=lambda solver: solver.energy)
        seen_m = solver.standoffs_m()
        if not len(seen_m) or abs(np.median(seen_m) - solver.assumed_standoff_m) < 0.01:
            break
        standoff = float(np.median(seen_m))
    explained = solver.explained
    is_told = explained >= EXPLAINED_MIN
    if not is_told:
        solver.probability[:] = 0.0
    keeps_distance = is_told and (not len(seen_m) or np.std(seen_m) <= _STANDOFF_SPREAD_MAX_M)
    grid = cell_probabilities(
        bins.position_m, router_m, np.isfinite(bins.rssi_dbm) & is_told, solver.candidates, solver.probability,
        None if keeps_distance else solver.is_crossed, solver.assumed_standoff_m, resolution_m, origin_m,
    )  # fmt: skip
    return Structure(
        router_m=router_m,
        walls=solver.count_walls(position_m, rssi_dbm),
        candidates=solver.candidates,
        probability=solver.probability,
        grid=grid,
        wall_loss_db=solver.mean_loss_db,
        explained=explained,
    )


def _check_grid(position_m: Array, router_m: Array | None, resolution_m: float) -> None:
    """Raise DataError if the grid around these positions would be too large."""
    if not 0.0 < float(real_array(resolution_m, "resolution_m")) < np.inf:
        raise DataError(f"resolution_m must be finite and above 0; got {resolution_m!r}")
    places_m = position_m if router_m is None else np.concatenate([position_m, router_m])
    if len(places_m):
        columns, rows = (np.ptp(places_m, axis=0) / resolution_m + 1).tolist()
        if columns * rows > GRID_CELLS_MAX:
            raise DataError(
                f"positions and routers span {columns:.0f} x {rows:.0f} cells of {resolution_m:g} m, more than "
                f"{GRID_CELLS_MAX}: check their unit, or use larger cells"
            )
