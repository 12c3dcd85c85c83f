"""Structure from WiFi: a map of walls from signal strength along a path (inverse k-visibility, K1-K18), our way.

The signal model gives a first count of walls per reading (`k_visibility_signal`). A path along walls offers pieces
where walls may stand (`wall_candidates`); sampling all pieces against all rays of all routers at once tells which are
walls (`wall_sampler`). Power, path loss and the loss of every straight stretch of wall are estimated along with them
(`wall_solver`). Where exactly the number of walls changes along the path, the readings settle (`change_points`).

A path that crosses itself again and again follows no walls: with several routers they are then sought on lattices
(`lattice_solver`), and what several of these say, each laid elsewhere, is averaged.

The result is a grid of probabilities in which what no ray and no step has touched stays unknown.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from twc_env.errors import DataError
from twc_env.slam.given_arrays import given_points
from twc_env.slam.k_visibility_grid import WallGrid, cell_probabilities
from twc_env.slam.k_visibility_signal import SignalFit, fit_signal, locate_router, typical_signal
from twc_env.slam.lattice_solver import LatticeSolver
from twc_env.slam.path_bins import PathBins, bin_along_path
from twc_env.slam.wall_candidates import wall_candidates
from twc_env.slam.wall_lattice import wall_lattice
from twc_env.slam.wall_sampler import crossings
from twc_env.slam.wall_solver import WallSolver

Array = NDArray

STANDOFF_M = 0.3
"""First guess of how far walls are from the path; the walls between two tracks correct it."""
_TRIES = (0, 1, None)
"""Annealing can end in a poor optimum: it is tried with walls right of the path alone, left alone and on both sides,
before all are let in, and from the signal as fitted as from a typical one; the best result counts."""
_STANDOFF_SPREAD_MAX_M = 0.05
"""With a larger spread the path does not keep its distance: walls that no ray has crossed are then left unknown."""
_FREE_CROSSINGS_PER_M = 0.2
"""A path that crosses itself more often goes through rooms freely. Along walls it is at most
0.07, on long drives from 1.8 on."""
_OWN_WAY_M, _CROSSING_SINE = 1.0, 0.3
"""It crosses itself where it comes back after this length at least, at an angle of this sine or more."""
_LATTICES, _LATTICE_ROUTERS_MIN = 4, 2
"""With one router rays hardly cross, and lattices tell no more than the pieces beside the path do."""
GRID_CELLS_MAX = 25_000_000
_BINS, _BIN_RANGE_M = 1000, (0.1, 0.3)
"""A long path is cut into so many bins, of a length in this range: readings nearer than that tell the same."""


@dataclass(frozen=True, slots=True, eq=False)
class Structure:
    """What signal strength along one path says about the building."""

    router_m: Array
    """(routers, 2) given or estimated."""
    walls: Array
    """(readings, routers) number of walls between each router and each reading, the most probable."""
    wall_probability: Array
    """(bins, routers, k + 1) of each number, per bin of the path."""
    bins: PathBins
    pieces_m: Array
    """(pieces, 4) x1, y1, x2, y2 of where walls were sought."""
    probability: Array
    """(pieces,) that each is a wall."""
    grid: WallGrid
    wall_loss_db: float
    power_dbm: Array
    """(routers,) at one metre."""
    exponent: Array
    """(routers,)."""
    noise_db: float
    standoff_m: float
    """Between path and walls; 0 where they were sought anywhere."""


def map_structure(
    position_m: Array,
    rssi_dbm: Array,
    router_m: Array | None = None,
    resolution_m: float = 0.1,
    standoff_m: float | None = None,
    seed: int = 0,
    origin_m: Array | None = None,
) -> Structure:
    """Map walls from readings (n, routers) [dBm], NaN where not heard, taken in order at positions (n, 2).

    Routers (routers, 2) that are not given are located first. `standoff_m` None: estimated from the walls found, and
    where the path crosses itself again and again and there are several routers, walls are sought anywhere.
    A corner of some cell of the grid comes to lie at origin_m (2,). Raises DataError for what does not fit together,
    and for places so far apart that the grid would have more than GRID_CELLS_MAX cells.
    """
    position_m = given_points(position_m, "positions")
    if router_m is not None:
        router_m = given_points(router_m, "places of routers")
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
    at = _Readings(position_m, np.asarray(rssi_dbm, float), router_m, bins, fits)
    if standoff_m is None and count >= _LATTICE_ROUTERS_MIN and _crossings_per_m(bins) > _FREE_CROSSINGS_PER_M:
        return _map_on_lattices(at, resolution_m, seed, origin_m)
    return _map_along_walls(at, resolution_m, standoff_m, seed, origin_m)


@dataclass(frozen=True, slots=True, eq=False)
class _Readings:
    """What is mapped."""

    position_m: Array
    rssi_dbm: Array
    router_m: Array
    bins: PathBins
    fits: list[SignalFit]


def _map_along_walls(
    at: _Readings, resolution_m: float, standoff_m: float | None, seed: int, origin_m: Array | None
) -> Structure:
    """Walls beside a path that keeps its distance from them."""
    bins, router_m = at.bins, at.router_m
    typical = [typical_signal(bins, r, place) for r, place in enumerate(router_m)]
    standoff = STANDOFF_M if standoff_m is None else standoff_m
    tries = []
    for _ in range(1 if standoff_m is not None else 3):
        candidates = wall_candidates(bins.position_m, standoff)
        for start, barred in [(at.fits, side) for side in _TRIES] + [(typical, side) for side in _TRIES[:2]]:
            solver = WallSolver(bins, router_m, start, candidates, standoff, seed)
            solver.solve(barred)
            tries.append(solver)
        solver = min(tries, key=lambda solver: solver.energy)
        standoff, seen = solver.assumed_standoff_m, solver.standoff_m()
        if standoff_m is not None or seen is None or abs(seen - standoff) < 0.01:
            break
        standoff = seen
    standoff = solver.assumed_standoff_m
    probability = solver.probability
    keeps_distance = solver.standoff_spread_m() <= _STANDOFF_SPREAD_MAX_M
    grid = cell_probabilities(
        bins.position_m, router_m, np.isfinite(bins.rssi_dbm), solver.candidates.ends_m, probability[None],
        None if keeps_distance else solver.is_told, standoff, resolution_m, origin_m,
    )  # fmt: skip
    return Structure(
        router_m=router_m,
        walls=solver.count_walls(at.position_m, at.rssi_dbm),
        wall_probability=solver.count_probability(),
        bins=bins,
        pieces_m=solver.candidates.ends_m,
        probability=probability,
        grid=grid,
        wall_loss_db=solver.mean_loss_db,
        power_dbm=solver.power_dbm,
        exponent=solver.exponent,
        noise_db=float(np.sqrt(solver.variance_db2)),
        standoff_m=standoff,
    )


def _map_on_lattices(at: _Readings, resolution_m: float, seed: int, origin_m: Array | None) -> Structure:
    """Walls anywhere: what lattices, each laid elsewhere, say on average."""
    bins, solvers = at.bins, []
    for number in range(_LATTICES):
        random = np.random.default_rng([seed, number])
        lattice = wall_lattice(at.position_m, at.router_m, random.random(2))
        solvers.append(LatticeSolver(at.position_m, at.rssi_dbm, at.router_m, lattice, random))
        solvers[-1].solve()
    by_reading = np.mean([solver.count_probability() for solver in solvers], axis=0)
    by_bin = np.zeros((len(bins.position_m), *by_reading.shape[1:]))
    np.add.at(by_bin, bins.bin_of, by_reading)
    pieces_m = np.concatenate([solver.lattice.ends_m for solver in solvers])
    probability = block_diag(*(solver.probability for solver in solvers))  # (lattices, pieces of all)
    grid = cell_probabilities(
        bins.position_m, at.router_m, np.isfinite(bins.rssi_dbm), pieces_m, probability,
        np.concatenate([solver.is_told for solver in solvers]), 0.0, resolution_m, origin_m,
    )  # fmt: skip
    return Structure(
        router_m=at.router_m,
        walls=np.argmax(by_reading, axis=2),
        wall_probability=by_bin / np.bincount(bins.bin_of)[:, None, None],
        bins=bins,
        pieces_m=pieces_m,
        probability=probability.max(axis=0),
        grid=grid,
        wall_loss_db=float(np.mean([solver.wall_loss_db for solver in solvers])),
        power_dbm=np.mean([solver.power_dbm for solver in solvers], axis=0),
        exponent=np.full(len(at.router_m), np.mean([solver.exponent for solver in solvers])),
        noise_db=float(np.mean([solver.noise_db for solver in solvers])),
        standoff_m=0.0,
    )


def _crossings_per_m(bins: PathBins) -> float:
    """How often the path crosses itself."""
    near, far = bins.position_m[:-1], bins.position_m[1:]
    first, other = crossings(np.hstack([near, far]), near, far)
    own = np.repeat(np.arange(len(near)), np.diff(first))
    step, length_m = far - near, np.linalg.norm(far - near, axis=1)
    across = np.abs(step[own, 0] * step[other, 1] - step[own, 1] * step[other, 0])
    is_crossed = (across > _CROSSING_SINE * length_m[own] * length_m[other]) & (
        np.abs(bins.travel_m[own] - bins.travel_m[other]) > _OWN_WAY_M
    )
    return float(is_crossed.sum() / 2 / max(bins.travel_m[-1], 1e-9))


def _check_grid(position_m: Array, router_m: Array | None, resolution_m: float) -> None:
    """Raise DataError for a grid around these places that cannot be meant."""
    if not resolution_m > 0.0:
        raise DataError(f"resolution_m must be above 0; got {resolution_m!r}")
    places_m = position_m if router_m is None else np.concatenate([position_m, router_m])
    if len(places_m):
        columns, rows = (np.ptp(places_m, axis=0) / resolution_m + 1).tolist()
        if columns * rows > GRID_CELLS_MAX:
            raise DataError(
                f"positions and routers span {columns:.0f} x {rows:.0f} cells of {resolution_m:g} m, more than "
                f"{GRID_CELLS_MAX}: check their unit, or use larger cells"
            )
