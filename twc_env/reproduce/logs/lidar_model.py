"""The scanner model against real laser logs: five figures of each log and of its simulation, by the same estimators.

A plan is made of each log: short pieces follow the walls of the map of its scans. The scanner `lms-200`, with which
all these logs were recorded, is simulated at the poses of the log in that plan. So both have the same geometry, and
differ by what scanner, people, furniture and the poses of the log do.

- `residual`: robust standard deviation [m] of the distance of end points to lines through the end points of other
  scans, after each scan was aligned with these.
- `no return`: share of beams without return. Surfaces that never give one are not in the plan either.
- `off the map`: share of end points more than 0.3 m from every wall of the map, where that shows free floor.
- `off the map of a run`: the same with maps of 20 successive scans, in which walls of other passes do not lie askew.
- `change`: share of end points at places that the scan before saw as free, by 0.3 m or more.

`real_low` and `real_high` are a 95 % interval of the real figure, by a bootstrap over blocks of 20 scans. `dark_share`
was chosen on the logs marked calibrated; all other settings are those of the data sheet. Rows `, ideal` tell what a
scanner without errors has in the same plans, whose walls keep some of the noise and of the gaps of the log. Poses are
those of the logs, with their errors. Rows `, poses moved` tell what they do: there each scan is simulated at the pose
to which the log's own scan is moved by matching it to the scans around. Matching errs, too, so of the real figure these
rows explain at most as much as they show. Nobody walks in the simulation.
"""

from __future__ import annotations

import argparse
import hashlib
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray as Array
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from twc_env.config import EnvConfig, lidar_preset, override
from twc_env.datasets.logs.scan_log import NO_RETURN_M, ScanLog, apart, onto_circle
from twc_env.records.geometry import between, transform_points
from twc_env.reproduce.logs.laser_logs import corrected_log
from twc_env.reproduce.runner import Runner, add_some
from twc_env.running.options import count
from twc_env.slam.matching.scan_matching import LineField
from twc_env.slam.scans.occupancy_grid import OccupancyGrid
from twc_env.world.building.floorplan import Floorplan
from twc_env.world.sensors.scanners import Scanners

CHOOSES = ("logs",)
ROLES = {
    "intel": "calibrated",
    "freiburg-079": "calibrated",
    "aces": "reported",
    "freiburg-101": "reported",
    "orebro": "reported",
}
CALIBRATED = {"dark_share": 0.05}
"""Settings of the scanner that replace those of the preset: a data sheet knows no share of dark surfaces."""
IDEAL = {"detection_range_m": 0.0, "range_noise_std_m": 0.0, "beam_divergence_rad": 0.0}
"""Those of a scanner without errors."""
SPACING_M, SPACING_RAD = 0.3, 0.3
"""Scans nearer to the one before are left out: those of `freiburg-079` are 0.1 m apart, of the others 1 m."""
FAR_M = 15.0
"""End points further away are not compared with the map: errors of the poses' headings displace them."""
OFF_M = 0.3
CELL_M = 0.1
NEIGHBOURS = 8
"""End points of other scans that make a line."""
LINE_REACH_M, LINE_THICK_M = 0.25, 0.1
"""Their greatest distance, and the greatest standard deviation across a line."""
AROUND = 6
"""Scans before and after one that make its map."""
PIECE_M, PIECE_REACH_M = 0.16, 0.8
"""Least length of a piece of wall, and the greatest distance of the end points that make it."""
BLOCK, DRAWS = 20, 1000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the table."""
    add_some(parser, "--logs", ROLES, "logs")
    parser.add_argument("--scans", type=count, default=400, help="most scans of each log, from its begin")
    parser.add_argument("--seed", type=int, default=0, help="seed of the simulated scanner and of the bootstrap")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """{quantity, dataset, role, real, simulated, real_low, real_high} for each figure of each log."""
    names = options.logs
    settings = hashlib.sha256(repr((lidar_preset("lms-200"), CALIBRATED)).encode()).hexdigest()[:8]
    found = runner.each(
        names,
        lambda name: _figures(corrected_log(name), options.scans, options.seed),
        lambda name: f"{name} {settings}",
    )
    return [
        {"quantity": quantity, "dataset": name, "role": ROLES[name], **row}
        for name, figures in zip(names, found, strict=True)
        for quantity, row in figures.items()
    ]


def _figures(log: ScanLog, scans_max: int, seed: int) -> dict[str, dict]:
    """Figures of one log and of its simulation."""
    kept = apart(log.poses, SPACING_M, SPACING_RAD)[:scans_max]
    poses, angles_rad = log.poses[kept], log.beams_of(0)
    real_m = np.where((log.ranges_m[kept] > 0.0) & (log.ranges_m[kept] < NO_RETURN_M), log.ranges_m[kept], np.inf)
    plan = plan_of(real_m, angles_rad, poses)
    simulated_m = simulated(plan, angles_rad, poses, seed)
    moved = [_aligned(real_m, angles_rad, poses, k, _around(k, len(poses))) for k in range(len(poses))]
    others = {
        "ideal": simulated(plan, angles_rad, poses, seed, IDEAL),
        "poses moved": simulated(plan, angles_rad, np.array(moved), seed),
    }
    figures: dict[str, dict] = {}
    for quantity, measure in MEASURES.items():
        real, model = (measure(ranges_m, angles_rad, poses) for ranges_m in (real_m, simulated_m))
        summary = _robust_std if quantity == "residual" else _share
        low, high = interval(real, summary, seed)
        figures[quantity] = {"real": summary(real), "simulated": summary(model), "real_low": low, "real_high": high}
    for quantity, measure in MEASURES.items():
        summary = _robust_std if quantity == "residual" else _share
        for name, scans_m in others.items():
            figures[f"{quantity}, {name}"] = {
                "real": None, "simulated": summary(measure(scans_m, angles_rad, poses)), "real_low": None,
                "real_high": None,
            }  # fmt: skip
    return figures


def ends_of(ranges_m: Array, angles_rad: Array, pose: Array, far_m: float = FAR_M) -> Array:
    """(n, 2) end points of one scan (beams,) in the map's frame, up to a range."""
    is_met = ranges_m <= far_m
    r, a = ranges_m[is_met], angles_rad[is_met]
    return transform_points(pose, np.column_stack([r * np.cos(a), r * np.sin(a)]))


