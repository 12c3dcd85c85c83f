"""Our pose-graph solver against gtsam's Levenberg-Marquardt on public graphs from raw odometry, in one run.

Both minimise the same squared errors from the same start; `squared_error` uses our definition for both. Times are CPU
seconds, the best of several alternating runs; `time_s` is from arrays to poses, `optimise_s` excludes building gtsam's
graph (ours needs no such step). Where poses are equal and squared errors are not, gtsam measures a rotated residual's
translation along the arc. gtsam is a development extra: `pip install 'twc_env[crosscheck]'`.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import PoseGraphConfig
from twc_env.errors import ConfigError
from twc_env.metrics import absolute_trajectory_error_m
from twc_env.reproduce.pose_graphs.robustness import DATASETS, dead_reckoning, read_graph
from twc_env.reproduce.runner import Runner, add_some, data_folder
from twc_env.running.options import count
from twc_env.slam.pose_graph import solver as pose_graph
from twc_env.slam.pose_graph.solver import Graph

CHOOSES = ("datasets",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `twc-env reproduce solver`."""
    add_some(parser, "--datasets", DATASETS, "pose graphs")
    parser.add_argument("--repeats", type=count, default=5, help="alternating runs of each solver")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """Two rows per set: ours and gtsam's."""
    pairs = runner.each(options.datasets, lambda name: compare(name, options.repeats))
    return [row for pair in pairs for row in pair]


def compare(dataset: str, repeats: int) -> list[dict]:
    """Run both solvers on one set."""
    graph = read_graph(data_folder() / "posegraph" / f"{DATASETS[dataset]}.g2o.gz")
    start = dead_reckoning(graph)
    solvers = {"ours": solve_ours, "gtsam": solve_gtsam}
    runs: dict[str, list[tuple[Array, float, float]]] = {name: [] for name in solvers}
    solve_ours(start, graph)  # compiles
    for _ in range(repeats):
        for name, solve in solvers.items():
            runs[name].append(solve(start, graph))
    best = min((run[0][0] for run in runs.values()), key=lambda poses: float(graph.squared_errors(poses).sum()))
    return [
        {
            "dataset": dataset,
            "solver": name,
            "poses": len(start),
            "edges": len(graph.edges),
            "squared_error": float(graph.squared_errors(run[0][0]).sum()),
            "from_best_m": absolute_trajectory_error_m(run[0][0], best),
            "time_s": min(whole for _, whole, _ in run),
            "optimise_s": min(alone for _, _, alone in run),
            "repeats": repeats,
        }
        for name, run in runs.items()
    ]


def solve_ours(start: Array, graph: Graph) -> tuple[Array, float, float]:
    """Poses, and CPU seconds (twice, as `solve_gtsam`)."""
    config = PoseGraphConfig(robust="plain", iterations_max=100)
    began = time.process_time()
    poses = pose_graph.optimise(start, *graph.parts, config)
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
