"""Planar pose graphs in the g2o format (VERTEX_SE2, EDGE_SE2), as g2o, gtsam and Ceres tools exchange them."""

from __future__ import annotations

import gzip
import heapq
import itertools
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.datasets.logs.text_file import read_text
from twc_env.datasets.logs.tum import FAR_M
from twc_env.errors import DataError
from twc_env.records.geometry import compose, inverse

_UPPER = np.triu_indices(3)
_COUNTS = {"VERTEX_SE2": 5, "EDGE_SE2": 12}
"""Number of words on a line of each kind."""
_ID_MAX = 2**63 - 1


def write_g2o(path: str | Path, graph: Mapping[str, Any]) -> None:
    """Write a graph: nodes (k, 3), edges_ij (e, 2), edges_z (e, 3), edges_information (e, 3, 3); packed for .gz.

    Vertices are numbered as in `nodes`; the first is fixed. Raises DataError for inconsistent shapes and non-finite
    values.
    """
    nodes, ij, z, information = _checked(graph)
    lines = [f"VERTEX_SE2 {i} {_pose(pose)}" for i, pose in enumerate(nodes)]
    lines += ["FIX 0"] if len(nodes) else []
    for (i, j), measured, matrix in zip(ij, z, information, strict=True):
        lines.append(f"EDGE_SE2 {i} {j} {_pose(measured)} {_numbers(matrix[_UPPER])}")
    text = "\n".join(lines) + "\n"
    Path(path).write_bytes(gzip.compress(text.encode()) if str(path).endswith(".gz") else text.encode())


def read_g2o(path: str | Path) -> dict[str, Any]:
    """Read a graph, with the keys of `write_g2o` and, besides:

    vertex_ids (k,): the numbers the file gives its vertices; edges_kind: "odometry" for edges between neighbours in
    the file's numbering, else "closure". Lines of other kinds (FIX, switches, parameters) are left out. Where there are
    edges alone, nodes are laid along them from the lowest number on, which is at (0, 0, 0).
    Raises DataError naming the line for malformed numbers, edges to unknown vertices, one vertex in two places, or a
    file of neither kind.
    """
    vertices: dict[int, list[float]] = {}
    edges: list[tuple[int, int, list[float], int]] = []
    others: set[str] = set()
    for number, line in enumerate(read_text(path).splitlines(), 1):
        words = line.split()
        if not words or words[0] not in _COUNTS:
            others.update(words[:1])
            continue
        ids, values = _parse(words, path, number)
        if words[0] == "VERTEX_SE2":
            if vertices.setdefault(ids[0], values) != values:
                raise DataError(
                    f"{path}, line {number}: vertex {ids[0]} stands elsewhere in a line before; number them anew"
                )
        else:
            edges.append((ids[0], ids[1], values, number))
    if edges and not vertices:
        vertices = _laid_along(edges, path)
    if not vertices:
        found = f"it holds {', '.join(sorted(others)[:4])}" if others else "it is empty"
        raise DataError(f"{path} has no VERTEX_SE2 or EDGE_SE2 line ({found}); only planar graphs can be read")
    return _graph(vertices, edges, path)


def _graph(vertices: dict[int, list[float]], edges: list[tuple[int, int, list[float], int]], path) -> dict[str, Any]:
    index = {vertex: k for k, vertex in enumerate(vertices)}
    for i, j, _, number in edges:
        for vertex in (i, j):
            if vertex not in index:
                raise DataError(f"{path}, line {number}: the edge names vertex {vertex}, which has no VERTEX_SE2 line")
    values = np.array([v for _, _, v, _ in edges]).reshape(-1, 9)
    information = np.zeros((len(edges), 3, 3))
    information[:, _UPPER[0], _UPPER[1]] = values[:, 3:]
    information[:, _UPPER[1], _UPPER[0]] = values[:, 3:]
    return {
        "nodes": np.array(list(vertices.values())).reshape(-1, 3),
        "vertex_ids": np.array(list(vertices), np.int64),
        "edges_ij": np.array([(index[i], index[j]) for i, j, _, _ in edges], np.int64).reshape(-1, 2),
        "edges_z": values[:, :3],
        "edges_information": information,
        "edges_kind": ["odometry" if abs(i - j) == 1 else "closure" for i, j, _, _ in edges],
    }


