"""Robustness of the back ends: false closures are added to public pose graphs, which start from raw odometry.

False closures are `random` (two uniformly drawn poses, declared to be at nearly the same place: standard deviations 1
m, 0.3 rad) or `grouped` (twenty consecutive ones that agree with each other: one stretch of the path is declared to run
along another). Each is wrong by more than 0.5 m or 10 degrees, and by more than its stated noise explains (chi squared,
99.9 %). The share refers to all closures. Results are means over seeds: position error after alignment to the clean
optimum, and precision and recall of the accepted closures. The clean optimum is the fit to the true edges with the
lowest error found from odometry and from `ours`: MIT has a far better one than is reached from its odometry. `lost`
counts the seeds of which the result of `ours` says that it cannot be trusted (`slam/graph_optimisation/trust.py`),
`silent` those that are off by more than 1 % of the map's diagonal without saying so. Times are CPU
seconds. `ours` is evaluated over six seeds (ten take 12 minutes on two cores), the others over the first of them unless
`--other-seeds` asks for more.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.config import PoseGraphConfig
from twc_env.datasets.logs.pose_graph_file import read_pose_graph
from twc_env.errors import ConfigError, DataError
from twc_env.metrics import absolute_trajectory_error_m
from twc_env.records.geometry import between, compose, inverse, poses_along
from twc_env.reproduce.runner import Runner, add_seeds, add_some, data_folder, seeds_argument
from twc_env.running.options import count
from twc_env.slam.graph_optimisation.trust import trust_in
from twc_env.slam.pose_graph import robust_back_end as robust_backend
from twc_env.slam.pose_graph.solver import Graph

CHOOSES = ("seeds", "other_seeds", "datasets", "shares", "methods")
DATASETS = {"intel": "intel", "MIT": "MIT", "M3500": "manhattan", "ringCity": "ringCity"}
METHODS = ("plain", "cauchy", "dcs", "gnc", "pcm", "ours")
KINDS = ("random", "grouped")
WRONG_M, WRONG_RAD, WRONG_SQUARED = 0.5, math.radians(10.0), 16.27
"""A false closure exceeds one of the first two, and chi squared at 99.9 %."""
ITERATIONS_MAX = {"plain": 10, "cauchy": 10}
"""Maximum iterations; the default is 100. These two keep all false closures, which makes their equations dense."""
GROUP = 20
"""Number of consecutive false closures in a group."""
RANDOM_STD = np.array([1.0, 1.0, 0.3])
GROUP_STD, MEMBER_STD = np.array([0.3, 0.3, 0.1]), np.array([0.05, 0.05, 0.02])
SILENT_SHARE = 0.01
"""Larger errors, as a share of the map's diagonal, must be reported as lost."""
SEPARATION_STEPS = {"random": 20, "grouped": 40}


