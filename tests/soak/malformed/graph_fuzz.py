"""Malformed and unusual pose graphs: reading and optimising one may only raise DataError, and ends finite."""

from __future__ import annotations

import gzip
import math
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from tests.soak.attempts import Attempt, workplace
from tests.soak.malformed.mutations import OF_TEXT, mutated
from twc_env.datasets.logs.pose_graph_file import read_pose_graph, write_pose_graph
from twc_env.records.geometry import between
from twc_env.records.random_streams import random_stream
from twc_env.slam.graph_optimisation.whole_graph import METHODS, optimise_graph

_ODD_LINES = (
    "FIX 0", "FIX 3 7", "FIX 999", "VERTEX_XY 500 1 2", "EDGE_SE2_XY 0 500 1 1 10 0 10", "EDGE_SE2_XY 3 500 1 0 1 0 1",
    "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1", "EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 1", "PARAMS 1 2", "EQUIV 0 1", "# nothing",
    "VERTEX_SE2 900 1e6 -1e6 400", "EDGE_SE2 4 4 1 0 0 1 0 0 1 0 1", "EDGE_SE2 2 900 1 0 0 1 0 0 1 0 1",
    "EDGE_SE2 0 9 5 5 5 0 0 0 0 0 0", "EDGE_SE2 0 9 5 5 1 1 0 0 -1 0 1", "EDGE_SE2 1 8 0 0 0 1e15 0 0 1e-9 0 1",
    "EDGE_SE2 7 3 1e7 0 0 1e-6 0 0 1e-6 0 1e-6", "EDGE_SE2 700 701 1 0 0 1 0 0 1 0 1", "EDGE2 1 9 0 0 0 1 0 1 1 0 0",
)  # fmt: skip

_DIGITS_MAX = 1000
"""Python reads no longer numbers; another change may have made some."""


def mutated_graphs(count: int, seed: int = 0) -> Iterator[Attempt]:
    """Optimise `count` mutated graphs by all methods in turn; equal seeds give the same files."""
    random = random_stream(seed, "graph-fuzz")
    with workplace() as folder:
        plain = folder / "graph.g2o"
        plain.write_text(ring_graph())
        for method in METHODS:  # kernels compile before the clock runs
            optimise(plain, method)
        for number in range(count):
            raw, what = mutated(ring_graph().encode(), random, _CHANGES)
            target = folder / ("mutated.g2o.gz" if number % 7 == 6 else "mutated.g2o")
            target.write_bytes(gzip.compress(raw) if target.suffix == ".gz" and random.random() < 0.8 else raw)
            method = METHODS[number % len(METHODS)]
            yield f"#{number} {what} ({method})", partial(optimise, target, method)


def optimise(path: Path, method: str) -> None:
    """Read, optimise and write a graph; an AssertionError if the result is not finite."""
    graph = read_pose_graph(path)
    result = optimise_graph(graph, method)
    is_finite = np.isfinite(result.poses).all() and math.isfinite(sum(t.contradiction for t in result.trust))
    assert is_finite, "the result is not finite"
    write_pose_graph(path.with_name("out.g2o"), graph, result.poses, result.landmarks_m, result.accepted)


def ring_graph(count: int = 24, closures: int = 8, first: int = 0) -> str:
    """A robot that drives twice around a ring, with closures between the rounds and one false one."""
    angle = 4 * np.pi * np.arange(count) / count
    poses = np.column_stack([5 * np.cos(angle), 5 * np.sin(angle), angle + np.pi / 2])
    lines = [f"VERTEX_SE2 {first + k} {x} {y} {heading}" for k, (x, y, heading) in enumerate(poses)]
    pairs = [(k, k + 1) for k in range(count - 1)] + [(k, k + count // 2) for k in range(closures)]
    random = np.random.default_rng(1)
    for a, b in pairs:
        x, y, heading = between(poses[a], poses[b]) + random.normal(0, [0.02, 0.02, 0.005])
        lines.append(f"EDGE_SE2 {first + a} {first + b} {x} {y} {heading} 2500 0 0 2500 0 40000")
    lines.append(f"EDGE_SE2 {first + 2} {first + count // 2 + 7} 0 0 0 2500 0 0 2500 0 40000")
    return "\n".join(lines) + "\n"


def _odd_line(raw: bytes, random: np.random.Generator) -> bytes:
    lines = raw.splitlines()
    odd = _ODD_LINES[int(random.integers(len(_ODD_LINES)))].encode()
    lines.insert(int(random.integers(len(lines) + 1)), odd)
    return b"\n".join(lines)


def _without_vertices(raw: bytes, random: np.random.Generator) -> bytes:
    share = random.uniform(0, 1.2)
    kept = [line for line in raw.splitlines() if not line.startswith(b"VERTEX_SE2") or random.random() > share]
    return b"\n".join(kept)


def _turned(raw: bytes, random: np.random.Generator) -> bytes:
    """The ends of some edges swapped, so that the edge is false or, for small motions, nearly right."""
    lines = [line.split(b" ") for line in raw.splitlines()]
    for words in lines:
        if words[0] == b"EDGE_SE2" and len(words) > 2 and random.random() < 0.3:
            words[1], words[2] = words[2], words[1]
    return b"\n".join(map(b" ".join, lines))


def _renumbered(raw: bytes, random: np.random.Generator) -> bytes:
    step, begin = int(random.integers(1, 50)), int(random.integers(-100, 10**6))
    lines = [line.split(b" ") for line in raw.splitlines()]
    for words in lines:
        for k in range(1, min(len(words), 3 if words[0].startswith(b"EDGE") else 2)):
            is_number = words[k].isdigit() and len(words[k]) < _DIGITS_MAX
            words[k] = b"%d" % (begin + step * int(words[k])) if is_number else words[k]
    return b"\n".join(map(b" ".join, lines))


def _second_component(raw: bytes, random: np.random.Generator) -> bytes:
    return raw + ring_graph(int(random.integers(4, 20)) * 2, 1, 5000).encode()


def _toro(raw: bytes, random: np.random.Generator) -> bytes:
    return raw.replace(b"VERTEX_SE2", b"VERTEX2").replace(b"EDGE_SE2 ", b"EDGE2 ")


_CHANGES = (
    *OF_TEXT, _odd_line, _odd_line, _odd_line, _without_vertices, _turned, _renumbered, _second_component, _toro,
)  # fmt: skip
