"""Writes pose graphs in the g2o format (VERTEX_SE2, EDGE_SE2), as g2o, gtsam and Ceres tools read them, and a table of
whose keyframe each vertex is."""

from __future__ import annotations

import gzip
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.datasets.logs.tum import FAR_M
from twc_env.errors import DataError
from twc_env.records.whole_file import whole_file

_UPPER = np.triu_indices(3)
ROBOT_STEP, ROBOT_GAP = 1000, 100
"""Each robot's vertices begin at another multiple of the first, so large that at least the second lies between two."""
PRIOR = "prior"
"""Robot of the vertices of a map of an earlier session, in the table."""


def write_g2o(path: str | Path, graph: Mapping[str, Any]) -> None:
    """Write a graph: nodes (k, 3), edges_ij (e, 2), edges_z (e, 3), edges_information (e, 3, 3); packed for .gz.

    Vertices are numbered as in `nodes`, or, with `node_ids` (k, 2: robot, keyframe), by `vertex_numbers`; the one with
    the index `fixed` in `nodes` (default: the first) is fixed. Raises DataError for inconsistent shapes, non-finite
    values and edges from a node to itself.
    """
    nodes, ij, z, information = _checked(graph)
    ids = np.asarray(graph.get("node_ids", np.column_stack([np.zeros(len(nodes)), np.arange(len(nodes))])))
    order = np.lexsort((ids[:, 1], ids[:, 0]))
    number = vertex_numbers(ids)
    lines = [f"VERTEX_SE2 {i} {_pose(pose)}" for i, pose in zip(number[order], nodes[order], strict=True)]
    lines += [f"FIX {number[int(graph.get('fixed', 0))]}"] if len(nodes) else []
    for (i, j), measured, matrix in zip(number[ij], z, information, strict=True):
        lines.append(f"EDGE_SE2 {i} {j} {_pose(measured)} {_numbers(matrix[_UPPER])}")
    text = "\n".join(lines) + "\n"
    with whole_file(path) as beside:
        beside.write_bytes(gzip.compress(text.encode()) if str(path).endswith(".gz") else text.encode())


def vertex_numbers(ids: Array) -> Array:
    """(k,) numbers of the vertices of keyframes (k, 2: robot, keyframe): from 0, and of each further robot from the
    next multiple of 1000 (of 2000 and so on where one has more than 900).

    The jump tells readers that a closure from the last keyframe of a robot to the first of the next is no odometry.
    """
    _, rank, counts = np.unique(ids[:, 0], return_inverse=True, return_counts=True)
    first = np.concatenate([[0], np.cumsum(counts)[:-1]])
    place = np.argsort(np.lexsort((ids[:, 1], ids[:, 0]))) - first[rank]
    step = ROBOT_STEP * math.ceil((counts.max(initial=0) + ROBOT_GAP) / ROBOT_STEP)
    numbers: Array = rank * step + place
    return numbers


def write_vertices(path: str | Path, graph: Mapping[str, Any]) -> None:
    """Write a table of the vertices that `write_g2o` writes of `TeamMapper.graph()`: vertex, robot (`PRIOR`: a map of
    an earlier session), keyframe among the robot's own, and its step and time_s by the robot's frames."""
    columns = vertex_numbers(graph["node_ids"]), graph["node_robots"], graph["node_steps"], graph["node_times_s"]
    lines = ["vertex,robot,keyframe,step,time_s"]
    for vertex, (robot, keyframe), step, time_s in sorted(zip(*(part.tolist() for part in columns), strict=True)):
        origin = f"{robot},{keyframe},{step},{time_s:.9g}" if robot >= 0 else f"{PRIOR},{keyframe},,"
        lines.append(f"{vertex},{origin}")
    with whole_file(path) as beside:
        beside.write_text("\n".join(lines) + "\n")


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