@dataclass(frozen=True)
class Case:
    """One pose graph with false closures, to be solved by one method."""

    dataset: str
    kind: str
    share: float
    method: str
    seed: int

    def __str__(self) -> str:
        return f"{self.dataset} {self.kind} {self.share:g} {self.method} seed {self.seed}"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `twc-env reproduce robustness`."""
    add_seeds(parser, "0-5", "seeds for `ours`")
    parser.add_argument("--other-seeds", type=seeds_argument, default="0", help="seeds for the other methods")
    add_some(parser, "--datasets", DATASETS, "pose graphs")
    parser.add_argument("--shares", default="0,0.2,0.5,0.8", help="shares of false closures")
    parser.add_argument("--jobs", type=count, default=2, help="parallel processes")
    add_some(parser, "--methods", METHODS, "methods")


def rows(options: argparse.Namespace, runner: Runner) -> list[dict]:
    """One row per set, kind, share and method; means over the seeds, and the worst error."""
    shares, methods = _shares(options.shares), options.methods
    folder = data_folder() / "posegraph"
    seeds = dict.fromkeys(methods, options.other_seeds) | {"ours": options.seeds}
    cases = [
        Case(dataset, kind, share, method, seed)
        for dataset in options.datasets
        for share in shares
        for kind in (KINDS if share else ("none",))
        for method in methods
        for seed in (seeds[method] if share else seeds[method][:1])
    ]
    results = runner.each(cases, partial(run_case, folder=folder), processes=options.jobs)
    table: dict[tuple, list[dict]] = {}
    for case, result in zip(cases, results, strict=True):
        table.setdefault((case.dataset, case.kind, case.share, case.method), []).append(result)
    return [_row(key, parts) for key, parts in table.items()]


def run_case(case: Case, folder: Path) -> dict:
    """Error, precision, recall and time of one case."""
    start, clean, best = clean_graph(folder, case.dataset)
    graph, is_true = corrupt(clean, best, case.kind, case.share, case.seed)
    config = PoseGraphConfig(robust=case.method, iterations_max=ITERATIONS_MAX.get(case.method, 100))
    began = time.process_time()
    result = robust_backend.solve(start, *graph.parts, config)
    elapsed = time.process_time() - began
    believed = result.accepted & graph.is_closure
    right = int(np.count_nonzero(believed & is_true))
    ate_m = absolute_trajectory_error_m(result.poses, best)
    is_lost = trust_in(graph, result).is_lost if case.method == "ours" else None
    is_off = ate_m > SILENT_SHARE * float(np.hypot(*np.ptp(best[:, :2], axis=0)))
    return {
        "ate_m": ate_m,
        "lost": is_lost,
        "silent": None if is_lost is None else is_off and not is_lost,
        "precision": right / max(int(np.count_nonzero(believed)), 1),
        "recall": right / int(np.count_nonzero(graph.is_closure & is_true)),
        "time_s": elapsed,
    }


def corrupt(graph: Graph, best: Array, kind: str, share: float, seed: int) -> tuple[Graph, Array]:
    """The graph with false closures as `share` of all closures, and which edges (e,) are true."""
    true_count = int(graph.is_closure.sum())
    count = round(true_count * share / (1 - share))
    information = np.median(graph.information[graph.is_closure], axis=0)
    random = np.random.default_rng([seed, KINDS.index(kind) if kind in KINDS else 9])
    pairs: list[tuple[int, int]] = []
    claims: list[Array] = []
    while len(pairs) < count:
        ends, claimed = _draw(kind, best, random)
        truth = between(best[ends[:, 0]], best[ends[:, 1]])
        if _are_wrong(between(truth, claimed), information):
            pairs += [(int(a), int(b)) for a, b in ends]
            claims += list(claimed)
    edges = np.array(pairs[:count], np.int64).reshape(-1, 2)
    together = Graph(
        np.concatenate([graph.edges, edges]),
        np.concatenate([graph.measured, np.array(claims[:count]).reshape(-1, 3)]),
        np.concatenate([graph.information, np.tile(information, (count, 1, 1))]),
        np.concatenate([graph.is_closure, np.ones(count, bool)]),
    )
    return together, np.arange(len(together.edges)) < len(graph.edges)


def _draw(kind: str, best: Array, random: np.random.Generator) -> tuple[Array, Array]:
    """Ends (k, 2) and claimed relative poses (k, 3) of one false closure or group."""
    length = 1 if kind == "random" else min(GROUP, len(best) // 4)
    apart = min(SEPARATION_STEPS[kind], len(best) // 3)
    a = b = 0
    while b - a < apart:
        ends = random.choice(len(best) - length + 1, 2, replace=False)
        a, b = int(ends.min()), int(ends.max())
    steps = np.arange(length)
    if length == 1:
        return np.array([[a, b]]), random.normal(0.0, RANDOM_STD, (1, 3))
    moved = compose(compose(best[a], random.normal(0.0, GROUP_STD)), inverse(best[b]))
    claimed = between(best[a + steps], compose(moved, best[b + steps]))
    return np.stack([a + steps, b + steps], axis=1), compose(claimed, random.normal(0.0, MEMBER_STD, (length, 3)))


def _are_wrong(error: Array, information: Array) -> bool:
    far = (np.hypot(error[:, 0], error[:, 1]) > WRONG_M) | (np.abs(error[:, 2]) > WRONG_RAD)
    return bool((far & (np.einsum("ki,ij,kj->k", error, information, error) > WRONG_SQUARED)).all())


@cache
def clean_graph(folder: Path, dataset: str) -> tuple[Array, Graph, Array]:
    """Poses from odometry only, the graph without false closures, and its optimum. dataset: one of DATASETS, or the
    name of another file."""
    graph = read_graph(folder / f"{DATASETS.get(dataset, dataset)}.g2o.gz")
    start = dead_reckoning(graph)
    config = PoseGraphConfig(robust="plain", iterations_max=100)
    grown = robust_backend.solve(start, *graph.parts, PoseGraphConfig(robust="ours")).poses
    fits = [robust_backend.solve(begin, *graph.parts, config).poses for begin in (start, grown)]
    return start, graph, min(fits, key=lambda poses: float(graph.squared_errors(poses).sum()))


def read_graph(path: Path) -> Graph:
    """The graph of a g2o file; edges between consecutive vertices are odometry."""
    read = read_pose_graph(path, turns=False)
    return Graph(read.edges, read.measured, read.information, read.edges[:, 1] != read.edges[:, 0] + 1)


def dead_reckoning(graph: Graph) -> Array:
    """(n, 3) poses along the odometry."""
    steps = {int(a): k for k, (a, _) in enumerate(graph.edges) if not graph.is_closure[k]}
    for node in range(int(graph.edges.max())):
        if node not in steps:
            raise DataError(f"the pose graph has no odometry from vertex {node} to {node + 1}; it must be one chain")
    return poses_along(graph.measured[[steps[node] for node in sorted(steps)]])


def _row(key: tuple, parts: list[dict]) -> dict:
    dataset, kind, share, method = key
    means = {
        name: sum(part[name] for part in parts) / len(parts) for name in ("ate_m", "precision", "recall", "time_s")
    }
    lost, silent = ([part[name] for part in parts if part[name] is not None] for name in ("lost", "silent"))
    return {
        "dataset": dataset,
        "false_kind": kind,
        "false_share": share,
        "method": method,
        "ate_m": means["ate_m"],
        "ate_worst_m": max(part["ate_m"] for part in parts),
        "lost": sum(lost) if lost else None,
        "silent": sum(silent) if silent else None,
        "precision": means["precision"],
        "recall": means["recall"],
        "time_s": means["time_s"],
        "seeds": len(parts),
    }


def _shares(text: str) -> list[float]:
    try:
        shares = [float(word) for word in text.split(",") if word]
    except ValueError:
        shares = []
    if not shares:
        raise ConfigError(f"--shares takes numbers like 0,0.5; got {text!r}")
    for share in shares:
        if not 0.0 <= share < 1.0:
            raise ConfigError(f"a share of false closures lies in 0..1 (without 1); got {share:g}")
    return shares
