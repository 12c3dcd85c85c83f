"""Malformed and unusual pose graphs: reading and optimising one may only raise DataError, and ends finite."""

from __future__ import annotations

import gzip
import math
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from tests.soak.attempts import Attempt, workplace
from twc_env.datasets.logs.pose_graph_file import read_pose_graph, write_pose_graph
from twc_env.records.geometry import between
from twc_env.records.random_streams import random_stream
from twc_env.slam.graph_optimisation.whole_graph import METHODS, optimise_graph

_ODD_WORDS = (
    "nan", "inf", "-inf", "1e308", "-1e308", "1e-320", "0", "-1", "x", "9" * 30, "1e9", "", "0x10", "1,5", "\x00",
)  # fmt: skip
_ODD_LINES = (
    "FIX 0", "FIX 3 7", "FIX 999", "VERTEX_XY 500 1 2", "EDGE_SE2_XY 0 500 1 1 10 0 10", "EDGE_SE2_XY 3 500 1 0 1 0 1",
    "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1", "EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 1", "PARAMS 1 2", "EQUIV 0 1", "# nothing",
    "VERTEX_SE2 900 1e6 -1e6 400", "EDGE_SE2 4 4 1 0 0 1 0 0 1 0 1", "EDGE_SE2 2 900 1 0 0 1 0 0 1 0 1",
    "EDGE_SE2 0 9 5 5 5 0 0 0 0 0 0", "EDGE_SE2 0 9 5 5 1 1 0 0 -1 0 1", "EDGE_SE2 1 8 0 0 0 1e15 0 0 1e-9 0 1",
    "EDGE_SE2 7 3 1e7 0 0 1e-6 0 0 1e-6 0 1e-6", "EDGE_SE2 700 701 1 0 0 1 0 0 1 0 1", "EDGE2 1 9 0 0 0 1 0 1 1 0 0",
)  # fmt: skip


def mutated_graphs(count: int, seed: int = 0) -> Iterator[Attempt]:
    """Optimise `count` mutated graphs by all methods in turn; equal seeds give the same files."""
    random = random_stream(seed, "graph-fuzz")
    with workplace() as folder:
        plain = folder / "graph.g2o"
        plain.write_text(ring_graph())
        for method in METHODS:  # kernels compile before the clock runs
            optimise(plain, method)
        for number in range(count):
            raw, what = _mutated(random)
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


def _mutated(random: np.random.Generator) -> tuple[bytes, str]:
    lines = ring_graph().splitlines()
    names = []
    for _ in range(int(random.integers(1, 4))):
        change = _CHANGES[int(random.integers(len(_CHANGES)))]
        lines = change(lines, random)
        names.append(change.__name__.lstrip("_"))
    raw = "\n".join(lines).encode("utf-8", "replace") + b"\n"
    if random.random() < 0.15:
        raw = raw[: int(random.integers(len(raw)))]
        names.append("cut")
    elif random.random() < 0.1:
        at = int(random.integers(len(raw)))
        raw = raw[:at] + random.bytes(12) + raw[at:]
        names.append("bytes")
    return raw, ", ".join(names)


def _odd_word(lines: list[str], random: np.random.Generator) -> list[str]:
    at = int(random.integers(len(lines)))
    words = lines[at].split(" ")
    words[int(random.integers(len(words)))] = _ODD_WORDS[int(random.integers(len(_ODD_WORDS)))]
    return [*lines[:at], " ".join(words), *lines[at + 1 :]]


def _odd_line(lines: list[str], random: np.random.Generator) -> list[str]:
    at = int(random.integers(len(lines) + 1))
    return [*lines[:at], _ODD_LINES[int(random.integers(len(_ODD_LINES)))], *lines[at:]]


def _without(lines: list[str], random: np.random.Generator) -> list[str]:
    kept = [line for line in lines if random.random() > 0.1]
    return kept or lines


def _without_vertices(lines: list[str], random: np.random.Generator) -> list[str]:
    share = random.uniform(0, 1.2)
    return [line for line in lines if not line.startswith("VERTEX_SE2") or random.random() > share]


def _shuffled(lines: list[str], random: np.random.Generator) -> list[str]:
    return [lines[k] for k in random.permutation(len(lines))]


def _turned(lines: list[str], random: np.random.Generator) -> list[str]:
    """The ends of some edges swapped, so that the edge is false or, for small motions, nearly right."""
    out = []
    for line in lines:
        words = line.split(" ")
        if words[0] == "EDGE_SE2" and len(words) > 2 and random.random() < 0.3:
            words[1], words[2] = words[2], words[1]
        out.append(" ".join(words))
    return out


def _renumbered(lines: list[str], random: np.random.Generator) -> list[str]:
    step, begin = int(random.integers(1, 50)), int(random.integers(-100, 10**6))

    def renamed(word: str) -> str:
        return str(begin + step * int(word)) if word.isdecimal() else word

    out = []
    for line in lines:
        words = line.split(" ")
        ids = 2 if words[0].startswith("EDGE") else 1
        out.append(" ".join([words[0], *map(renamed, words[1 : 1 + ids]), *words[1 + ids :]]))
    return out


def _second_component(lines: list[str], random: np.random.Generator) -> list[str]:
    return lines + ring_graph(int(random.integers(4, 20)) * 2, 1, 5000).splitlines()


def _toro(lines: list[str], random: np.random.Generator) -> list[str]:
    return [line.replace("VERTEX_SE2", "VERTEX2").replace("EDGE_SE2 ", "EDGE2 ") for line in lines]


_CHANGES = (
    _odd_word, _odd_word, _odd_line, _odd_line, _odd_line, _without, _without_vertices, _shuffled, _turned, _renumbered,
    _second_component, _toro,
)  # fmt: skip
