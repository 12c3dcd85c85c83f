"""Planar pose graphs in the g2o format (VERTEX_SE2, EDGE_SE2), as g2o, gtsam and Ceres tools exchange them.

The lines of its forerunner TORO (VERTEX2, EDGE2) are read too.
"""

from __future__ import annotations

import gzip
import heapq
import itertools
import logging
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.datasets.logs.text_file import read_text
from twc_env.datasets.logs.tum import FAR_M
from twc_env.errors import DataError
from twc_env.records.geometry import between, compose, inverse
from twc_env.records.whole_file import whole_file

_UPPER = np.triu_indices(3)
_COUNTS = {"VERTEX_SE2": 5, "VERTEX2": 5, "EDGE_SE2": 12, "EDGE2": 12, "FIX": 2}
"""Number of words on a line of each kind."""
_TORO_ORDER = (0, 1, 4, 2, 5, 3)
"""Where a line of TORO has I11, I12, I13, I22, I23 and I33."""
_JUMP = 10
"""Ids further apart than so many times the usual difference belong to different robots."""
_STANDS_OUT, _STEPS_AWAY = 100.0, 3.0
"""An edge between neighbours with a squared error above the first, at vertices so many usual steps away from where it
leads, may be no odometry."""
_LAID_ALONG, _MOST = 0.01, 0.8
"""Vertices are laid along the odometry if this share of its edges has a squared error below the first."""
_LOG = logging.getLogger(__name__)
_ID_MAX = 2**63 - 1


def write_g2o(path: str | Path, graph: Mapping[str, Any]) -> None:
    """Write a graph: nodes (k, 3), edges_ij (e, 2), edges_z (e, 3), edges_information (e, 3, 3); packed for .gz.

    Vertices are numbered as in `nodes`; the one with the index `fixed` (default: the first) is fixed. Raises DataError
    for inconsistent shapes, non-finite values and edges from a node to itself.
    """
    nodes, ij, z, information = _checked(graph)
    lines = [f"VERTEX_SE2 {i} {_pose(pose)}" for i, pose in enumerate(nodes)]
    lines += [f"FIX {int(graph.get('fixed', 0))}"] if len(nodes) else []
    for (i, j), measured, matrix in zip(ij, z, information, strict=True):
        lines.append(f"EDGE_SE2 {i} {j} {_pose(measured)} {_numbers(matrix[_UPPER])}")
    text = "\n".join(lines) + "\n"
    with whole_file(path) as beside:
        beside.write_bytes(gzip.compress(text.encode()) if str(path).endswith(".gz") else text.encode())


def read_g2o(path: str | Path) -> dict[str, Any]:
    """Read a graph, with the keys of `write_g2o` and, besides:

    vertex_ids (k,): the numbers the file gives its vertices; fixed: index of the vertex named by FIX, or 0; edges_kind:
    "odometry" for edges along a robot's path (`_kinds`), else "closure". Lines of other kinds are left out; edges
    and vertices among them are named in a warning. Where there are edges alone, nodes are laid along them from the
    lowest number on, which is at (0, 0, 0).
    Raises DataError naming the line for malformed numbers, edges to unknown vertices or from a vertex to itself, one
    vertex in two places, or a file of neither kind.
    """
    lines = _Lines(path)
    for number, line in enumerate(read_text(path).splitlines(), 1):
        lines.add(line.split(), number)
    vertices = lines.vertices
    if lines.edges and not vertices:
        vertices = _laid_along(lines.edges, path)
    if not vertices:
        found = f"it holds {', '.join(list(lines.others)[:4])}" if lines.others else "it is empty"
        raise DataError(
            f"{path} has no VERTEX_SE2 or EDGE_SE2 line ({found}); only planar graphs of poses can be read: "
            "export it in two dimensions"
        )
    if dropped := [f"{count} {kind}" for kind, count in lines.others.items() if kind.startswith(("EDGE", "VERTEX"))]:
        _LOG.warning("%s: lines left out, of which no graph of poses can be made: %s", path, ", ".join(dropped))
    return _graph(vertices, lines.edges, path) | {"fixed": _fixed(lines.held, vertices, path)}


class _Lines:
    """Vertices and edges (from, to, values, line number) of a file as it is read, and counts of other lines."""

    def __init__(self, path: str | Path):
        self.path = path
        self.vertices: dict[int, list[float]] = {}
        self.edges: list[tuple[int, int, list[float], int]] = []
        self.held: list[tuple[int, int]] = []
        self.others: dict[str, int] = {}

    def add(self, words: list[str], number: int) -> None:
        if not words or words[0].startswith("#"):
            return
        if words[0] not in _COUNTS or (words[0] == "FIX" and len(words) < 2):
            self.others[words[0]] = self.others.get(words[0], 0) + 1
        elif words[0] == "FIX":
            for word in words[1:]:
                self.held.append((_parse(["FIX", word], self.path, number)[0][0], number))
        else:
            ids, values = _parse(words, self.path, number)
            self._add_vertex(ids[0], values, number) if len(ids) == 1 else self._add_edge(ids, values, words, number)

    def _add_vertex(self, vertex: int, values: list[float], number: int) -> None:
        if self.vertices.setdefault(vertex, values) != values:
            raise DataError(
                f"{self.path}, line {number}: vertex {vertex} stands elsewhere in a line before; number them anew"
            )

    def _add_edge(self, ids: list[int], values: list[float], words: list[str], number: int) -> None:
        if ids[0] == ids[1]:
            raise DataError(
                f"{self.path}, line {number}: the edge leads from vertex {ids[0]} to itself, "
                "expected two vertices; delete the line"
            )
        if words[0] == "EDGE2":
            values = values[:3] + [values[3 + k] for k in _TORO_ORDER]
        self.edges.append((ids[0], ids[1], values, number))