def _laid_along(edges: list[tuple[int, int, list[float], int]], path) -> dict[int, list[float]]:
    """Poses of all vertices along the edges; closures are used only where there is no odometry."""
    ways: dict[int, list[tuple[int, Array]]] = {}
    for i, j, values, _ in edges:
        ways.setdefault(i, []).append((j, np.array(values[:3])))
        ways.setdefault(j, []).append((i, inverse(values[:3])))
    first, order = min(ways), itertools.count()
    poses: dict[int, Array] = {}
    waiting = [(False, next(order), first, np.zeros(3))]
    while waiting:
        *_, vertex, pose = heapq.heappop(waiting)
        if vertex in poses:
            continue
        poses[vertex] = pose
        for to, motion in ways[vertex]:
            heapq.heappush(waiting, (abs(to - vertex) != 1, next(order), to, compose(pose, motion)))
    if lacking := sorted(ways.keys() - poses.keys()):
        raise DataError(f"{path} has no VERTEX_SE2 lines, and no edges lead from vertex {first} to {lacking[0]}")
    return {vertex: poses[vertex].tolist() for vertex in sorted(poses)}


def _parse(words: list[str], path, number: int) -> tuple[list[int], list[float]]:
    ids = 1 if words[0] == "VERTEX_SE2" else 2
    try:
        if len(words) != _COUNTS[words[0]]:
            raise ValueError
        numbers, values = [int(w) for w in words[1 : 1 + ids]], [float(w) for w in words[1 + ids :]]
        if not all(map(math.isfinite, values)) or max(map(abs, numbers)) > _ID_MAX:
            raise ValueError
    except ValueError:
        expected = f"{_COUNTS[words[0]] - 1} finite numbers after {words[0]}"
        raise DataError(f"{path}, line {number}: expected {expected}; got {' '.join(words[1:])!r}") from None
    return numbers, values


def _checked(graph: Mapping[str, Any]) -> tuple[Array, Array, Array, Array]:
    shapes = {"nodes": (3,), "edges_ij": (2,), "edges_z": (3,), "edges_information": (3, 3)}
    arrays = []
    for key, shape in shapes.items():
        if key not in graph:
            raise DataError(f"the pose graph lacks {key!r}; give {', '.join(shapes)}")
        array = np.asarray(graph[key])
        if array.size == 0:
            array = array.reshape(0, *shape)
        if array.shape[1:] != shape:
            raise DataError(f"{key} of the pose graph must be (n, {', '.join(map(str, shape))}); got {array.shape}")
        if not np.isfinite(array).all():
            raise DataError(f"{key} of the pose graph must be finite: no reader takes others")
        arrays.append(array)
    lengths = [len(a) for a in arrays[1:]]
    if len(set(lengths)) > 1:
        raise DataError(f"the pose graph's edge arrays differ in length: {lengths}; make them equal")
    nodes, ij = arrays[0], arrays[1]
    if len(ij) and (ij.min() < 0 or ij.max() >= len(nodes)):
        raise DataError(f"edges_ij of the pose graph must lie in 0..{len(nodes) - 1}; got {ij.min()}..{ij.max()}")
    return arrays[0], arrays[1], arrays[2], arrays[3]


def _numbers(values: Array) -> str:
    return " ".join(f"{value:.9g}" for value in values)


def _pose(values: Array) -> str:
    """A pose; map coordinates (UTM) have seven digits before the point."""
    return " ".join(f"{value:.{9 if abs(value) < FAR_M else 15}g}" for value in values)
