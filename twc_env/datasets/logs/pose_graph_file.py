"""Any planar pose graph in a g2o or TORO file, in order: gaps in the ids, flipped edges, landmarks, missing vertices.

What no graph can be made of is left out, and said so.
"""

from __future__ import annotations

import itertools
import math
from array import array
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.datasets.logs.text_file import TextLines
from twc_env.errors import DataError
from twc_env.records.geometry import between, inverse
from twc_env.records.planar_graph import PlanarGraph
from twc_env.records.twists import adjoint
from twc_env.records.whole_file import whole_file

_VERTICES, _EDGES = {"VERTEX_SE2", "VERTEX2"}, {"EDGE_SE2", "EDGE2"}
_WORDS = {"VERTEX_SE2": 5, "VERTEX2": 5, "EDGE_SE2": 12, "EDGE2": 12, "VERTEX_XY": 4, "EDGE_SE2_XY": 8}
_SPATIAL = {"VERTEX_SE3:QUAT", "EDGE_SE3:QUAT", "VERTEX_SE3", "EDGE_SE3", "VERTEX3", "EDGE3"}
_UPPER3, _UPPER2 = np.triu_indices(3), np.triu_indices(2)
_TORO_ORDER = [0, 1, 4, 2, 5, 3]
"""Where a line of TORO has I11, I12, I13, I22, I23 and I33."""
ID_MAX, FAR_MAX_M, INFORMATION_MAX = 2**63 - 1, 1e8, 1e16
SINGULAR = 1e-9
"""The least eigenvalue of an information matrix, as a share of the largest: less is raised to this."""
NAMED_MAX, _KINDS_MAX, _OTHERS = 3, 20, ""
LINES_MAX = 300_000
"""Edges, vertices, landmarks, observations or lines of other kinds: the largest public graphs in two dimensions have a
hundred thousand."""
_JUMP = 10
"""Ids further apart than so many times the usual difference belong to different robots."""
_STANDS_OUT, _STEPS_AWAY = 100.0, 3.0
"""An edge between neighbours with a squared error above the first, at vertices so many usual steps away from where it
leads, may be no odometry."""
_LAID_ALONG, _MOST = 0.01, 0.8
"""Vertices are laid along the odometry if this share of its edges has a squared error below the first."""


def read_pose_graph(path: str | Path, turns: bool = True) -> PlanarGraph:
    """The graph of a g2o or TORO file, packed (.gz, .xz) or not.

    Vertices without a line have NaN for a pose. Edges that lead from a higher to a lower id are turned round, unless
    `turns` is False. Left out and named in `remarks`: edges from a vertex to itself, observations without information,
    and lines of unknown kinds. Of FIX lines only those count that name a vertex or a landmark with a place. Raises
    DataError, naming the line, for malformed numbers, one vertex in two places, information that is no inverse
    covariance, and for graphs in three dimensions.
    """
    lines = _Lines(path)
    for number, line in enumerate(TextLines(path, errors="replace"), 1):
        lines.add(line.split(), number)
    return lines.graph(turns)