def _fixed(held: list[tuple[int, int]], vertices: dict[int, list[float]], path) -> int:
    """Index of the first vertex of FIX lines, or 0."""
    index = {vertex: k for k, vertex in enumerate(vertices)}
    for vertex, number in held:
        if vertex not in index:
            raise DataError(f"{path}, line {number}: FIX names vertex {vertex}, which the file does not have")
    names = list(dict.fromkeys(vertex for vertex, _ in held))
    if len(names) > 1:
        _LOG.warning("%s fixes %d vertices; of these %d alone is held", path, len(names), names[0])
    return index[names[0]] if names else 0


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
    nodes = np.array(list(vertices.values())).reshape(-1, 3)
    ij = np.array([(index[i], index[j]) for i, j, _, _ in edges], np.int64).reshape(-1, 2)
    is_odometry = edges_along_paths(edges)
    is_odometry &= ~edges_contradicted(nodes, ij, values[:, :3], information, is_odometry)
    return {
        "nodes": nodes,
        "vertex_ids": np.array(list(vertices), np.int64),
        "edges_ij": ij,
        "edges_z": values[:, :3],
        "edges_information": information,
        "edges_kind": ["odometry" if is_along else "closure" for is_along in is_odometry.tolist()],
    }


def edges_along_paths(edges: list[tuple[int, int, list[float], int]]) -> Array:
    """(e,) bool: between neighbours in the numbering, whatever its step, and not over a jump to another robot's ids."""
    ids = sorted({vertex for edge in edges for vertex in edge[:2]})
    place = {vertex: k for k, vertex in enumerate(ids)}
    gaps = [second - first for first, second in itertools.pairwise(ids)]
    usual = sorted(gaps)[len(gaps) // 2] if gaps else 1
    return np.array([abs(place[i] - place[j]) == 1 and abs(i - j) <= _JUMP * usual for i, j, *_ in edges], bool)


def edges_contradicted(nodes: Array, ij: Array, z: Array, information: Array, is_along: Array) -> Array:
    """(e,) bool: edges between neighbours whose vertices stand far from where the edge leads.

    So do edges between the last vertex of one robot and the first of the next. Where vertices are not laid along the
    odometry, the edge itself must be longer than the others by as much.
    """
    out = np.zeros(len(ij), bool)
    if not is_along.any():
        return out
    found = between(nodes[ij[:, 0]], nodes[ij[:, 1]])
    error = between(z, found)
    away_m = np.hypot(*error[:, :2].T)
    squared = np.einsum("ei,eij,ej->e", error, information, error)
    usual_m = np.median(np.hypot(*z[is_along, :2].T))
    is_clear = np.hypot(*z[:, :2].T) > _STEPS_AWAY * usual_m
    if np.quantile(squared[is_along], _MOST, method="lower") < _LAID_ALONG:
        is_clear[:] = True
    out[is_along & is_clear & (squared > _STANDS_OUT) & (away_m > _STEPS_AWAY * usual_m)] = True
    return out


def _laid_along(edges: list[tuple[int, int, list[float], int]], path) -> dict[int, list[float]]:
    """Poses of all vertices along the edges; closures are used only where there is no odometry."""
    ways: dict[int, list[tuple[int, Array]]] = {}
    for i, j, values, _ in edges:
        ways.setdefault(i, []).append((j, np.array(values[:3])))
        ways.setdefault(j, []).append((i, inverse(values[:3])))
    first, order = min(ways), itertools.count()
    along = {frozenset(edge[:2]) for edge, is_along in zip(edges, edges_along_paths(edges), strict=True) if is_along}
    poses: dict[int, Array] = {}
    waiting = [(False, next(order), first, np.zeros(3))]
    while waiting:
        *_, vertex, pose = heapq.heappop(waiting)
        if vertex in poses:
            continue
        poses[vertex] = pose
        for to, motion in ways[vertex]:
            heapq.heappush(waiting, (frozenset((vertex, to)) not in along, next(order), to, compose(pose, motion)))
    if lacking := sorted(ways.keys() - poses.keys()):
        raise DataError(f"{path} has no VERTEX_SE2 lines, and no edges lead from vertex {first} to {lacking[0]}")
    return {vertex: poses[vertex].tolist() for vertex in sorted(poses)}


def _parse(words: list[str], path, number: int) -> tuple[list[int], list[float]]:
    ids = 2 if words[0].startswith("EDGE") else 1
    try:
        if len(words) != _COUNTS[words[0]]:
            raise ValueError
        numbers, values = [int(w) for w in words[1 : 1 + ids]], [float(w) for w in words[1 + ids :]]
        if not all(map(math.isfinite, values)) or max(map(abs, numbers)) > _ID_MAX:
            raise ValueError
    except ValueError:
        expected = f"{_COUNTS[words[0]] - 1} finite numbers after {words[0]}" if words[0] != "FIX" else "ids after FIX"
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
    if (loops := np.flatnonzero(ij[:, 0] == ij[:, 1])).size:
        raise DataError(f"edge {loops[0]} of the pose graph leads from node {ij[loops[0], 0]} to itself; leave it out")
    return arrays[0], arrays[1], arrays[2], arrays[3]


def _numbers(values: Array) -> str:
    return " ".join(f"{value:.9g}" for value in values)


def _pose(values: Array) -> str:
    """A pose; map coordinates (UTM) have seven digits before the point."""
    return " ".join(f"{value:.{9 if abs(value) < FAR_M else 15}g}" for value in values)
