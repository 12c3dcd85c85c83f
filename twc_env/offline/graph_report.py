"""What `twc-env optimise` shows and writes of an optimised pose graph."""

from __future__ import annotations

import csv
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray as Array

from twc_env.records.planar_graph import PlanarGraph
from twc_env.records.whole_file import whole_file
from twc_env.running.output_folder import make_folder
from twc_env.slam.graph_optimisation.trust import Trust
from twc_env.slam.graph_optimisation.whole_graph import LANDMARK_GATE, OptimisedGraph

NAMED_MAX = 3
SHOWN_MAX = 12
"""Components in the table, the largest first."""
HANGING_MAX = 0.05
"""Share of a component's poses that may hang on nothing, or on single closures which nothing checks."""
TIME_MAX = 10**15
"""Ids below this have no more digits than times in a TUM file. Those of GTSAM's symbols have 19."""


def status(trust: Trust, poses: int) -> str:
    """One word on a component: lost, unchecked (no closures, or too much hangs on single ones or nothing), or sound."""
    is_checked = trust.accepted and trust.hanging <= HANGING_MAX * poses
    return "LOST" if trust.is_lost else "sound" if is_checked else "unchecked"


def component_rows(graph: PlanarGraph, result: OptimisedGraph) -> tuple[list[dict], int]:
    """The table of the largest components, and how many more there are."""
    rows = _rows(graph, result)
    order = sorted(range(len(rows)), key=lambda k: -rows[k]["poses"])[:SHOWN_MAX]
    return [rows[k] for k in sorted(order)], max(len(rows) - SHOWN_MAX, 0)


def summary(graph: PlanarGraph, result: OptimisedGraph) -> dict:
    """All figures, for JSON."""
    rejected = np.flatnonzero(~result.accepted)
    return {
        "is_lost": result.is_lost,
        "components": [row | {"reasons": list(trust.reasons)} for row, trust in
                       zip(_rows(graph, result), result.trust, strict=True)],
        "landmarks": len(graph.landmark_ids),
        "landmark observations": len(graph.landmark_observations),
        "rejected": [_closure(graph, result, int(e)) for e in rejected],
        "contradicting landmark observations": [
            _observation(graph, result, int(s)) for s in np.flatnonzero(result.landmark_errors > LANDMARK_GATE)
        ],
        "remarks": list(graph.remarks),
        "notes": notes(graph, result, written=False),
    }  # fmt: skip


def notes(graph: PlanarGraph, result: OptimisedGraph, written: bool) -> list[str]:
    """What is to be known of a result, and of its files if they are written, in sentences."""
    said = [*_hanging(graph, result), *_contradicted(graph, result)]
    if written and not _has_ids_for_times(graph):
        said.append(
            "vertex ids have too many digits for times: poses.tum counts the poses from 0, as graph.g2o has them"
        )
    return said


def write_results(graph: PlanarGraph, result: OptimisedGraph, folder: Path) -> list[Path]:
    """Write the graph, the poses, tables of all closures and of observations, if any, and, with matplotlib, a picture.

    Returns the paths.
    """
    from twc_env.datasets.logs.pose_graph_file import write_pose_graph
    from twc_env.datasets.logs.tum import write_tum
    from twc_env.pictures.graph_picture import draw_graph

    make_folder(folder)
    paths = [folder / name for name in ("graph.g2o", "poses.tum", "closures.csv")]
    write_pose_graph(paths[0], graph, result.poses, result.landmarks_m, result.accepted)
    write_tum(paths[1], _times(graph), result.poses)
    _write_table(paths[2], _COLUMNS, [_closure(graph, result, int(e)) for e in np.flatnonzero(~graph.is_odometry)])
    if len(graph.landmark_observations):
        paths.append(folder / "landmark_observations.csv")
        _write_table(
            paths[-1], _OBSERVATION, [_observation(graph, result, s) for s in range(len(graph.landmark_observations))]
        )
    if find_spec("matplotlib") is not None:
        paths.append(folder / "graph.png")
        draw_graph(graph, result, paths[-1])
    return paths


