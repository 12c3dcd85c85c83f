"""Our pose-graph solver and `twc-env optimise` against gtsam's Levenberg-Marquardt on public graphs, in one run.

Rows that start at `odometry`: the solver alone. Both minimise the same squared errors from the same start;
`squared_error` uses our definition for both. Times are CPU seconds, the best of several alternating runs; `time_s` is
from arrays to poses, `optimise_s` excludes building gtsam's graph (ours needs no such step), `of_gtsam` is `time_s` as
a share of gtsam's. Where poses are equal and squared errors are not, gtsam measures a rotated residual's translation
along the arc.

Rows that start at `published`: every g2o file below posegraph in TWC_DATA, from the poses that it holds. What
`twc-env optimise` does with `--robust none` and `ours`, without reading; that includes the choice of a start, the
reason of every rejected closure, and the judgement whether the result is lost.

gtsam is a development extra: `pip install 'twc_env[crosscheck]'`.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import PoseGraphConfig
from twc_env.datasets.logs.pose_graph_file import read_pose_graph
from twc_env.errors import ConfigError
from twc_env.metrics import absolute_trajectory_error_m
from twc_env.records.planar_graph import PlanarGraph
from twc_env.reproduce.pose_graphs.robustness import DATASETS, dead_reckoning, read_graph
from twc_env.reproduce.runner import Runner, add_some, data_folder
from twc_env.running.options import count
from twc_env.slam.graph_optimisation.components import placed_poses
from twc_env.slam.graph_optimisation.whole_graph import optimise_graph
from twc_env.slam.pose_graph import solver as pose_graph
from twc_env.slam.pose_graph.solver import Graph

CHOOSES = ("datasets", "starts")
STARTS = ("odometry", "published")
Solver = Callable[[], tuple[Array, float, float]]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `twc-env reproduce solver`."""
    add_some(parser, "--datasets", DATASETS, "pose graphs that start at odometry")
    add_some(parser, "--starts", STARTS, "poses that the solvers start from")
    parser.add_argument("--repeats", type=count, default=5, help="alternating runs of each solver")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """Two rows per set, ours and gtsam's; three per file, two of `optimise` and gtsam's."""
    names = options.datasets if STARTS[0] in options.starts else []
    files = sorted((data_folder() / "posegraph").glob("*.g2o.gz")) if STARTS[1] in options.starts else []
    found = runner.each(names, lambda name: compare(name, options.repeats))
    found += runner.each(files, lambda file: compare_published(file, options.repeats), lambda file: file.name)
    return [row for rows in found for row in rows]


def compare(dataset: str, repeats: int) -> list[dict]:
    """Run both solvers on one set, from odometry."""
    graph = read_graph(data_folder() / "posegraph" / f"{DATASETS[dataset]}.g2o.gz")
    start = dead_reckoning(graph)
    solvers = {"ours": partial(solve_ours, start, graph), "gtsam": partial(solve_gtsam, start, graph)}
    return _compared(dataset, STARTS[0], solvers, graph, repeats)


def compare_published(file: Path, repeats: int) -> list[dict]:
    """Run `optimise` and gtsam on one file, from the poses in it."""
    planar = read_pose_graph(file)
    graph = Graph(planar.edges, planar.measured, planar.information, ~planar.is_odometry)
    solvers = {
        "optimise none": partial(solve_whole, planar, "none"),
        "optimise ours": partial(solve_whole, planar, "ours"),
        "gtsam": partial(solve_gtsam, placed_poses(planar), graph),
    }
    return _compared(file.name.removesuffix(".g2o.gz"), STARTS[1], solvers, graph, repeats)


def _compared(dataset: str, start: str, solvers: Mapping[str, Solver], graph: Graph, repeats: int) -> list[dict]:
    runs: dict[str, list[tuple[Array, float, float]]] = {name: [] for name in solvers}
    for name, solve in solvers.items():
        if name != "gtsam":
            solve()  # compiles
    for _ in range(repeats):
        for name, solve in solvers.items():
            runs[name].append(solve())
    best = min((run[0][0] for run in runs.values()), key=lambda poses: float(graph.squared_errors(poses).sum()))
    gtsam_s = min(whole for _, whole, _ in runs["gtsam"])
    return [
        {
            "dataset": dataset,
            "start": start,
            "solver": name,
            "poses": len(best),
            "edges": len(graph.edges),
            "squared_error": float(graph.squared_errors(run[0][0]).sum()),
            "from_best_m": absolute_trajectory_error_m(run[0][0], best),
            "time_s": min(whole for _, whole, _ in run),
            "optimise_s": min(alone for _, _, alone in run),
            "of_gtsam": min(whole for _, whole, _ in run) / gtsam_s,
            "repeats": repeats,
        }
        for name, run in runs.items()
    ]


def solve_ours(start: Array, graph: Graph) -> tuple[Array, float, float]:
    """Poses, and CPU seconds (twice, as `solve_gtsam`)."""
    config = PoseGraphConfig(robust="plain", iterations_max=100)
    return _timed(lambda: pose_graph.optimise(start, *graph.parts, config))


def solve_whole(graph: PlanarGraph, robust: str) -> tuple[Array, float, float]:
    """Poses by `twc-env optimise`, and CPU seconds (twice, as `solve_gtsam`)."""
    return _timed(lambda: optimise_graph(graph, robust).poses)


def _timed(solve: Callable[[], Array]) -> tuple[Array, float, float]:
    began = time.process_time()
    poses = solve()
    spent = time.process_time() - began
    return poses, spent, spent


def solve_gtsam(start: Array, graph: Graph) -> tuple[Array, float, float]:
    """Poses, and CPU seconds with and without building the graph. Raises ConfigError without gtsam."""
    try:
        import gtsam
    except ImportError:
        raise ConfigError("this table needs gtsam: pip install 'twc_env[crosscheck]'") from None
    began = time.process_time()
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    held = gtsam.noiseModel.Diagonal.Sigmas(np.full(3, 1e-6))
    factors.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(*start[0]), held))
    for (a, b), z, information in zip(graph.edges.tolist(), graph.measured, graph.information, strict=True):
        noise = gtsam.noiseModel.Gaussian.Information(information)
        factors.add(gtsam.BetweenFactorPose2(a, b, gtsam.Pose2(*z), noise))
    for node, pose in enumerate(start):
        values.insert(node, gtsam.Pose2(*pose))
    built = time.process_time()
    found = gtsam.LevenbergMarquardtOptimizer(factors, values).optimize()
    done = time.process_time()
    poses = np.array([[p.x(), p.y(), p.theta()] for p in map(found.atPose2, range(len(start)))])
    return poses, done - began, done - built