class _Lines:
    """The lines of a file, sorted by kind, with what is to be said about them."""

    def __init__(self, path: str | Path):
        self.path = path
        self.vertices: dict[int, tuple[float, ...]] = {}
        self.landmarks: dict[int, tuple[float, ...]] = {}
        self.edges: list[tuple[int, int, int]] = []
        self.landmark_observations: list[tuple[int, int, int]] = []
        """Both ends, and the number of the line."""
        self.edge_values, self.observation_values = array("d"), array("d")
        """Their numbers, one after the other."""
        self.held: list[int] = []
        self.selves: list[int] = []
        self.unknown: Counter[str] = Counter()
        """Lines of each kind, and of those beyond the first few, as no graph has them."""
        self.left_out = 0
        """All of these."""

    def add(self, words: list[str], number: int) -> None:
        kind = words[0] if words else "#"
        if kind.startswith(("#", "%")):
            return
        if kind == "FIX":
            self.held += [self._id(words, at, number) for at in range(1, len(words))]
        elif kind in _WORDS:
            self._add_known(words, number)
        else:
            self.unknown[kind[:40] if kind[:40] in self.unknown or len(self.unknown) < _KINDS_MAX else _OTHERS] += 1
            self.left_out += 1
            if self.left_out > LINES_MAX:
                raise self._error(number, f"more than {LINES_MAX} lines of unknown kinds; name a pose graph")

    def _add_known(self, words: list[str], number: int) -> None:
        kind, is_edge = words[0], words[0] in _EDGES or words[0] == "EDGE_SE2_XY"
        first = self._id(words, 1, number)
        second = self._id(words, 2, number) if is_edge else first
        values = self._values(words, 3 if is_edge else 2, number)
        of_kind: dict | list = self.selves
        if kind in _VERTICES or kind == "VERTEX_XY":
            of_kind = places = self.landmarks if kind == "VERTEX_XY" else self.vertices
            other = self.vertices if kind == "VERTEX_XY" else self.landmarks
            if places.setdefault(first, tuple(values)) != tuple(values) or first in other:
                raise self._error(number, f"vertex {first} stands elsewhere in a line before; number them anew")
        elif first == second:
            self.selves.append(first)
        elif kind == "EDGE_SE2_XY":
            of_kind = self.landmark_observations
            self.landmark_observations.append((first, second, number))
            self.observation_values.extend(values)
        else:
            of_kind = self.edges
            self.edges.append((first, second, number))
            self.edge_values.extend(values if kind != "EDGE2" else values[:3] + [values[3 + k] for k in _TORO_ORDER])
        if len(of_kind) > LINES_MAX:
            raise self._error(number, f"more than {LINES_MAX} lines of a kind; cut the graph into parts")

    def _id(self, words: list[str], at: int, number: int) -> int:
        if at >= len(words):
            return 0  # what lacks is told with the other numbers
        word = words[at]
        try:
            vertex = int(word)
        except ValueError:
            raise self._error(number, f"{words[0]} names a vertex {word[:40]!r}; ids are whole numbers") from None
        if not -ID_MAX <= vertex <= ID_MAX:
            raise self._error(number, f"vertex {word[:40]} has too many digits; ids have 18 at most")
        return vertex

    def _values(self, words: list[str], begin: int, number: int) -> list[float]:
        try:
            values = list(map(float, words[begin:]))
        except ValueError:
            values = []
        if len(words) != _WORDS[words[0]] or not all(map(math.isfinite, values)) or not values:
            got = " ".join(words[1:])[:80]
            raise self._error(number, f"expected {_WORDS[words[0]] - 1} finite numbers after {words[0]}; got {got!r}")
        least, most = min(values), max(values)
        if least >= -FAR_MAX_M and most <= FAR_MAX_M:
            return values
        place, rest = (values[:2], values[2:]) if "XY" in words[0] else (values[:3], values[3:])
        if max(map(abs, place)) > FAR_MAX_M or max(map(abs, rest), default=0.0) > INFORMATION_MAX:
            raise self._error(number, f"values must be metres, radians and inverse covariances; got {max(values):.3g}")
        return values

    def _error(self, number: int, text: str) -> DataError:
        return DataError(f"{self.path}, line {number}: {text}")

    def graph(self, turns: bool) -> PlanarGraph:
        """The graph of all lines. Raises DataError if there is none in two dimensions."""
        if not self.edges and (not self.vertices or any(kind in _SPATIAL for kind in self.unknown)):
            self._refuse()
        known = {*self.vertices, *self._ends(), *(s[0] for s in self.landmark_observations)}
        is_of_landmark = [s[1] not in known for s in self.landmark_observations]
        observations = list(itertools.compress(self.landmark_observations, is_of_landmark))
        remarks = self._remarks(len(self.landmark_observations) - len(observations))
        ids = sorted(known)
        index = {vertex: k for k, vertex in enumerate(ids)}
        poses = np.array([self.vertices.get(vertex, (math.nan,) * 3) for vertex in ids], float).reshape(-1, 3)
        edges = np.array([(index[i], index[j]) for i, j, _ in self.edges], np.int64).reshape(-1, 2)
        values = np.array(self.edge_values).reshape(-1, 9)
        information = _symmetric(values[:, 3:], _UPPER3, 3)
        raised = self._check_information(information, [number for *_, number in self.edges])
        if raised:
            remarks.append(f"{raised} edges have singular information, which is raised a little")
        measured = values[:, :3].copy()
        flipped = np.flatnonzero((edges[:, 0] > edges[:, 1]) & turns)
        if len(flipped):
            remarks.append(f"{len(flipped)} edges lead from a higher to a lower id; they are turned round")
            back = inverse(measured[flipped])
            # An error of the measurement, as a twist of its own frame, is that of the inverse through the adjoint.
            way = adjoint(measured[flipped])
            information[flipped] = np.swapaxes(np.linalg.inv(way), 1, 2) @ information[flipped] @ np.linalg.inv(way)
            information[flipped] = 0.5 * (information[flipped] + np.swapaxes(information[flipped], 1, 2))
            measured[flipped], edges[flipped] = back, edges[flipped][:, ::-1]
        is_odometry = self._along(poses, edges, measured, information, ids)
        landmark_ids = sorted({*self.landmarks, *(s[1] for s in observations)})
        place_of = {landmark: k for k, landmark in enumerate(landmark_ids)}
        seen = np.array(self.observation_values).reshape(-1, 5)[np.array(is_of_landmark, bool)]
        seen_information = _symmetric(seen[:, 2:], _UPPER2, 2)
        self._check_information(seen_information, [number for *_, number in observations])
        named = list(dict.fromkeys(self.held))
        held = [index[vertex] for vertex in named if vertex in index]
        if lost := [vertex for vertex in named if vertex not in index and vertex not in self.landmarks]:
            remarks.append(f"FIX names {_some(lost)}, which is neither a vertex nor a landmark with a place")
        return PlanarGraph(
            vertex_ids=np.array(ids, np.int64),
            poses=poses,
            edges=edges,
            measured=measured,
            information=information,
            is_odometry=is_odometry,
            held=np.array(held, np.int64),
            held_landmarks=np.array([place_of[k] for k in named if k in self.landmarks], np.int64),
            landmark_ids=np.array(landmark_ids, np.int64),
            landmarks_m=np.array([self.landmarks.get(k, (math.nan,) * 2) for k in landmark_ids], float).reshape(-1, 2),
            landmark_observations=np.array([(index[a], place_of[b]) for a, b, _ in observations], np.int64).reshape(
                -1, 2
            ),
            seen_m=seen[:, :2],
            seen_information=seen_information,
            remarks=tuple(remarks),
        )

    def _ends(self) -> set[int]:
        """Vertices that edges join."""
        return {edge[0] for edge in self.edges} | {edge[1] for edge in self.edges}

    def _refuse(self) -> None:
        if spatial := [kind for kind in self.unknown if kind in _SPATIAL]:
            raise DataError(
                f"{self.path} is a graph in three dimensions ({', '.join(spatial[:NAMED_MAX])}); planar ones have "
                "VERTEX_SE2 and EDGE_SE2 lines: export it in two dimensions"
            )
        kinds = list(self.unknown)[:NAMED_MAX]
        is_text = all(kind.isprintable() and "\ufffd" not in kind for kind in kinds)
        found = f"it holds {', '.join(kinds)}" if kinds else "it is empty"
        found = found if is_text else "it is a binary file"
        raise DataError(f"{self.path} has no VERTEX_SE2, EDGE_SE2, VERTEX2 or EDGE2 line ({found}); name a pose graph")

    def _remarks(self, of_poses: int) -> list[str]:
        out = []
        if self.selves:
            out.append(f"{len(self.selves)} edges from a vertex to itself left out: {_some(self.selves)}")
        if of_poses:
            out.append(f"{of_poses} observations of poses as landmarks left out")
        for kind, number in self.unknown.items():
            if kind == _OTHERS:
                out.append(f"{number} lines of other kinds left out")
                continue
            what = " (three dimensions)" if kind in _SPATIAL else ""
            out.append(f"{number} {'line' if number == 1 else 'lines'} of the kind {kind!r}{what} left out")
        if lacking := self._ends() - self.vertices.keys():
            out.append(f"{len(lacking)} vertices have no line and are laid along the edges: {_some(sorted(lacking))}")
        return out

    def _check_information(self, information: Array, numbers: list[int]) -> int:
        """Raise DataError for matrices that are no inverse covariances; raise singular ones in place, and count
        them."""
        if not len(information):
            return 0
        values = np.linalg.eigvalsh(information)
        least, largest = values[:, 0], values[:, -1]
        bad = np.flatnonzero((least < -1e-6 * np.abs(largest)) | (largest <= 0.0))
        if len(bad):
            raise self._error(
                numbers[bad[0]],
                "the information is no inverse covariance (it must be positive definite); export it again",
            )
        weak = np.flatnonzero(least < SINGULAR * largest)
        information[weak] += (SINGULAR * largest[weak] - least[weak])[:, None, None] * np.eye(information.shape[1])
        return len(weak)

    def _along(self, poses: Array, edges: Array, measured: Array, information: Array, ids: list[int]) -> Array:
        """(e,) bool: edges of robots' paths; of several between the same vertices the first not contradicted."""
        is_along = _along_numbers(np.array(ids, object), edges)
        placed = ~np.isnan(poses[edges]).any(axis=(1, 2)) if len(edges) else np.zeros(0, bool)
        if placed.any():
            out = np.zeros(len(edges), bool)
            out[placed] = _contradicted(poses, edges[placed], measured[placed], information[placed], is_along[placed])
            is_along &= ~out
        seen: set[tuple[int, int]] = set()
        for e in np.flatnonzero(is_along).tolist():
            pair = (int(edges[e, 0]), int(edges[e, 1]))
            is_along[e] = pair not in seen
            seen.add(pair)
        return is_along