def _hanging(graph: PlanarGraph, result: OptimisedGraph) -> list[str]:
    """Sentences on parts that nothing accepted holds, and on the closures that alone hold the largest ones."""
    counts = np.bincount(result.component)
    sizes = counts[result.component[graph.edges[:, 0]]]
    order = sorted(result.hanging, key=lambda e: -result.hanging[e])
    said = [
        f"component {number}: nothing accepted joins {trust.loose} of {counts[number]} poses to the others"
        for number, trust in enumerate(result.trust)
        if trust.loose
    ]
    for e in order[:NAMED_MAX]:
        first, second = graph.vertex_ids[graph.edges[e]].tolist()
        said.append(
            f"the part behind closure {first}-{second} hangs on it alone, nothing checks it: {result.hanging[e]} of "
            f"{sizes[e]} poses"
        )
    if len(order) > NAMED_MAX:
        said.append(f"and {len(order) - NAMED_MAX} more closures that nothing checks hold a part alone")
    return said


def _contradicted(graph: PlanarGraph, result: OptimisedGraph) -> list[str]:
    """A sentence on the observations that stand out, if any, with the landmarks that most of them are of."""
    out = graph.landmark_observations[result.landmark_errors > LANDMARK_GATE, 1]
    if not len(out):
        return []
    landmarks, times = np.unique(out, return_counts=True)
    named = graph.landmark_ids[landmarks[np.argsort(-times, kind="stable")]].tolist()
    some = ", ".join(map(str, named[:NAMED_MAX])) + (" ..." if len(named) > NAMED_MAX else "")
    return [
        f"{len(out)} of {len(graph.landmark_observations)} observations of landmarks contradict the rest "
        f"(chi squared above {LANDMARK_GATE}): of {some}; chi2/dof leaves observations out, and none makes a map LOST"
    ]


def _has_ids_for_times(graph: PlanarGraph) -> bool:
    return all(abs(vertex) < TIME_MAX for vertex in graph.vertex_ids.tolist())


def _times(graph: PlanarGraph) -> Array:
    """(n,) the vertex ids, or the poses' own numbers where readers of doubles would not tell the ids apart."""
    ids = graph.vertex_ids if _has_ids_for_times(graph) else np.arange(len(graph.vertex_ids))
    return ids.astype(float)


_COLUMNS = ("from", "to", "component", "accepted", "chi_squared", "reason", "disagrees_with", "chi_squared_of_both")

_OBSERVATION = ("vertex", "landmark", "component", "contradicts", "chi_squared")


def _write_table(path: Path, columns: tuple[str, ...], rows: list[dict]) -> None:
    with whole_file(path) as beside, beside.open("w", newline="") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(rows)


def _observation(graph: PlanarGraph, result: OptimisedGraph, observation: int) -> dict:
    vertex, landmark = graph.landmark_observations[observation].tolist()
    error = float(result.landmark_errors[observation])
    values = (
        int(graph.vertex_ids[vertex]), int(graph.landmark_ids[landmark]), int(result.component[vertex]),
        error > LANDMARK_GATE, round(error, 3),
    )  # fmt: skip
    return dict(zip(_OBSERVATION, values, strict=True))


def _closure(graph: PlanarGraph, result: OptimisedGraph, edge: int) -> dict:
    first, second = graph.vertex_ids[graph.edges[edge]].tolist()
    opponent, chi = result.opponents.get(edge, (None, None))
    against = "" if opponent is None else " ".join(map(str, graph.vertex_ids[graph.edges[opponent]].tolist()))
    values = (
        first, second, int(result.component[graph.edges[edge, 0]]), bool(result.accepted[edge]),
        round(float(result.squared_errors[edge]), 3), result.reasons.get(edge, ""), against,
        "" if chi is None else round(chi, 1),
    )  # fmt: skip
    return dict(zip(_COLUMNS, values, strict=True))


def _rows(graph: PlanarGraph, result: OptimisedGraph) -> list[dict]:
    sizes = np.bincount(result.component, minlength=len(result.trust)).tolist()
    firsts = np.unique(result.component, return_index=True)[1].tolist()
    return [
        {
            "component": number,
            "from vertex": int(graph.vertex_ids[first]),
            "poses": size,
            "closures": trust.closures,
            "accepted": trust.accepted,
            "undecided": trust.undecided,
            "second hypothesis": trust.second,
            "chi2/dof": round(float(trust.contradiction), 3),
            "expected error [m]": round(float(trust.expected_error_m), 3),
            "map [m]": round(trust.diagonal_m, 1),
            "on no loop": f"{100 * trust.unchecked:.0f} %",
            "status": status(trust, size),
        }
        for number, (first, size, trust) in enumerate(zip(firsts, sizes, result.trust, strict=True))
    ]