def plan_of(scans_m: Array, angles_rad: Array, poses: Array) -> Floorplan:
    """Walls of short pieces along the lines on which neighbouring end points lie, one for each cell with some."""
    points = [ends_of(scan, angles_rad, pose, NO_RETURN_M) for scan, pose in zip(scans_m, poses, strict=True)]
    cloud = np.concatenate(points)
    cloud = cloud[_map_of(scans_m, angles_rad, poses).level_at(cloud) > 0]
    _, of_cell, counts = np.unique(np.floor(cloud / CELL_M), axis=0, return_inverse=True, return_counts=True)
    sums = np.column_stack([np.bincount(of_cell.ravel(), cloud[:, axis]) for axis in (0, 1)])
    middles = sums / counts[:, None]
    apart, nearest = cKDTree(cloud).query(middles, NEIGHBOURS, distance_upper_bound=PIECE_REACH_M)
    pieces = []
    for middle, near in zip(middles, (row[far < np.inf] for row, far in zip(nearest, apart, strict=True)), strict=True):
        if len(near) < 3:
            continue
        centre = cloud[near].mean(axis=0)
        away = cloud[near] - centre
        variances, axes = np.linalg.eigh(away.T @ away / len(near))
        if variances[0] > LINE_THICK_M**2:
            continue
        along = axes[:, 1]
        here, others = (middle - centre) @ along, np.sort(away @ along)
        ahead = others[others > here + 0.5 * PIECE_M][:1]  # to the next end point, which may be some way off
        behind = others[others < here - 0.5 * PIECE_M][-1:]
        low, high = min([here - 0.5 * PIECE_M, *behind]), max([here + 0.5 * PIECE_M, *ahead])
        pieces.append([centre + low * along, centre + high * along])
    return Floorplan("log", np.array(pieces), np.zeros(len(pieces)))


def simulated(plan: Floorplan, angles_rad: Array, poses: Array, seed: int, changes: dict | None = None) -> Array:
    """Scans (scans, beams) of the preset `lms-200` at these poses, infinite without return.

    changes: other settings of the scanner. Where a log has two beams per degree, so has the scanner.
    """
    settings = {
        "lidar.preset": "lms-200",
        "lidar.beam_count": len(angles_rad),
        "lidar.field_of_view_rad": float(angles_rad[-1] - angles_rad[0]),
        "lidar.mount_yaw_rad": float(0.5 * (angles_rad[-1] + angles_rad[0])),
        "lidar.is_rolling": False,
        "lidar.rate_hz": 0.0,
        **{f"lidar.{key}": value for key, value in {**CALIBRATED, **(changes or {})}.items()},
    }
    scanner = Scanners(override(EnvConfig(robots=1), settings), plan, seed)
    scans_m = np.concatenate([scanner.scan(k, pose[None])[0] for k, pose in enumerate(poses)])
    return np.where(scans_m < scanner.scanner.range_max_m, scans_m, np.inf)


# --- estimators: one array per scan, over its beams


def no_return(scans_m: Array, angles_rad: Array, poses: Array) -> list[Array]:
    """Whether each beam has no return."""
    return list(~np.isfinite(scans_m))