def _along_numbers(ids: Array, edges: Array) -> Array:
    """(e,) bool: between neighbours in the numbering, whatever its step, and not over a jump to another robot's ids.

    ids (n,), ascending.
    """
    if not len(edges):
        return np.zeros(0, bool)
    joined = np.unique(edges)
    place = {vertex: k for k, vertex in enumerate(joined.tolist())}
    gaps = sorted(second - first for first, second in itertools.pairwise(ids[joined].tolist()))
    most = _JUMP * (gaps[len(gaps) // 2] if gaps else 1)
    return np.array([abs(place[i] - place[j]) == 1 and abs(ids[i] - ids[j]) <= most for i, j in edges.tolist()], bool)


def _contradicted(nodes: Array, ij: Array, z: Array, information: Array, is_along: Array) -> Array:
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


def _symmetric(upper: Array, where: tuple[Array, Array], size: int) -> Array:
    out = np.zeros((len(upper), size, size))
    out[:, where[0], where[1]] = out[:, where[1], where[0]] = upper
    return out


def _some(ids: list[int]) -> str:
    return ", ".join(map(str, ids[:NAMED_MAX])) + (" ..." if len(ids) > NAMED_MAX else "")


def write_pose_graph(path: str | Path, graph: PlanarGraph, poses: Array, landmarks_m: Array, accepted: Array) -> None:
    """Write a g2o file of a graph with other poses (n, 3) and landmarks (m, 2), under the ids of the original.

    Edges that are not accepted (e,) stand in it as comments.
    """
    ids, landmark_ids = graph.vertex_ids.tolist(), graph.landmark_ids.tolist()
    lines = [f"VERTEX_SE2 {vertex} {_words(pose)}" for vertex, pose in zip(ids, poses, strict=True)]
    for landmark, place in zip(landmark_ids, landmarks_m, strict=True):
        if np.isfinite(place).all():
            lines.append(f"VERTEX_XY {landmark} {_words(place)}")
    lines += [f"FIX {ids[k]}" for k in graph.held.tolist()]
    lines += [f"FIX {landmark_ids[k]}" for k in graph.held_landmarks.tolist()]
    for k, (a, b) in enumerate(graph.edges.tolist()):
        values = _words([*graph.measured[k], *graph.information[k][_UPPER3]])
        lines.append(f"{'' if accepted[k] else '# rejected: '}EDGE_SE2 {ids[a]} {ids[b]} {values}")
    for k, (a, m) in enumerate(graph.landmark_observations.tolist()):
        values = _words([*graph.seen_m[k], *graph.seen_information[k][_UPPER2]])
        lines.append(f"EDGE_SE2_XY {ids[a]} {landmark_ids[m]} {values}")
    with whole_file(path) as beside:
        beside.write_text("\n".join(lines) + "\n")


def _words(values: Iterable[float]) -> str:
    return " ".join(f"{value:.12g}" for value in values)
