"""`twc-env optimise`: pose graphs of others, optimised robustly, with a decision on every closure and on the whole."""

from __future__ import annotations

import argparse
from pathlib import Path

from twc_env.errors import ConfigError, DataError, one_of
from twc_env.records.json_values import check_folder, write_json
from twc_env.running.options import add_json
from twc_env.running.terminal import aligned, terminal_width


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Fill the command's parser."""
    parser.description = (
        "Optimise a planar pose graph of any origin: g2o or TORO, packed (.gz, .xz) or not, with gaps in the ids, "
        "flipped edges, FIX lines, missing vertices, landmarks and several components, each of which is solved by "
        "itself. What cannot be used is named. Edges between vertices with neighbouring ids are odometry and are "
        "believed, unless the ids jump or the vertices' places deny them; all others are closures. A component is "
        "LOST if its result cannot be trusted, with the reasons: the exit status is 1 then."
    )
    parser.epilog = (
        "examples:\n  twc-env optimise intel.g2o --out runs/intel\n"
        "  twc-env optimise manhattan.g2o.gz --robust gnc --json -\n\n"
        "--out writes graph.g2o (rejected edges as comments), poses.tum (the vertex id stands for the time, "
        "or the number of the pose if ids have more than 15 digits), closures.csv, landmark_observations.csv, "
        "and graph.png."
    )
    parser.add_argument("graph", type=Path, metavar="GRAPH", help="a g2o or TORO file")
    parser.add_argument(
        "--robust",
        default="ours",
        metavar="METHOD",
        help="which closures to accept: ours (groups by evidence), dcs, cauchy, gnc, pcm, none (all of them), or a "
        "back end of your own, FILE.py:CLASS",
    )
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="where to write the results")
    add_json(parser)
    parser.set_defaults(run=_optimise)


def _optimise(options: argparse.Namespace) -> int:
    from twc_env.datasets.logs.pose_graph_file import read_pose_graph
    from twc_env.offline.graph_report import component_rows, notes, summary, write_results
    from twc_env.records.class_file import is_in_file
    from twc_env.slam.graph_optimisation.whole_graph import METHODS, optimise_graph

    if options.robust not in METHODS and not is_in_file(options.robust):
        among = one_of(options.robust, [*METHODS, "or FILE.py:CLASS"], "choose from")
        raise ConfigError(f"unknown method {options.robust!r} for --robust{among}")
    check_folder(options.out)
    graph = read_pose_graph(options.graph)
    if not len(graph.edges) + len(graph.landmark_observations):
        raise DataError(
            f"{options.graph} has {len(graph.vertex_ids)} vertices and no edge (EDGE_SE2): there is nothing to "
            "optimise; export the edges too"
        )
    for remark in graph.remarks:
        print(f"note: {remark}")
    result = optimise_graph(graph, options.robust)
    shown, left = component_rows(graph, result)
    print(aligned(shown, terminal_width()))
    if left:
        print(f"and {left} more components, in --json")
    for note in notes(graph, result, options.out is not None):
        print(f"note: {note}")
    for number, trust in enumerate(result.trust):
        for reason in trust.reasons:
            print(f"LOST, component {number}: {reason}")
    write_json(options.json, summary(graph, result))
    if options.out is not None:
        print("".join(f"written: {path}\n" for path in write_results(graph, result, options.out)), end="")
    return 1 if result.is_lost else 0