def residuals_m(scans_m: Array, angles_rad: Array, poses: Array) -> list[Array]:
    """Signed distances of end points to lines through those of the scans around, after alignment with these."""
    found = []
    for k in range(len(scans_m)):
        around = _around(k, len(scans_m))
        cloud = np.concatenate([ends_of(scans_m[j], angles_rad, poses[j]) for j in around])
        pose = _aligned(scans_m, angles_rad, poses, k, around)
        ends = ends_of(scans_m[k], angles_rad, pose)
        if len(cloud) < NEIGHBOURS or not len(ends):
            found.append(np.zeros(0))
            continue
        apart, near = cKDTree(cloud).query(ends, NEIGHBOURS)
        is_near = apart[:, -1] < LINE_REACH_M
        ends, near = ends[is_near], near[is_near]
        middle = cloud[near].mean(axis=1)
        away = cloud[near] - middle[:, None]
        variances, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", away, away) / NEIGHBOURS)
        across = np.einsum("ni,ni->n", ends - middle, axes[:, :, 0])
        # A line through 8 points has an error of its own, of about a third of a point's.
        found.append(across[(variances[:, 0] < LINE_THICK_M**2) & (variances[:, 1] > 4 * variances[:, 0])])
    return found


def _around(k: int, count: int) -> list[int]:
    """The scans before and after scan k, of `count`, that make its map."""
    return [j for j in range(max(k - AROUND, 0), min(k + AROUND + 1, count)) if j != k]


def _aligned(scans_m: Array, angles_rad: Array, poses: Array, k: int, around: list[int]) -> Array:
    """The pose of scan k after matching it to the walls that the scans around show."""
    field = LineField(2 * FAR_M + 10.0, CELL_M, NO_RETURN_M)
    field.reset(poses[k, :2])
    field.add(poses[around], np.array([_circle(scans_m[j], angles_rad) for j in around]))
    ends = ends_of(scans_m[k], angles_rad, np.zeros(3))
    return field.refine(ends, poses[k].copy(), 0.3, 20, 0.02).pose if len(ends) > 10 else poses[k]


def off_map(scans_m: Array, angles_rad: Array, poses: Array) -> list[Array]:
    """Whether each end point lies on free floor of the map of all scans, away from every wall."""
    grid = _map_of(scans_m, angles_rad, poses)
    away_m = distance_transform_edt(grid.log_odds <= 0) * grid.resolution_m
    found = []
    for scan, pose in zip(scans_m, poses, strict=True):
        ends = ends_of(scan, angles_rad, pose)
        rows, columns = np.clip(grid.cell_of(ends), 0, np.array(away_m.shape) - 1).T
        found.append((away_m[rows, columns] > OFF_M) & (grid.level_at(ends) < 0))
    return found


def off_run(scans_m: Array, angles_rad: Array, poses: Array) -> list[Array]:
    """`off_map` of the map of each run of `BLOCK` scans: poses of other passes do not count."""
    runs = [slice(k, k + BLOCK) for k in range(0, len(scans_m), BLOCK)]
    return [each for run in runs for each in off_map(scans_m[run], angles_rad, poses[run])]


def changed(scans_m: Array, angles_rad: Array, poses: Array) -> list[Array]:
    """Whether each end point that is in view of the scan before lies in what that saw as free."""
    step_rad, found = float(np.median(np.diff(angles_rad))), []
    for k in range(1, len(scans_m)):
        ends = ends_of(scans_m[k], angles_rad, between(poses[k - 1], poses[k]))
        beam = (np.arctan2(ends[:, 1], ends[:, 0]) - angles_rad[0]) / step_rad
        ends, beam = (
            ends[(beam >= 1) & (beam <= len(angles_rad) - 2)],
            beam[(beam >= 1) & (beam <= len(angles_rad) - 2)],
        )
        low = np.floor(beam).astype(int)
        free_m = np.minimum(scans_m[k - 1][low], scans_m[k - 1][np.minimum(low + 1, len(angles_rad) - 1)])
        is_known = np.isfinite(free_m)
        found.append((np.hypot(*ends.T) < free_m - OFF_M)[is_known])
    return found


MEASURES: dict[str, Callable[[Array, Array, Array], list[Array]]] = {
    "residual": residuals_m,
    "no return": no_return,
    "off the map": off_map,
    "off the map of a run": off_run,
    "change": changed,
}


def _circle(scan_m: Array, angles_rad: Array) -> Array:
    return onto_circle(scan_m, angles_rad, 360, NO_RETURN_M)


def _map_of(scans_m: Array, angles_rad: Array, poses: Array):
    grid = OccupancyGrid(CELL_M, NO_RETURN_M, 360)
    grid.integrate(poses, np.array([_circle(scan, angles_rad) for scan in scans_m]))
    return grid.snapshot()


def _share(values: list[Array]) -> float:
    return float(np.concatenate(values).mean())


def _robust_std(values: list[Array]) -> float:
    """Of a normal distribution with the same median of absolute values."""
    return float(1.4826 * np.median(np.abs(np.concatenate(values))))


def interval(values: list[Array], summary: Callable[[list[Array]], float], seed: int) -> tuple[float, float]:
    """Central 95 % of a summary under a bootstrap over blocks of consecutive scans."""
    random = np.random.default_rng(seed)
    blocks = [np.concatenate(values[k : k + BLOCK]) for k in range(0, len(values), BLOCK)]
    drawn = [summary([blocks[b] for b in random.integers(0, len(blocks), len(blocks))]) for _ in range(DRAWS)]
    return float(np.quantile(drawn, 0.025)), float(np.quantile(drawn, 0.975))
